"""The worth of an answer, against draws from the belief."""

from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.data.answer import choice
from hiprl.data.preference import Clip, Preferences
from hiprl.feedback import worth as module
from hiprl.feedback.questions import QuestionConfig, apart, drawn, phi_of
from hiprl.feedback.worth import worth
from hiprl.models.answers import estimate_from_answers
from hiprl.models.features import Kernel
from tests.models.worlds import linear_set

H, N, STEPS, DRAWS = 31, 17, 11, 200_000  # the shapes of test_questions.py: what is learned compiles once


seen = jax.jit(module.seen)


@partial(jax.jit, static_argnames="config")
def psi_of(T, reward, config, key):
    asked = drawn(T, config, key=key)
    return apart(phi_of(T, reward.features, asked.clips, config), asked.shown)[:, 0]


@pytest.fixture(scope="module")
def T():
    return linear_set(5, [H] * 7 + [9], H=H, capacity=N)


@pytest.fixture(scope="module")
def reward(T):
    P = Preferences.empty(13)
    for k in range(3):
        clips = [Clip.at(k, k, STEPS), Clip.at(k + 1, 2 * k, STEPS)]
        P = P.answered(choice(k % 2 > 0), clips, at_hand=jnp.asarray(7, jnp.int32))
    return estimate_from_answers(P, T, (Kernel(0.1, 4.0),))


@pytest.fixture(autouse=True)
def few(monkeypatch):
    monkeypatch.setattr(module, "CANDIDATES", 7)
    monkeypatch.setattr(module, "SPAN", STEPS)


def test_what_can_be_done_is_what_was_executed(T, reward):
    marked = eqx.tree_at(lambda T: T.rows.imagined, T, jnp.arange(N) == 2)
    (_, before), (_, after) = seen(T, reward), seen(marked, reward)
    before, after = (np.asarray(there).reshape(N, -1) for there in (before, after))
    assert before[2].any() and not after[2].any()
    np.testing.assert_array_equal(np.delete(before, 2, axis=0), np.delete(after, 2, axis=0))


def test_where_all_soon_fall_short_clips_are_what_can_be_done(T, reward):
    short = eqx.tree_at(lambda T: T.rows.length, T, jnp.minimum(T.rows.length, 4))
    there = np.asarray(seen(short, reward)[1]).reshape(N, -1)
    assert there[:8, 0].all() and not there[:, 1:].any() and not there[8:].any()


def draws(reward):
    """Draws of θ."""
    root = np.asarray(reward.root, float)
    S = np.diag(np.asarray(reward.prior, float)) - root.T @ root
    w, V = np.linalg.eigh(S)
    z = np.random.default_rng(1).normal(size=(DRAWS, len(w)))
    return np.asarray(reward.mean) + (z * np.sqrt(np.maximum(w, 0))) @ V.T


def by_draws(T, reward, config, answers):
    """The same by drawing what could be wanted, what would then be answered, and what would then be done."""
    theta = draws(reward)
    Phi, there = (np.asarray(x) for x in seen(T, reward))
    R = theta @ Phi[there].T
    rng, gains = np.random.default_rng(2), []
    for one in np.asarray(psi_of(T, reward, replace(config, candidates=7), jr.key(3))):
        said = answers(theta @ one, rng)
        after = [(np.mean(said == x), R[said == x].mean(axis=0).max()) for x in np.unique(said)]
        gains.append(sum(p * best for p, best in after) - R.mean(axis=0).max())
    episodes = np.asarray(reward.returns(T))[: int(T.count)]
    return max(gains) / (R.mean(axis=0).max() - episodes.mean() / H)


def chosen(reward, levels):
    def answers(u, rng):
        perceived = u * float(reward.errors.scale) + float(reward.errors.kappa) * rng.logistic(size=len(u))
        step = 2 / (levels - 1)
        return np.clip(np.round(perceived / step + (levels - 1) / 2), 0, levels - 1)

    return answers


@pytest.mark.parametrize("levels", [2, 5])
def test_it_is_the_gain_that_draws_from_the_belief_tell(T, reward, levels):
    config = QuestionConfig(clip=STEPS, pick="information", levels=levels)
    assert float(worth(T, reward, config, key=jr.key(3))) == pytest.approx(
        by_draws(T, reward, config, chosen(reward, levels)), rel=0.06
    )


def test_a_number_tells_more_than_a_choice(T, reward):
    config = QuestionConfig(clip=STEPS, pick="information", levels=2)
    number = float(worth(T, reward, replace(config, levels=None), key=jr.key(3)))
    fine = by_draws(
        T,
        reward,
        replace(config, levels=None),
        lambda u, rng: np.digitize(u, np.quantile(u, np.linspace(0, 1, 99))),
    )
    assert number == pytest.approx(fine, rel=0.06)
    assert number > float(worth(T, reward, config, key=jr.key(3))) > 0


def test_who_knows_what_is_wanted_need_not_ask(T, reward):
    sure = eqx.tree_at(lambda r: (r.prior, r.root), reward, (1e-9 * reward.prior, 0 * reward.root))
    config = QuestionConfig(clip=STEPS, pick="information", levels=2)
    assert float(worth(T, sure, config, key=jr.key(3))) < 1e-3


def test_the_unit_of_the_reward_does_not_matter(T, reward):
    config = QuestionConfig(clip=STEPS, pick="information", levels=2)
    parts = lambda r: (r.mean, r.prior, r.root, r.errors.scale)
    mean, prior, root, scale = parts(reward)
    other = eqx.tree_at(parts, reward, (1000 * mean, 1e6 * prior, 1000 * root, scale / 1000))
    assert float(worth(T, other, config, key=jr.key(3))) == pytest.approx(
        float(worth(T, reward, config, key=jr.key(3))), rel=1e-3
    )


def test_of_rankings_it_is_not_known(T, reward):
    assert np.isnan(worth(T, reward, QuestionConfig(clip=STEPS, pick="information", items=4), key=jr.key(0)))


def test_behaviours_are_clips_that_last(T, reward):
    Phi, there = seen(T, reward)
    assert Phi.shape == (N * 3, reward.mean.shape[0])
    # seven whole trajectories have clips from steps 0, 11 and 22; the short one's first has 9 of 11 steps
    assert int(there.sum()) == 7 * 3 + 1
