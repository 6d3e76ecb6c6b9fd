import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.algorithm import begin, episode
from hiprl.data.answer import number
from hiprl.world.build import world_from
from tests.whole.tasks import TINY, Blind, exactly


def run_with(world, ask):
    """All episodes of a run, and what is known at its end."""
    run = begin(world, TINY, key=jr.key(7))
    done = []
    for _ in range(TINY.comparisons):
        done.append(episode(run, world, TINY, ask, key=jr.key(7)))
        run = done[-1].run
    return done, run


@pytest.fixture(scope="module")
def seeing():
    world = world_from("linear")
    return run_with(world, exactly)


@pytest.fixture(scope="module")
def blind(seeing):
    """The same run where nothing is paid, with the answers that the seeing judge gave."""
    answers = iter([done.answer for done in seeing[0]])
    return run_with(Blind(world_from("linear")), lambda question, run, *, key: next(answers))


def test_the_learner_never_looks_at_a_reward(seeing, blind):
    (_, one), (_, other) = seeing, blind
    assert np.isfinite(np.asarray(one.T.rows.rewards)).all()
    assert np.isnan(np.asarray(other.T.rows.rewards)[np.asarray(other.T.filled)]).all()
    for part in ("P", "dynamics", "reward", "ending", "calibration", "archive"):
        for x, y in zip(*(jax.tree.leaves(getattr(run, part)) for run in (one, other)), strict=True):
            np.testing.assert_array_equal(x, y, err_msg=part)


def test_the_same_is_done_whether_or_not_it_is_paid(seeing, blind):
    for one, other in zip(seeing[0], blind[0], strict=True):
        np.testing.assert_array_equal(one.question.tau.actions, other.question.tau.actions)
        np.testing.assert_array_equal(one.question.tau.states, other.question.tau.states)
        np.testing.assert_array_equal(one.question.clips.of, other.question.clips.of)


def test_other_answers_make_other_policies(seeing):
    turned = iter([number(-done.answer.value) for done in seeing[0]])
    done, _ = run_with(world_from("linear"), lambda question, run, *, key: next(turned))
    last, other = done[-1].question.tau, seeing[0][-1].question.tau
    assert not jnp.array_equal(last.actions, other.actions)
    # the random episodes are the same: nothing was learned before them
    np.testing.assert_array_equal(done[0].question.tau.actions, seeing[0][0].question.tau.actions)
