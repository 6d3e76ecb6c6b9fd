import itertools

import emcee
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from hiprl.data.answer import choice, level, ranking
from hiprl.data.preference import Kind, Said
from hiprl.models.likelihood import Noise, for_each, log_likelihood
from hiprl.models.variational import Answers, begun, improved, left_out, posterior_of, root_of, thin, unknown

D, ROWS, KAPPA = 3, 11, 0.4


def stacked(answers):
    told = [Said.of(answer) for answer in answers]
    return jax.tree.map(
        lambda *x: jnp.stack([jnp.asarray(y, jnp.float32) if y.dtype.kind == "f" else y for y in x]), *told
    )


def noise(mistake=0.0, rows=ROWS):
    return Noise(jnp.float32(KAPPA), jnp.float32(1e-2), jnp.full(rows, mistake, jnp.float32))


def weights(Psi, mode):
    """Mean and covariance of θ ~ N(0, I) from the posterior of f = Ψθ."""
    A = np.asarray(Psi, float).reshape(-1, Psi.shape[-1])
    RA = np.asarray(mode.root, float) @ A
    return A.T @ np.asarray(mode.dual, float), np.eye(A.shape[1]) - RA.T @ RA


def belief_after(A, given, *, steps):
    return posterior_of(A, given, improved(A, given, unknown(A, ROWS), steps=steps))


def solved(Psi, told, how, *, steps=20, filled=None):
    A = jnp.asarray(Psi, jnp.float32).reshape(-1, Psi.shape[-1])
    filled = jnp.ones(len(Psi), bool) if filled is None else filled
    given = Answers(told, filled, how)
    return jax.jit(belief_after, static_argnames="steps")(A, given, steps=steps)


def sampled(Psi, told, how):
    """Mean and covariance of θ by a long run of an ensemble sampler."""

    @jax.jit
    def log_density(thetas):
        u = jnp.einsum("rjd,wd->wrj", jnp.asarray(Psi, jnp.float32), thetas)
        return jax.vmap(lambda u: jnp.sum(for_each(log_likelihood, u, told, how)))(u) - 0.5 * jnp.sum(thetas**2, axis=1)

    rng = np.random.default_rng(0)
    sampler = emcee.EnsembleSampler(
        40, D, lambda x: np.asarray(log_density(jnp.asarray(x, jnp.float32)), float), vectorize=True
    )
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(rng.normal(size=(40, D)), 2500)
    draws = sampler.get_chain(discard=500, flat=True)
    return draws.mean(axis=0), np.cov(draws.T)


def compared(*kinds, seed=0):
    """Ψ and answers of these kinds in turn about a known θ; what is not compared in a row is zero there."""
    rng = np.random.default_rng(seed)
    theta = np.array([1.0, -0.7, 0.4])
    m = 4 if "ranking" in kinds else 2
    Phi = rng.normal(size=(ROWS, m, D))
    v = Phi @ theta
    Psi, answers = np.zeros((ROWS, m - 1, D)), []
    for row in range(ROWS):
        kind = kinds[row % len(kinds)]
        if kind == "ranking":
            order = tuple(int(i) for i in np.argsort(-(v[row] + KAPPA * rng.gumbel(size=m))))
            Psi[row] = Phi[row][list(order[:-1])] - Phi[row][order[-1]]
            answers.append(ranking(order))
        else:
            Psi[row, 0] = Phi[row, 0] - Phi[row, 1]
            u = v[row, 0] - v[row, 1] + KAPPA * rng.logistic()
            answers.append(
                choice(bool(u > 0)) if kind == "choice" else level(float(np.clip(np.round(2 * u), -2, 2)), 5)
            )
    return Psi, stacked(answers)


@pytest.mark.slow
@pytest.mark.parametrize("kinds", [("choice",), ("level",), ("ranking",), ("ranking", "choice", "level")], ids="+".join)
@pytest.mark.parametrize("mistake", [0.0, 0.05])
def test_the_posterior_agrees_with_a_long_monte_carlo_run(kinds, mistake):
    Psi, told = compared(*kinds)
    how = noise(mistake)
    mean, cov = weights(Psi, solved(Psi, told, how))
    exact_mean, exact_cov = sampled(Psi, told, how)
    std = np.sqrt(np.diag(exact_cov))

    np.testing.assert_array_less(np.abs(mean - exact_mean), 0.2 * std)
    np.testing.assert_allclose(np.sqrt(np.diag(cov)), std, rtol=0.25)  # a little too sure of choices


def test_numbers_give_the_closed_form():
    rng = np.random.default_rng(3)
    Psi, g = rng.normal(size=(ROWS, 1, D)), rng.normal(size=ROWS)
    told = Said(
        jnp.full(ROWS, int(Kind.NUMBER)), jnp.asarray(g, jnp.float32), jnp.asarray(g, jnp.float32), jnp.full(ROWS, 2)
    )
    mean, cov = weights(Psi, solved(Psi, told, noise()))
    A = Psi[:, 0]
    exact = np.linalg.inv(A.T @ A / 1e-2 + np.eye(D))
    np.testing.assert_allclose(cov, exact, atol=1e-3)
    np.testing.assert_allclose(mean, exact @ A.T @ g / 1e-2, atol=1e-2)


def test_the_mean_is_where_the_mean_slope_vanishes():
    Psi, told = compared("choice")
    belief = solved(Psi, told, noise(), steps=40)
    _, cov = weights(Psi, belief)
    f, std = np.asarray(belief.f), np.sqrt(np.einsum("rd,de,re->r", Psi[:, 0], cov, Psi[:, 0]))
    draws = np.random.default_rng(0).normal(size=(4001, 1))
    u = jnp.asarray(f[None] + std[None] * draws, jnp.float32)
    slope = jax.vmap(lambda u: for_each(jax.grad(log_likelihood), u[:, None], told, noise())[:, 0])(u).mean(axis=0)
    np.testing.assert_allclose(slope, belief.dual, atol=0.1)


def test_rows_without_an_answer_change_nothing():
    Psi, told = compared("level")
    filled = jnp.arange(ROWS) < 7
    spoilt = np.where(np.asarray(filled)[:, None, None], Psi, 3.0)
    one, other = solved(Psi, told, noise(), filled=filled), solved(spoilt, told, noise(), filled=filled)
    np.testing.assert_allclose(one.dual[:7], other.dual[:7], atol=1e-5)
    assert float(one.evidence) == pytest.approx(float(other.evidence), abs=1e-4)
    assert (np.asarray(other.dual)[7:] == 0).all()


def test_more_answers_leave_less_unknown():
    Psi, told = compared("choice")
    few, many = (weights(Psi, solved(Psi, told, noise(), filled=jnp.arange(ROWS) < n))[1] for n in (3, ROWS))
    assert np.trace(many) < np.trace(few) < D


def test_a_thin_factor_leaves_out_less_the_more_columns_it_has():
    A = np.random.default_rng(4).normal(size=(13, 7)) * 0.3 ** np.arange(7)
    K = A @ A.T
    left = [np.diag(K) - np.sum(np.asarray(thin(jnp.float32(K), rank)) ** 2, axis=1) for rank in (2, 3, 5, 7)]
    assert all((more >= less - 1e-6).all() for more, less in itertools.pairwise(left))
    assert (left[1] / np.diag(K)).max() > 1e-3
    whole = np.asarray(thin(jnp.float32(K), 11))  # more columns than there is to know
    np.testing.assert_allclose(whole @ whole.T, K, atol=1e-4 * np.diag(K).max())


def test_a_thin_factor_serves_small_values_as_well_as_large_ones():
    A = np.random.default_rng(5).normal(size=(13, 3)) * np.where(np.arange(13) < 6, 1.0, 1e-3)[:, None]
    K = A @ A.T
    kept = np.asarray(thin(jnp.float32(K), 3))
    np.testing.assert_allclose(np.sum(kept**2, axis=1), np.diag(K), rtol=1e-3)


def test_values_without_prior_variance_stay_known():
    K = np.diag([1.0, 0.0, 2.0])
    kept = np.asarray(thin(jnp.float32(K), 3))
    np.testing.assert_allclose(kept @ kept.T, K, atol=1e-6)


def test_the_evidence_of_numbers_is_their_density():
    rng = np.random.default_rng(6)
    Psi, g = rng.normal(size=(ROWS, D)), rng.normal(size=ROWS)
    g_32 = jnp.asarray(g, jnp.float32)
    told = Said(jnp.full(ROWS, int(Kind.NUMBER)), g_32, g_32, jnp.full(ROWS, 2))
    A, given = jnp.asarray(Psi, jnp.float32), Answers(told, jnp.ones(ROWS, bool), noise())
    found = jax.jit(lambda A: improved(A, given, unknown(A, ROWS), steps=30).evidence)(A)
    density = stats.multivariate_normal(np.zeros(ROWS), Psi @ Psi.T + 1e-2 * np.eye(ROWS)).logpdf(g)
    assert float(found) == pytest.approx(density, rel=2e-3)


def exactly_judged(rows, D, *, size, seed):
    """Features, and five-level answers about them of a judge who is nearly exact."""
    rng, kappa = np.random.default_rng(seed), 0.03
    Psi = rng.normal(size=(rows, D))
    u = size * Psi @ rng.normal(size=D) + kappa * rng.logistic(size=rows)
    told = stacked([level(float(np.clip(np.round(2 * x), -2, 2)), 5) for x in u])
    how = Noise(jnp.float32(kappa), jnp.float32(1e-2), jnp.full(rows, 0.02, jnp.float32))
    return jnp.float32(Psi), Answers(told, jnp.ones(rows, bool), how)


def test_a_step_that_makes_it_worse_is_taken_back():
    Psi, given = exactly_judged(60, 5, size=0.4, seed=2)
    A = 3 * Psi
    reached = jax.jit(lambda steps: improved(A, given, unknown(A, 60), steps=steps).evidence)
    found = [float(reached(steps)) for steps in (1, 4, 8, 16, 32)]
    assert found == sorted(found)
    assert float(begun(A, given, unknown(A, 60)).evidence) > max(-100, found[-1])  # less exact judges first


def test_a_belief_that_is_far_off_is_not_where_the_steps_begin():
    A, given = exactly_judged(30, 4, size=0.5, seed=4)
    to_the_end = jax.jit(lambda belief: improved(A, given, belief, steps=40))
    right = to_the_end(begun(A, given, unknown(A, 30)))
    wrong = right._replace(dual=-3 * right.dual)  # the other way round, and sure of it
    assert float(to_the_end(wrong).evidence) < float(right.evidence) - 20  # where it would stay
    assert float(to_the_end(begun(A, given, wrong)).evidence) == pytest.approx(float(right.evidence), abs=0.1)


@pytest.mark.parametrize("size", [0.5, 2.0, 6.0])
def test_what_the_bound_leaves_out_is_all_that_it_misses(size):
    """One choice about a value whose prior is N(0, size²): the evidence by integration."""
    told, how = stacked([choice(True)]), noise(mistake=0.02, rows=1)
    A = jnp.full((1, 1), size, jnp.float32)
    given = Answers(told, jnp.ones(1, bool), how)
    belief = jax.jit(lambda: improved(A, given, unknown(A, 1), steps=20))()
    u = np.linspace(-8 * size, 8 * size, 4001)
    likelihood = 0.02 + 0.96 / (1 + np.exp(-u / KAPPA))
    exact = np.log(np.sum(likelihood * stats.norm(0, size).pdf(u)) * (u[1] - u[0]))
    bound = float(belief.evidence)
    assert bound < exact
    assert bound + float(left_out(A, given, belief)) == pytest.approx(exact, abs=0.02)  # of one answer, all of it


def test_values_that_are_as_good_as_one_have_a_root():
    rng = np.random.default_rng(3)
    B = np.repeat(rng.normal(size=(50, 48, 1)), 3, axis=2) + 1e-6 * rng.normal(size=(50, 48, 3))
    S = jnp.einsum("rki,rkj->rij", *[jnp.asarray(B, jnp.float32)] * 2)
    L = root_of(S)
    np.testing.assert_allclose(jnp.einsum("rik,rjk->rij", L, L), S, rtol=1e-4)
