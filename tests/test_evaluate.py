import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hiprl.evaluate import cumulative_regret, interquartile_mean, interval, true_returns
from tests.data.samples import trajectory

numbers = st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=23)


@given(numbers, st.floats(-100, 100), st.floats(0.1, 10))
def test_the_interquartile_mean_moves_with_shift_and_scale(x, shift, scale):
    x = np.array(x)
    np.testing.assert_allclose(interquartile_mean(scale * x + shift), scale * interquartile_mean(x) + shift, atol=1e-6)


@given(numbers)
def test_the_interquartile_mean_lies_between_the_quartiles(x):
    low, high = np.quantile(x, [0.25, 0.75], method="inverted_cdf"), np.quantile(x, 0.75, method="higher")
    assert low[0] - 1e-6 <= interquartile_mean(np.array(x)) <= max(high, low[1]) + 1e-6


@pytest.mark.parametrize("n", [4, 8, 20, 40])
def test_the_interquartile_mean_is_scipys_where_quarters_are_whole(n):
    x = np.random.default_rng(n).normal(size=n)
    np.testing.assert_allclose(interquartile_mean(x), stats.trim_mean(x, 0.25), rtol=1e-12)


def test_runs_at_the_edge_of_the_middle_half_count_in_part():
    # five runs: each is a fifth; the middle half is 0.05 of the second, the third, 0.05 of the fourth (of 0.2 each)
    x = np.array([100.0, 2.0, 3.0, 7.0, -50.0])
    assert interquartile_mean(x) == pytest.approx((0.15 * 2 + 0.2 * 3 + 0.15 * 7) / 0.5)


def test_one_run_is_its_own_mean():
    assert interquartile_mean(np.array([4.2])) == pytest.approx(4.2)
    assert interval([4.2]) == pytest.approx((4.2, 4.2, 4.2))


def test_the_interval_covers_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(2)
    inside = sum(
        i.low <= 5 <= i.high for i in (interval(rng.normal(5, 2, 17), level=0.9, draws=200) for _ in range(200))
    )
    # a bootstrap of 17 runs is somewhat too narrow: 0.9 nominal, 0.75 at the least, and not always
    assert stats.binom.cdf(inside, 200, 0.97) < 1 - 1e-4 and stats.binom.sf(inside, 200, 0.75) < 1 - 1e-4


def test_the_interval_is_the_same_each_time():
    x = np.random.default_rng(5).normal(size=29)
    assert interval(x, draws=150) == interval(list(x), draws=150) != interval(x, draws=150, seed=1)


def test_regret_adds_up_what_the_optimum_would_have_had():
    np.testing.assert_allclose(cumulative_regret(10.0, [4.0, 9.0, 10.0]), [6.0, 7.0, 7.0])


def test_true_returns_are_unknown_where_nothing_is_paid():
    rng = np.random.default_rng(0)
    paid, unpaid = trajectory(rng, length=5), trajectory(rng, length=5)
    unpaid = type(unpaid)(unpaid.states, unpaid.actions, unpaid.rewards * np.nan, unpaid.length, unpaid.terminated)
    returns = true_returns([paid, unpaid])
    assert np.isfinite(returns[0]) and np.isnan(returns[1])
