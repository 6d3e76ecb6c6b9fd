import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, choice, level, ranking, slider
from hiprl.data.preference import Kind, Said
from hiprl.models import likelihood
from hiprl.models.likelihood import Noise, between, log_likelihood, meant, plackett_luce, responsibility

difference = st.floats(-3, 3, width=32)
LOG, SLOPE = jax.jit(log_likelihood), jax.jit(jax.grad(log_likelihood))
RANKING, BENT = jax.jit(likelihood.ranking), jax.jit(jax.hessian(meant))
RANKED = jax.jit(lambda u, items, kappa: plackett_luce(u, items, kappa).value)
LEVELS = [level(x, 5) for x in (-2, -1, 0, 1, 2)]


def noise(kappa=0.3, var=1e-2, mistake=0.0):
    return Noise(*map(jnp.float32, (kappa, var, mistake)))


def chance(answer, u, **how):
    return math.exp(float(LOG(jnp.atleast_1d(jnp.float32(u)), Said.of(answer), noise(**how))))


def sigmoid(x):
    return 1 / (1 + math.exp(-x))


@given(difference)
def test_a_choice_is_made_by_the_logistic_of_the_difference(u):
    assert chance(choice(True), u) == pytest.approx(sigmoid(u / 0.3), rel=1e-3)
    assert chance(choice(True), u) + chance(choice(False), u) == pytest.approx(1, abs=1e-5)


@given(difference, st.sampled_from([0.0, 0.1]))
def test_the_levels_share_all_there_is(u, mistake):
    assert sum(chance(answer, u, mistake=mistake) for answer in LEVELS) == pytest.approx(1, abs=1e-4)


@given(difference)
def test_whoever_cannot_tell_says_nothing(u):
    assert chance(CANNOT_TELL, u) == pytest.approx(1, abs=1e-5)
    assert float(SLOPE(jnp.float32([u]), Said.of(CANNOT_TELL), noise())[0]) == pytest.approx(0, abs=1e-5)


def test_equal_is_likeliest_where_nothing_differs():
    assert chance(EQUALLY_GOOD, 0.0) > chance(EQUALLY_GOOD, 0.5) > chance(EQUALLY_GOOD, 2.0)
    assert chance(EQUALLY_GOOD, 0.7) == pytest.approx(chance(EQUALLY_GOOD, -0.7), rel=1e-3)


def test_a_slider_is_likeliest_where_it_was_set():
    values = np.linspace(-1.5, 1.5, 61)
    assert values[np.argmax([chance(slider(0.5), u) for u in values])] == pytest.approx(0.5, abs=0.06)
    assert chance(slider(1.0), 5.0) == pytest.approx(1, abs=1e-3)  # as far as it goes


@given(difference, st.floats(0.01, 0.4))
def test_a_mistake_is_an_answer_about_the_clips_the_other_way_round(u, mistake):
    told = (1 - mistake) * chance(LEVELS[3], u) + mistake * chance(LEVELS[3], -u)
    assert chance(LEVELS[3], u, mistake=mistake) == pytest.approx(told, rel=1e-3, abs=1e-6)


@settings(max_examples=20)
@given(st.tuples(difference, difference, difference))
def test_all_rankings_together_are_certain(v):
    total = 0.0
    for order in itertools.permutations(range(3)):
        u = jnp.float32([v[order[0]] - v[order[2]], v[order[1]] - v[order[2]]])
        total += math.exp(float(LOG(u, Said.of(ranking(order)), noise(mistake=0.2))))
    assert total == pytest.approx(1, abs=1e-3)


@given(difference)
def test_a_ranking_of_two_is_a_choice(u):
    one = float(RANKED(jnp.float32([u]), jnp.asarray(2), jnp.float32(0.3)))
    assert math.exp(one) == pytest.approx(chance(choice(True), u), rel=1e-3)


@given(difference)
def test_clips_past_the_ranking_do_not_count(u):
    two = RANKED(jnp.float32([u]), jnp.asarray(2), jnp.float32(0.3))
    padded = RANKED(jnp.float32([u, 7.0, -3.0]), jnp.asarray(2), jnp.float32(0.3))
    assert float(padded) == pytest.approx(float(two), abs=1e-5)


@pytest.mark.parametrize("u", [-1e4, -50.0, 0.0, 50.0, 1e4])
@pytest.mark.parametrize("answer", [*LEVELS, choice(True), choice(False), EQUALLY_GOOD, CANNOT_TELL], ids=str)
def test_no_difference_is_too_large_for_a_gradient(answer, u):
    told, how = Said.of(answer), noise(mistake=0.02)
    assert np.isfinite(SLOPE(jnp.float32([u]), told, how)).all() and np.isfinite(LOG(jnp.float32([u]), told, how))


@given(
    st.tuples(difference, difference, difference),
    st.sampled_from([(0, 1), (1, 0, 2), (0, 1, 2, 3), (3, 1, 0, 2)]),
    st.sampled_from([0.0, 0.1]),
)
def test_slope_and_curvature_of_a_ranking_are_those_of_its_log_likelihood(u, order, mistake):
    given = jnp.float32(u), Said.of(ranking(order)), noise(mistake=mistake)
    found, wrong = RANKING(*given), float(responsibility(*given))
    assert float(found.value) == pytest.approx(float(LOG(*given)), rel=1e-5, abs=1e-5)
    np.testing.assert_allclose(found.slope, SLOPE(*given), rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(found.curvature, -(1 - wrong) * BENT(*given), rtol=2e-3, atol=5e-3)
    assert np.linalg.eigvalsh(np.asarray(found.curvature)).min() >= -1e-3


@pytest.mark.parametrize("u", [[1e4, 5e3, 1e3], [-1e4, 5e3, 0.0], [50.0, -50.0, 0.0]])
def test_no_utility_is_too_far_off_for_a_ranking(u):
    for found in RANKING(jnp.float32(u), Said.of(ranking((0, 1, 2, 3))), noise(mistake=0.02)):
        assert np.isfinite(found).all()


def test_a_surprise_is_more_likely_a_mistake():
    told = Said.of(choice(True))
    found = [float(responsibility(jnp.float32([u]), told, noise(mistake=0.1))) for u in (-2.0, 0.0, 2.0)]
    assert found[0] > 0.9 and found[1] == pytest.approx(0.1, abs=1e-3) and found[2] < 0.01


def test_numbers_err_by_a_gaussian():
    told = Said(jnp.asarray(int(Kind.NUMBER)), jnp.float32(1.5), jnp.float32(1.5), jnp.asarray(2))
    value = float(LOG(jnp.float32([1.3]), told, noise(var=0.04, mistake=0.3)))
    assert value == pytest.approx(-0.5 * 0.04 / 0.04 - 0.5 * math.log(2 * math.pi * 0.04), rel=1e-3)


def test_an_interval_without_width_has_no_chance_and_a_finite_logarithm():
    assert (
        np.isfinite(between(*map(jnp.float32, (0.2, 0.2, 0.0, 0.1))))
        and between(*map(jnp.float32, (0.2, 0.2, 0.0, 0.1))) < -20
    )
