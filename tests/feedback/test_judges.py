import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy import stats

from hiprl.errors import InputError, JudgeError
from hiprl.feedback.judges import checked, exact, judge_from, noisy
from tests.data.samples import p, q, trajectory


@pytest.fixture
def pair():
    rng = np.random.default_rng(17)
    return trajectory(rng, length=5), trajectory(rng, length=3)


def difference(pair):
    tau, other = (np.asarray(t.rewards, float)[: int(t.length)].sum() for t in pair)
    return tau - other


def test_the_exact_judge_says_the_difference_of_the_true_returns(pair):
    assert judge_from("exact") is exact
    assert exact(*pair, key=jr.key(0)) == pytest.approx(difference(pair), abs=1e-5)


def test_the_noisy_judge_errs_by_a_gaussian_of_its_spread(pair):
    judge = judge_from("noisy:2.5")
    errors = np.array([judge(*pair, key=key) for key in jr.split(jr.key(5), 211)]) - difference(pair)
    assert 1e-4 < stats.kstest(errors / 2.5, "norm").pvalue < 1 - 1e-4


def test_a_judge_without_error_is_exact(pair):
    assert noisy(0.0)(*pair, key=jr.key(1)) == exact(*pair, key=jr.key(1))


def test_a_judge_of_ones_own_sees_arrays_without_padding(pair):
    seen = []
    answer = judge_from(lambda tau, other: seen.append((tau, other)) or 1.5)
    assert checked(answer, *pair, key=jr.key(0)) == 1.5
    (tau, other), n, m = seen[0], 5, 3
    assert tau.states.shape == (n + 1, p) and other.states.shape == (m + 1, p)
    assert tau.actions.shape == (n, q) and isinstance(tau.states, np.ndarray)
    assert np.isfinite(tau.states).all() and np.isfinite(other.actions).all()


@pytest.mark.parametrize(
    "name", ["exakt", "exact:1", "noisy", "noisy:", "noisy:-1", "noisy:nan", "noisy:inf", "", "noisy:x"]
)
def test_a_judge_that_does_not_exist_is_refused_in_three_parts(name):
    with pytest.raises(InputError) as caught:
        judge_from(name)
    message = str(caught.value)
    assert repr(name) in message and "`exact` or `noisy:STD`" in message and "--judge noisy:50" in message


@pytest.mark.parametrize("thing", [None, 3, ["exact"]])
def test_what_is_neither_name_nor_function_is_refused(thing):
    with pytest.raises(InputError, match="a scripted judge is"):
        judge_from(thing)


@pytest.mark.parametrize(
    "g", [2, 2.0, np.float32(2), np.array(2.0), np.int64(2), jnp.asarray(2.0), jnp.asarray(2)], ids=lambda g: repr(g)
)
def test_an_answer_may_be_any_kind_of_number(pair, g):
    number = checked(lambda tau, other, *, key: g, *pair, key=jr.key(0))
    assert number == 2 and type(number) is float


@pytest.mark.parametrize(
    "g",
    [None, float("nan"), float("inf"), True, np.bool_(True), "2", np.ones(2), [1.0, [2.0]], 1j, np.array([2.0])],
    ids=repr,
)
def test_what_is_no_number_is_refused_in_three_parts(pair, g):
    with pytest.raises(JudgeError) as caught:
        checked(lambda tau, other, *, key: g, *pair, key=jr.key(0))
    message = str(caught.value)
    assert repr(g) in message and "one finite number is needed" in message and "Mend the judge" in message


def test_a_truth_value_in_jax_is_no_number_either(pair):
    with pytest.raises(JudgeError, match="one finite number"):
        checked(lambda tau, other, *, key: jnp.asarray(True), *pair, key=jr.key(0))


def test_a_judge_that_raises_is_reported_with_what_it_said(pair):
    def broken(tau, other):
        raise KeyError("no such clip")

    with pytest.raises(JudgeError) as caught:
        checked(judge_from(broken), *pair, key=jr.key(0))
    message = str(caught.value)
    assert "KeyError" in message and "no such clip" in message
    assert "one number for two trajectories" in message and "still open" in message
    assert isinstance(caught.value.__cause__, KeyError)


def test_where_nothing_is_paid_the_exact_judge_has_no_answer(pair):
    unpaid = jax.tree.map(lambda x: x, pair[0])
    unpaid = type(unpaid)(unpaid.states, unpaid.actions, unpaid.rewards * jnp.nan, unpaid.length, unpaid.terminated)
    with pytest.raises(JudgeError, match="needs a judge of your own"):
        checked(exact, unpaid, pair[1], key=jr.key(0))


def test_stopping_by_hand_is_not_the_judges_fault(pair):
    def stopped(tau, other):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        checked(judge_from(stopped), *pair, key=jr.key(0))
