import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given

from hiprl.models.usual import counts, typical_size
from tests.data.samples import H, N, seeds, set_of, trajectory


def T_of(rng, n=N - 2):
    return set_of([trajectory(rng, length=int(rng.integers(2, H + 1))) for _ in range(n)])


def rewards(rng, T):
    """A reward for each step, now good and now bad: each trajectory has some of both. NaN where there is none."""
    mask = np.asarray(T.transitions().mask)
    turn = np.where(np.arange(mask.size) % 2, 0.4, -0.4)
    return np.where(mask, 0.7 + turn * rng.uniform(0.9, 1.1, mask.shape), np.nan), mask


def weights(r, T):
    return np.asarray(counts(jnp.asarray(r, jnp.float32), T))


@given(seeds)
def test_usual_steps_count_alike_and_padding_counts_nothing(seed):
    rng = np.random.default_rng(seed)
    T = T_of(rng)
    r, mask = rewards(rng, T)
    weight = weights(r, T)
    assert (weight[mask] > 0.8).all() and (weight[~mask] == 0).all()


@given(seeds)
def test_trajectories_without_steps_change_nothing(seed):
    rng = np.random.default_rng(seed)
    T = T_of(rng)
    r, mask = rewards(rng, T)
    gone = np.arange(N) % 2 == 1  # such as what was only imagined
    without = eqx.tree_at(lambda T: T.rows.length, T, jnp.where(gone, 0, T.rows.length))
    left = mask & ~np.repeat(gone, H)
    weight = weights(r, without)
    assert (weight[left] > 0.8).all() and (weight[~left] == 0).all()


def test_a_step_that_is_far_worse_counts_next_to_nothing():
    rng = np.random.default_rng(1)
    T = T_of(rng)
    r, mask = rewards(rng, T)
    far = np.arange(r.size) // H == 3
    away = weights(np.where(far, r - 1e3, r), T)
    assert (away[far & mask] < 1e-6).all() and (away[~far & mask] > 0.8).all()


def test_a_step_that_is_far_better_counts_in_full():
    rng = np.random.default_rng(1)
    T = T_of(rng)
    r, mask = rewards(rng, T)
    best = np.flatnonzero(mask)[5]
    r[best] = 1e6
    assert weights(r, T)[best] == 1


@pytest.mark.parametrize(("times", "more"), [(1e6, 0.0), (1e-6, 0.0), (1.0, 5.0)])
def test_neither_the_unit_nor_the_origin_of_rewards_matters(times, more):
    rng = np.random.default_rng(2)
    T = T_of(rng)
    r, _ = rewards(rng, T)
    np.testing.assert_allclose(weights(times * r + more, T), weights(r, T), rtol=1e-3)


@pytest.mark.parametrize("value", [0.0, -3.0])
def test_where_all_steps_are_worth_the_same_all_count(value):
    T = T_of(np.random.default_rng(3))
    mask = np.asarray(T.transitions().mask)
    assert (weights(np.full(mask.shape, value), T) == mask).all()


def test_the_typical_size_is_the_root_mean_square_but_for_what_is_far():
    rng = np.random.default_rng(4)
    T = T_of(rng)
    r, mask = rewards(rng, T)
    usual = np.sqrt(np.mean(r[mask] ** 2))
    size = lambda r: float(typical_size(jnp.asarray(r, jnp.float32), T))
    assert size(r) == pytest.approx(usual, rel=0.02)
    assert size(np.where(np.arange(r.size) // H == 3, r - 1e3, r)) == pytest.approx(usual, rel=0.1)
    assert size(0 * r) == 1
