from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hiprl.errors import InputError
from hiprl.report.tensorboard import EventFiles, event_folder
from tests.report.made_up import facts


def told(n: int) -> list[dict]:
    draw = np.random.default_rng(5)
    return [facts(k, warm_up=3, draw=draw) for k in range(1, n + 1)]


def scalars(folder: Path) -> dict[tuple[str, int], float]:
    """Tag and step to number, of all event files in a folder, read back record by record."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2", reason="tensorboardX is not here")
    found = {}
    for path in sorted(folder.glob("events.out.tfevents.*")):
        data = path.read_bytes()
        while data and len(data) >= 16 + (size := int.from_bytes(data[:8], "little")):
            # length (8), its checksum (4), the event, its checksum (4)
            event, data = event_pb2.Event.FromString(data[12 : 12 + size]), data[16 + size :]
            for value in event.summary.value:
                assert (value.tag, event.step) not in found
                found[value.tag, event.step] = value.simple_value
    return found


def soon(folder: Path) -> dict[tuple[str, int], float]:
    """The same once anything is there; a thread of the writer puts it there."""
    deadline = time.monotonic() + 20
    while ("seconds/learn", 3) not in (found := scalars(folder)):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return found


@pytest.mark.slow
def test_each_known_fact_is_written_as_its_episode_arrives(tmp_path: Path) -> None:
    first, second = told(4)[2:]
    second["coverage"] = None
    events = EventFiles(tmp_path, "hopper-1a2b")
    events(first)
    written = soon(tmp_path / "hopper-1a2b")
    assert written["return/true_return", 3] == pytest.approx(first["true_return"])
    assert written["rollout_errors/20", 3] == pytest.approx(first["rollout_errors"]["20"])
    assert written["seconds/learn", 3] == pytest.approx(1.5)
    events(second)
    events.close()
    written = scalars(tmp_path / "hopper-1a2b")
    assert ("dynamics/beta", 4) in written
    assert ("dynamics/coverage", 4) not in written


def test_a_run_that_goes_on_has_each_episode_once(tmp_path: Path) -> None:
    past = told(5)
    events = EventFiles(tmp_path, "run", past[:2])
    events(past[2])
    events.close()
    again = EventFiles(tmp_path, "run", past[:3])
    again(past[3])
    again.close()
    steps = {step for _, step in scalars(tmp_path / "run")}
    assert steps == {1, 2, 3, 4}


def test_a_missing_tensorboardx_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    with pytest.raises(InputError, match=r"not installed.*pip install 'hiprl\[tensorboard\]'"):
        event_folder(tmp_path)


def test_a_folder_that_cannot_be_made_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"cannot make the folder .*needed.*--tensorboard"):
        event_folder(tmp_path / "file" / "folder")
