import jax.numpy as jnp
import numpy as np
import pytest

import hiprl
from hiprl.api import Learned
from hiprl.errors import InputError, JudgeError
from hiprl.session import RunSpec, start
from hiprl.store.rows import PEOPLE
from hiprl.store.store import open_store
from hiprl.types import Actor
from hiprl.world.build import world_from
from hiprl.world.gym import GymWorld
from tests.whole.tasks import TINY, Sledge


class Straight(Actor):
    """Two of the three numbers of a state, squashed."""

    def act(self, s, *, key):
        return jnp.tanh(s[:2])


@pytest.fixture(scope="module")
def learned():
    return Learned(Straight(), GymWorld(Sledge(), horizon=31), None)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A tiny run in the linear world, and its store."""
    store = tmp_path_factory.mktemp("api") / "new folder" / "runs.db"
    return hiprl.learn("linear", config=TINY, seed=2, store=store), store


def test_an_observation_gives_one_action_in_the_units_of_the_environment(learned):
    obs = np.array([0.5, -9.0, 0.1])
    action, state = learned.predict(obs)
    np.testing.assert_allclose(action, 1 + 3 * np.tanh([0.5, -9.0]), rtol=1e-5)
    assert learned.world.env.action_space.contains(action.astype(np.float32)) and state is None


def test_a_batch_gives_one_action_a_row(learned):
    batch = np.random.default_rng(1).normal(0, 2, (5, 3)).astype(np.float32)
    actions, _ = learned.predict(batch)
    assert actions.shape == (5, 2)
    for obs, action in zip(batch, actions, strict=True):
        np.testing.assert_allclose(learned.predict(obs)[0], action, rtol=1e-6)


def test_predict_takes_what_stable_baselines3_passes(learned):
    obs = np.zeros(3, np.float32)
    action, state = learned.predict(obs, state=("kept",), episode_start=np.array([True]), deterministic=False)
    assert action.shape == (2,) and state == ("kept",)


@pytest.mark.parametrize("shape", [(2,), (4,), (5, 4), (1, 1, 3), ()])
def test_an_observation_of_another_shape_is_refused_in_three_parts(learned, shape):
    with pytest.raises(InputError) as caught:
        learned.predict(np.zeros(shape))
    message = str(caught.value)
    assert f"shape {shape}" in message and "(3,)" in message and "(n, 3)" in message and "reset and" in message


def test_an_empty_batch_gives_no_actions(learned):
    assert learned.predict(np.zeros((0, 3)))[0].shape == (0, 2)


def test_what_was_learned_acts_within_the_bounds(run):
    action, _ = run[0].predict(np.array([0.5, -0.3, 0.2]))
    assert action.shape == (2,) and (np.abs(action) <= 1).all()
    assert run[0].summary["comparisons"] == TINY.comparisons and run[0].summary["env"] == "linear"


def test_a_run_is_loaded_by_the_start_of_its_id(run):
    learned, store = run
    again = hiprl.load(learned.summary["run"][:9], store=store)
    obs = np.array([0.5, -0.3, 0.2])
    np.testing.assert_array_equal(again.predict(obs)[0], learned.predict(obs)[0])
    assert again.summary == learned.summary


def test_a_finished_run_is_not_resumed(run):
    learned, store = run
    with pytest.raises(InputError, match="is finished"):
        hiprl.resume(learned.summary["run"], store=store)


def test_a_run_whose_judge_failed_goes_on_with_another(tmp_path):
    store, asked = tmp_path / "runs.db", []

    def moody(tau, other):
        asked.append(1)
        return float("nan") if len(asked) == 2 else float(tau.states[-1, 0] - other.states[-1, 0])

    with pytest.raises(JudgeError) as caught:
        hiprl.learn("linear", moody, config=TINY, store=store)
    run_id = str(caught.value).split("The run is ")[1].rstrip(".")
    assert f"stored, as run {run_id} in {store}" in caught.value.__notes__[0]
    with open_store(store) as opened:
        assert opened.run(run_id).spec["function"].endswith("<locals>.moody")
    with pytest.raises(InputError) as caught:
        hiprl.resume(run_id, store=store)
    message = str(caught.value)
    assert "a function as its judge" in message and "needs that function again" in message and "hiprl.resume" in message
    assert hiprl.resume(run_id, moody, store=store).summary["comparisons"] == TINY.comparisons


@pytest.mark.slow
def test_fewer_comparisons_shorten_the_warm_up(tmp_path):
    watched = []
    hiprl.learn("linear", config=TINY, comparisons=2, store=tmp_path / "runs.db", watch=watched.append)
    assert [facts["searched"] for facts in watched] == [False, True]


def test_one_comparison_is_too_few(tmp_path):
    with pytest.raises(InputError, match="at least 2"):
        hiprl.learn("linear", config=TINY, comparisons=1, store=tmp_path / "runs.db")
    assert not (tmp_path / "runs.db").exists()


def test_an_unknown_run_is_refused(run):
    with pytest.raises(InputError, match="there is no run"):
        hiprl.load("walker-1234", store=run[1])


def test_everything_named_in_the_package_is_there():
    for name in hiprl.__all__:
        assert getattr(hiprl, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'laern'"):
        hiprl.laern  # noqa: B018


def test_a_run_that_people_teach_goes_on_with_their_answers_alone(tmp_path):
    path = tmp_path / "runs.db"
    with open_store(path) as store:
        run_id = start(store, world_from("linear"), RunSpec(seed=0, config=TINY, judge=PEOPLE))
    with pytest.raises(InputError, match=f"taught by people.*hiprl resume {run_id}"):
        hiprl.resume(run_id, lambda tau, other: 0.0, store=path)
