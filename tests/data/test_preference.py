import jax.numpy as jnp
import numpy as np
from hypothesis import given

from hiprl.data.preference import Preferences, gap
from tests.data.samples import lengths, seeds, trajectory


@given(seeds, lengths, lengths)
def test_gap_changes_sign_when_the_pair_is_swapped(seed, n, m):
    rng = np.random.default_rng(seed)
    tau, other = trajectory(rng, length=n), trajectory(rng, length=m)
    assert float(gap(tau, other)) == -float(gap(other, tau))
    assert float(gap(tau, tau)) == 0


@given(seeds, lengths, lengths, lengths)
def test_gaps_add_up_along_a_chain(seed, n, m, o):
    rng = np.random.default_rng(seed)
    a, b, c = (trajectory(rng, length=k) for k in (n, m, o))
    np.testing.assert_allclose(float(gap(a, b)) + float(gap(b, c)), float(gap(a, c)), atol=2e-5)


@given(seeds, lengths, lengths)
def test_gap_is_the_difference_of_what_was_paid_before_the_padding(seed, n, m):
    rng = np.random.default_rng(seed)
    tau, other = trajectory(rng, length=n), trajectory(rng, length=m)
    by_hand = np.asarray(tau.rewards, float)[:n].sum() - np.asarray(other.rewards, float)[:m].sum()
    np.testing.assert_allclose(float(gap(tau, other)), by_hand, atol=2e-5)


def test_answers_stay_in_the_order_in_which_they_came():
    P = Preferences.empty(5)
    assert int(P.count) == 0 and not P.filled.any()
    for g, first, second in ((2.5, 3, 1), (-0.5, 4, 3), (7.0, 5, 2)):
        P = P.add(jnp.asarray(g), jnp.asarray(first), jnp.asarray(second))
    assert P.capacity == 5
    np.testing.assert_array_equal(P.filled, [True, True, True, False, False])
    np.testing.assert_array_equal(np.asarray(P.g)[:3], [2.5, -0.5, 7.0])
    np.testing.assert_array_equal(np.asarray(P.first)[:3], [3, 4, 5])
    np.testing.assert_array_equal(np.asarray(P.second)[:3], [1, 3, 2])
