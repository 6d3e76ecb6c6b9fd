import re
from pathlib import Path

import pytest

README = Path(__file__).parents[2] / "README.md"


def examples():
    return re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def test_the_own_judge_and_environment_fit_in_ten_lines():
    assert any(
        "hiprl.learn(" in code and sum(bool(line.strip()) for line in code.splitlines()) < 10 for code in examples()
    )


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(examples())))
def test_the_readmes_python_runs(number, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(examples()[number], f"README example {number}", "exec"), names)
    assert names["learned"].world.env.action_space.contains(names["action"])
