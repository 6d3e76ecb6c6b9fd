import os
import subprocess
import sys
import warnings

import gymnasium as gym
import jax.random as jr
import mujoco
import pytest

from hiprl.world.build import world_from
from hiprl.world.quiet import quiet
from tests.world.actors import uniform


def test_no_log_of_mujoco_is_left_in_the_working_folder(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    world = world_from("HalfCheetah-v5", horizon=3)
    world.roll_out(uniform(6), key=jr.key(0))
    world_from(lambda: gym.make("HalfCheetah-v5")).close()
    assert os.listdir() == []
    assert capfd.readouterr() == ("", "")


def test_an_unstable_simulation_writes_no_log_either(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='1'/></body></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    with quiet():
        data.qvel[0] = float("nan")
        mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQVEL].number == 1
    assert os.listdir() == []
    assert capfd.readouterr() == ("", "")


def test_mujocos_settings_are_put_back_even_after_an_error():
    before = mujoco.MjLogConfig.get()
    with pytest.raises(ZeroDivisionError), quiet():
        raise ZeroDivisionError
    after = mujoco.MjLogConfig.get()
    assert (after.logto_file, after.logto_console) == (before.logto_file, before.logto_console) == (True, True)


def test_gymnasiums_warnings_are_dropped_and_others_pass():
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        with quiet():
            gym.logger.warn("you are a user")
            gym.logger.deprecation("this is old")
            warnings.warn("the motor is hot", stacklevel=1)
    assert [str(w.message) for w in seen] == ["the motor is hot"]


def test_an_old_version_of_an_environment_gives_no_warning():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert world_from("Reacher-v4").H == 50


@pytest.mark.slow
def test_a_world_without_mujoco_runs_where_mujoco_cannot_be_loaded(tmp_path):
    (tmp_path / "mujoco.py").write_text("raise RuntimeError('no EGL here')")
    code = "from hiprl.world.build import world_from as w; print(w('Pendulum-v1').H); w('Hopper-v5')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "200\n"
    assert "InputError: got 'Hopper-v5'" in done.stderr
    assert "no EGL here" in done.stderr
