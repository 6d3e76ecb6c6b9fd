import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.data.preference import WHOLE, Clip
from hiprl.models.evidence import clip_sums, features_of
from hiprl.models.reward import summed
from hiprl.models.sums import columns, evenly, steps_of, values
from tests.models.worlds import linear_set

H, LENGTHS = 23, [23, 19, 23, 7, 23]


@pytest.fixture(scope="module")
def T():
    return linear_set(8, LENGTHS, H=H)


@pytest.fixture(scope="module")
def features(T):
    return features_of(steps_of(T))


def test_many_steps_are_worth_what_each_is(T, features):
    weights = jnp.asarray(np.random.default_rng(1).normal(size=features.size), jnp.float32)
    found = jax.jit(values)(features, columns(features, steps_of(T).x), weights).reshape(T.capacity, H)
    for i, length in enumerate(LENGTHS):
        for t in range(0, length, 5):
            one = features.dot(T.rows.states[i, t], T.rows.actions[i, t], weights)
            assert float(found[i, t]) == pytest.approx(float(one), rel=1e-3, abs=1e-3)


@pytest.mark.parametrize("wanted", [3, 17, 100, 4096])
def test_some_steps_are_taken_from_everywhere(wanted):
    mask = np.random.default_rng(3).uniform(size=997) < 0.2
    at, there = (np.asarray(x) for x in evenly(jnp.asarray(mask), wanted))
    some, every = at[there], np.flatnonzero(mask)
    assert len(some) == len(set(some)) == min(wanted, len(every)) and mask[some].all()
    gaps = np.diff(np.searchsorted(every, some))
    assert gaps.max() - gaps.min() <= 1  # as far from one to the next


def test_many_clips_sum_up_to_what_each_does(T, features):
    clips = Clip(
        jnp.asarray([0, 1, 3, -1, 4, 2]), jnp.asarray([2, 15, 0, 0, 20, 0]), jnp.asarray([11, 11, 11, 0, 11, WHOLE])
    )
    found = jax.jit(clip_sums, static_argnames="steps")(features, T, clips, steps=H)
    for i in range(6):
        one = summed(features, T.clip(jax.tree.map(lambda x: x[i], clips)))  # noqa: B023
        np.testing.assert_allclose(found[i], one, rtol=1e-3, atol=1e-3)
    assert (np.asarray(found[3]) == 0).all() and np.isfinite(found).all()


def test_features_but_the_bias_have_mean_zero_over_what_was_seen(T, features):
    phi = [features(T.rows.states[i, t], T.rows.actions[i, t]) for i, n in enumerate(LENGTHS) for t in range(n)]
    np.testing.assert_allclose(np.mean(phi, axis=0)[1:], 0.0, atol=1e-4)
