import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.data.trajectory import Trajectory
from hiprl.models.ending import estimate_ending, new_ending
from tests.data.samples import clean, p, q, set_of

H, EDGE = 23, 1.5


def walk(rng, *, ends=True):
    """A random walk that terminates where its first entry passes the edge."""
    states, actions, n, ended = [rng.normal(0, 0.5, p)], [], 0, False
    while n < H and not ended:
        actions.append(rng.uniform(-1, 1, q))
        states.append(states[-1] + rng.normal(0.15, 0.4, p))
        n, ended = n + 1, bool(ends and states[-1][0] > EDGE)
    padded = np.full((H + 1, p), np.nan), np.full((H, q), np.nan)
    padded[0][: n + 1], padded[1][:n] = states, actions
    return Trajectory(
        states=jnp.asarray(padded[0], jnp.float32),
        actions=jnp.asarray(padded[1], jnp.float32),
        rewards=jnp.zeros(H),
        length=jnp.asarray(n, jnp.int32),
        terminated=jnp.asarray(ended),
    )


def taus(*, ends):
    rng = np.random.default_rng(6)
    return [walk(rng, ends=ends) for _ in range(17)]


@pytest.fixture(scope="module")
def T():
    return set_of(taus(ends=True), capacity=19)


@pytest.fixture(scope="module")
def learned(T):
    return estimate_ending(T, new_ending(T, key=jr.key(1)), key=jr.key(2))


def says(ending, first):
    """What the classifier says of a step to a state whose first entry is this."""
    s_next = jnp.array([first, 0.3, -0.2])
    return bool(ending(s_next - 0.2, jnp.zeros(q), s_next))


def test_a_threshold_is_learned(learned):
    assert learned.seen
    assert not says(learned, EDGE - 0.8) and not says(learned, -1.0)
    assert says(learned, EDGE + 0.6)


def test_most_of_the_steps_seen_are_told_apart(T, learned):
    rows = T.transitions()
    said = jax.vmap(learned)(rows.s, rows.a, rows.s_next)
    mask, ended = np.asarray(rows.mask), np.asarray(rows.terminated)
    assert np.asarray(said)[mask & ended].mean() > 0.9
    assert np.asarray(said)[mask & ~ended].mean() < 0.1


def test_while_nothing_has_ended_nothing_is_expected_to():
    T = set_of(taus(ends=False), capacity=19)
    blank = new_ending(T, key=jr.key(1))
    assert not says(blank, 9.0)
    fitted = estimate_ending(T, blank, key=jr.key(2))
    assert not fitted.seen and not says(fitted, 9.0)
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(eqx.filter(fitted, eqx.is_inexact_array)))


def test_padding_and_unfilled_rows_change_nothing(T, learned):
    again = estimate_ending(clean(T), new_ending(clean(T), key=jr.key(1)), key=jr.key(2))
    for x, y in zip(jax.tree.leaves(learned), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(x, y)
