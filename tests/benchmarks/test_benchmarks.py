import json
import subprocess
import sys

import jax.numpy as jnp
import pytest

from benchmarks import roofline
from benchmarks.common import Report, said
from benchmarks.optimism import solved_at
from benchmarks.roofline import Product, network
from benchmarks.runner import Job, known, reported, run_all, seeds_of, write
from benchmarks.table1 import solved_by

PROGRAMS = (
    "policy_search",
    "roofline",
    "table1",
    "answers",
    "questions",
    "cost",
    "coverage",
    "optimism",
    "linear",
    "crash",
    "judges",
    "paint",
    "taught",
)


def test_seeds_are_ranges_and_lists():
    assert seeds_of("0-2,7") == [0, 1, 2, 7]


def test_a_network_counts_its_products():
    work = network(3, 7, (5, 11, 2), weights=True)
    assert work[Product(3, 7, 5, 11, "forward")] == work[Product(3, 7, 5, 11, "to weight")] == 1
    assert work[Product(3, 7, 5, 11, "to input")] == 0  # nobody asks for the slope in the input
    assert sum(product.flops * n for product, n in work.items()) == 2 * 3 * 7 * (2 * 5 * 11 + 3 * 11 * 2)


@pytest.mark.parametrize("kind", ["forward", "to input", "to weight"])
@pytest.mark.slow
def test_a_product_alone_takes_some_time(kind, monkeypatch):
    monkeypatch.setattr(roofline, "SECONDS", 0.001)
    assert 0 < roofline.Alone(Product(3, 7, 5, 11, kind)).seconds() < 1


def test_solved_means_for_good():
    assert solved_by("InvertedPendulum-v5", [None, 1000.0, 999.0, 1000.0, 1000.0]) == 4
    assert solved_by("InvertedPendulum-v5", [None, 1000.0, 999.0]) is None
    assert solved_at([None, 3.0, 7.0, 2.0], 5.0) == 3


def test_what_is_reported_is_the_executed_return_of_the_best_trajectory():
    facts = [
        {"k": 1, "true_return": 5.0, "searched": False},
        {"k": 2, "true_return": 9.0, "searched": True, "best_return": 9.0},
        {"k": 3, "true_return": 1.0, "searched": True, "best_return": 9.0},
    ]
    assert reported(facts) == [None, 9.0, 9.0]


def test_a_run_that_is_in_the_file_is_not_done_again(tmp_path):
    job = Job(arm="default", env="linear", seed=3, settings={"config": {"comparisons": 7}})
    results = tmp_path / "results.jsonl"
    write(results, job, {"return_mean": 11.0})
    assert run_all([job], results=results, workers=1) == [(job, {"return_mean": 11.0})]
    other = Job(arm="default", env="linear", seed=3, settings={"config": {"comparisons": 8}})
    with pytest.raises(SystemExit, match="other settings"):
        known(results, [other])


def test_a_report_is_written_as_it_is_shown(tmp_path, capsys):
    report = Report("Numbers", notes=["A note."])
    report.add(what="one", value=float(jnp.float32(2.5)))
    report.show()
    assert "Numbers" in capsys.readouterr().out
    report.write(tmp_path / "out.json", seed=3)
    found = json.loads((tmp_path / "out.json").read_text())
    assert found["rows"] == [{"what": "one", "value": 2.5}] and found["seed"] == 3 and found["machine"]["versions"]
    assert said(12345.6) == "12,346" and said(None) == ""


@pytest.mark.slow
@pytest.mark.parametrize("program", PROGRAMS)
def test_each_program_explains_itself(program):
    command = [sys.executable, "-m", f"benchmarks.{program}", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "--json FILE" in done.stdout and "--quick" in done.stdout and "(default: " in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("command", ["policy_search --no-sb3 --task InvertedPendulum-v5", "roofline", "judges"])
def test_each_measurement_runs(command, tmp_path):
    name, *flags = command.split()
    out = tmp_path / "out.json"
    command = [sys.executable, "-m", f"benchmarks.{name}", "--quick", "--json", str(out), *flags]
    subprocess.run(command, capture_output=True, text=True, check=True)
    assert json.loads(out.read_text())["rows"]
