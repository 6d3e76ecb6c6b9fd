import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.data.answer import rating
from hiprl.data.preference import Clip, Preferences
from hiprl.models.evidence import evidence
from hiprl.models.quality import NUMBER_VAR, predicted
from hiprl.models.reward import JUDGES, AdditiveConfig, Errors, estimate_additive_reward
from hiprl.models.units import lengths_of, units
from tests.models.test_answers import H as STEPS_OF_T
from tests.models.test_answers import answered, linear_set


def knowing(T, mistakes):
    """A reward that knows how those who answer by levels err."""
    reward = estimate_additive_reward(answered(T, ["number"], n=8, m=2), T, AdditiveConfig(smooth=(0.01,)))
    errors = Errors(jnp.asarray(0.1), mistakes, reward.errors.scale, reward.errors.spread)
    return eqx.tree_at(lambda r: r.errors, reward, errors)


def test_the_newest_answer_is_read_in_the_unit_of_those_it_is_predicted_from():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    P = answered(T, ["level"], n=9, m=2)
    P = eqx.tree_at(lambda P: P.at_hand, P, P.at_hand.at[8].set(3))  # less was at hand then: another unit
    r = jnp.asarray(np.random.default_rng(3).normal(size=T.rows.actions.shape[:2]), jnp.float32)
    by_newest, by_kept = (np.asarray(units(r, T, P, lengths_of(P), jnp.asarray(i)))[:9] for i in (8, 7))
    assert by_newest[8] == by_kept[7] == 1 and by_kept[8] != pytest.approx(1, rel=1e-2)
    np.testing.assert_allclose(by_kept / by_newest, by_kept[8], rtol=1e-5)
    reward = knowing(T, jnp.full(JUDGES, 0.02))
    held, otherwise = (np.asarray(predicted(P, T, reward, newest=i).log_likelihood) for i in (7, 8))
    alone = predicted(P.only(np.arange(8)), T, reward, newest=7).log_likelihood
    np.testing.assert_allclose(held[:8], np.asarray(alone)[:8], rtol=1e-4)  # as without the newest
    assert not np.allclose(otherwise[:8], held[:8], rtol=1e-3)


@pytest.mark.slow
def test_ratings_are_predicted_too():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    reward = estimate_additive_reward(answered(T, ["number"], m=2), T, AdditiveConfig(smooth=(0.01,)))
    held = predicted(answered(T, ["rating"], n=20, seed=7, m=2), T, reward, newest=19)
    right = np.asarray(held.right)
    assert np.isfinite(right).sum() >= 8
    assert np.nanmean(right) > 0.9


def numbers_and_levels(T, unit):
    """A reward that was learned from numbers in this unit alone, and levels that it has not seen."""
    P = answered(T, ["number"], n=8, m=2)
    P = eqx.tree_at(lambda P: (P.said.low, P.said.high), P, (P.said.low * unit, P.said.high * unit))
    return estimate_additive_reward(P, T, AdditiveConfig(smooth=(0.01,))), answered(T, ["level"], n=6, seed=9, m=2)


def test_levels_are_predicted_from_numbers_in_any_unit():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    small, usual, large = (
        predicted(levels, T, reward, newest=5).mean("log_likelihood")
        for reward, levels in (numbers_and_levels(T, unit) for unit in (1e-3, 1.0, 1e3))
    )
    assert usual > -3  # by chance: -1.6 for each of five
    assert small == pytest.approx(usual, rel=1e-2) and large == pytest.approx(usual, rel=1e-2)


def test_numbers_have_the_density_of_the_belief_about_them_in_any_unit():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    found = []
    for unit in (1.0, 1e-5):
        P = answered(T, ["number"], n=9, m=2)
        P = eqx.tree_at(lambda P: (P.said.low, P.said.high), P, (P.said.low * unit, P.said.high * unit))
        kept = P.only(np.arange(5))
        reward = estimate_additive_reward(kept, T, AdditiveConfig(smooth=(0.01,)))
        found.append(np.asarray(predicted(P, T, reward, newest=4).log_likelihood)[:9])
        size = np.sqrt(np.mean(np.asarray(P.g)[:9] ** 2))
        for k in (6, 7, 8):
            gap = reward.gap(*(T.clip(Clip(*(x[k, i] for x in P_clips(P)))) for i in (0, 1)))
            var = (float(gap.sigma) / size) ** 2 + NUMBER_VAR
            error = (float(P.g[k]) - float(gap.mean)) / size
            assert found[-1][k] == pytest.approx(-0.5 * (error**2 / var + np.log(2 * np.pi * var)), rel=1e-2, abs=0.05)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-2, atol=0.05)


def P_clips(P):
    return P.clips.of, P.clips.start, P.clips.length


def test_who_errs_often_is_expected_to():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    P = answered(T, ["choice"], n=12, m=2, judge=lambda k: k % 2)
    seldom, often = (
        predicted(P, T, knowing(T, each), newest=5)
        for each in (jnp.full(JUDGES, 0.02), jnp.full(JUDGES, 0.02).at[1].set(0.4))
    )
    same = np.isclose(seldom.log_likelihood[:12], often.log_likelihood[:12], rtol=1e-5)
    assert same[::2].all() and not same[1::2].any()


def test_to_end_early_is_less_than_an_average_clip():
    T = linear_set(21, [STEPS_OF_T] * 11 + [4], H=STEPS_OF_T, capacity=17)
    P = Preferences.empty(8, m=2)
    for i in (11, 0, 3):
        P = P.answered(rating(0, 5), [Clip.whole(i)], at_hand=jnp.asarray(12, jnp.int32))
    P = P.answered(rating(0, 5), [Clip.at(11, 0, 2)], at_hand=jnp.asarray(12, jnp.int32))
    steps = np.asarray(evidence(T, P).Psi)[:4, 0, 0]  # the first feature is 1 a step
    whole = (11 * STEPS_OF_T + 4) / 12
    np.testing.assert_allclose(steps, [4 - whole, STEPS_OF_T - whole, STEPS_OF_T - whole, 0.0], atol=1e-3)
