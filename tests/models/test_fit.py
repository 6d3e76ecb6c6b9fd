import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
import pytest
from scipy import stats

from hiprl.models.fit import fit


def run(train_loss, held_out_loss, *, start=5.0, rate=0.1, chunk=7, chunks=11):
    params = {"w": jnp.asarray(start)}
    optimiser = optax.sgd(rate)
    rest = {"chunk": chunk, "chunks": chunks, "key": jr.key(1)}
    return fit(params, train_loss, held_out_loss, optimiser, **rest)


def test_a_fit_finds_the_least_loss():
    loss = lambda params: (params["w"] - 2.0) ** 2
    params, report = run(lambda params, key: loss(params), loss)
    assert float(params["w"]) == pytest.approx(2.0, abs=1e-4)
    assert float(report.loss) == pytest.approx(0.0, abs=1e-6)


def test_a_fit_keeps_what_was_best_on_held_out_data():
    # training pulls w from 5 down to 0; what was held out is best at 3
    params, report = run(lambda params, key: params["w"], lambda params: (params["w"] - 3.0) ** 2)
    # w falls by 0.7 a chunk: 4.3, 3.6, 2.9 (best), and on past it
    assert float(params["w"]) == pytest.approx(2.9, abs=1e-5)
    assert int(report.steps) == 11 * 7
    assert float(report.loss) == pytest.approx(0.01, abs=1e-5)


def test_a_fit_ends_with_its_last_chunk():
    params, report = run(lambda params, key: params["w"], lambda params: params["w"], chunks=5)
    assert int(report.steps) == 5 * 7 and float(params["w"]) == pytest.approx(5 - 0.1 * 5 * 7, abs=1e-5)


def test_steps_after_the_loss_broke_are_not_kept():
    # the loss is not finite once w is below 3
    params, report = run(
        lambda params, key: params["w"], lambda params: jnp.where(params["w"] < 3, jnp.nan, params["w"])
    )
    assert float(params["w"]) == pytest.approx(3.6, abs=1e-5) and np.isfinite(report.loss)


def test_what_gets_worse_before_it_gets_better_is_not_given_up():
    # w goes from 5 down to 0.1, past a hill of the held-out loss that is five chunks wide
    hill = lambda params: jnp.where((params["w"] > 0.6) & (params["w"] < 4.0), 9.0, params["w"])
    params, report = run(lambda params, key: params["w"], hill, chunks=7)
    assert float(params["w"]) == pytest.approx(0.1, abs=1e-5) and float(report.loss) == pytest.approx(0.1, abs=1e-5)


def test_each_step_draws_its_own_minibatch():
    # the gradient is a fresh standard normal each step: the sum of 77 of them has their spread
    @jax.jit
    def end(key):
        rest = {"chunk": 77, "chunks": 1, "key": key}
        loss = lambda params, key: params["w"] * jr.normal(key)
        params, _ = fit({"w": jnp.zeros(())}, loss, lambda params: 0 * params["w"], optax.sgd(1.0), **rest)
        return params["w"]

    ends = [float(end(key)) for key in jr.split(jr.key(3), 53)]
    assert 1e-4 < stats.chi2.cdf(np.sum(np.square(ends)) / 77, 53) < 1 - 1e-4
