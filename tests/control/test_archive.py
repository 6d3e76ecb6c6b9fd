import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl.control.archive import Archive
from hiprl.control.gradient import GradientConfig, new_gradient
from hiprl.models.network import Scaler
from tests.data.samples import p, q

N = 5


def state(seed):
    units = Scaler(jnp.full(p, float(seed)), jnp.ones(p))
    return new_gradient(units, q, GradientConfig(hidden=(7,)), key=jr.key(seed))


@pytest.fixture
def archive():
    return Archive.empty(N, state(0))


def same(x, y):
    return all((a == b).all() for a, b in zip(jax.tree.leaves(x), jax.tree.leaves(y), strict=True))


def test_what_was_put_comes_back(archive):
    archive = archive.put(jnp.asarray(1), state(1)).put(jnp.asarray(3), state(3))
    assert same(archive.get(1), state(1)) and same(archive.get(jnp.asarray(3)), state(3))
    np.testing.assert_array_equal(archive.filled, [False, True, False, True, False])


def test_rows_without_a_search_hold_the_one_that_knows_nothing(archive):
    archive = archive.put(jnp.asarray(1), state(1))
    assert same(archive.get(0), state(0)) and same(archive.get(4), state(0))


def test_the_best_is_that_of_greatest_return_among_those_that_were_searched(archive):
    returns = jnp.array([99.0, 1.0, 50.0, 2.0, -jnp.inf])
    assert int(archive.best(returns)) == 0  # none was searched: any row, as all know nothing
    archive = archive.put(jnp.asarray(1), state(1)).put(jnp.asarray(3), state(3))
    assert int(archive.best(returns)) == 3
    assert int(archive.best(-returns)) == 1


def test_a_newer_reward_can_change_which_is_best(archive):
    archive = archive.put(jnp.asarray(1), state(1)).put(jnp.asarray(2), state(2))
    assert int(archive.best(jnp.array([0.0, -5.0, -6.0, 0.0, 0.0]))) == 1
    assert int(archive.best(jnp.array([0.0, -7.0, -6.0, 0.0, 0.0]))) == 2
