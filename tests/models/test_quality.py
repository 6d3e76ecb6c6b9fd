import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.models.estimate import estimate_reward
from hiprl.models.quality import predicted
from hiprl.models.reward import AdditiveConfig, estimate_additive_reward
from hiprl.models.units import lengths_of, units
from tests.models.test_answers import H as STEPS_OF_T
from tests.models.test_answers import answered, linear_set


def test_the_newest_answer_is_read_in_the_unit_of_those_it_is_predicted_from():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    P = answered(T, ["level"], n=9, m=2)
    P = eqx.tree_at(lambda P: P.at_hand, P, P.at_hand.at[8].set(3))  # less was at hand then: another unit
    r = jnp.asarray(np.random.default_rng(3).normal(size=T.rows.actions.shape[:2]), jnp.float32)
    by_newest, by_kept = (np.asarray(units(r, T, P, lengths_of(P), jnp.asarray(i)))[:9] for i in (8, 7))
    assert by_newest[8] == by_kept[7] == 1 and by_kept[8] != pytest.approx(1, rel=1e-2)
    np.testing.assert_allclose(by_kept / by_newest, by_kept[8], rtol=1e-5)
    reward = estimate_reward(P.only(np.arange(8)), T, None, AdditiveConfig(smooth=(0.01,)))
    held, otherwise = (np.asarray(predicted(P, T, reward, newest=i).log_likelihood) for i in (7, 8))
    alone = predicted(P.only(np.arange(8)), T, reward, newest=7).log_likelihood
    np.testing.assert_allclose(held[:8], np.asarray(alone)[:8], rtol=1e-4)  # as it was learned
    assert not np.allclose(otherwise[:8], held[:8], rtol=1e-3)


@pytest.mark.slow
def test_ratings_are_predicted_too():
    T = linear_set(21, [STEPS_OF_T] * 12, H=STEPS_OF_T, capacity=17)
    reward = estimate_additive_reward(answered(T, ["number"], m=2), T, AdditiveConfig(smooth=(0.01,)))
    held = predicted(answered(T, ["rating"], n=20, seed=7, m=2), T, reward, newest=19)
    right = np.asarray(held.right)
    assert np.isfinite(right).sum() >= 8
    assert np.nanmean(right) > 0.9
