import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings

from hiprl.models.network import ACTIVATIONS, MLP, Scaler, state_action_scaler, state_scaler, step_scaler
from tests.data.samples import lengths, p, q, seeds, set_of, trajectory


def scaler(rng, n):
    return Scaler(jnp.asarray(rng.normal(size=n), jnp.float32), jnp.asarray(rng.uniform(0.2, 5, n), jnp.float32))


@pytest.mark.parametrize("name", ["elu", "silu"])
def test_value_slope_and_bend_of_an_activation_are_those_that_jax_finds(name):
    x = jnp.asarray([-100.0, -10.0, -2.0, -0.3, -1e-4, 1e-4, 0.3, 2.0, 10.0, 100.0])
    ours, jaxs = ACTIVATIONS[name], getattr(jax.nn, name)
    for _ in range(3):
        np.testing.assert_allclose(jax.vmap(ours)(x), jax.vmap(jaxs)(x), rtol=1e-5, atol=1e-6)
        ours, jaxs = jax.grad(ours), jax.grad(jaxs)


@given(seeds)
def test_down_and_up_are_inverse(seed):
    rng = np.random.default_rng(seed)
    units, x = scaler(rng, p), jnp.asarray(rng.normal(size=p), jnp.float32)
    np.testing.assert_allclose(units.up(units.down(x)), x, rtol=1e-4, atol=1e-4)


@given(seeds)
def test_a_scaler_sees_the_masked_rows_only(seed):
    rng = np.random.default_rng(seed)
    x, mask = rng.normal(3, 2, (23, p)), rng.random(23) < 0.6
    mask[:2] = True
    x[~mask] = np.nan
    units = Scaler.of(jnp.asarray(x, jnp.float32), jnp.asarray(mask))
    np.testing.assert_allclose(units.mean, x[mask].mean(0), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(units.std, x[mask].std(0), rtol=1e-4, atol=1e-5)


def test_a_step_of_an_entry_that_stands_still_is_small():
    rng = np.random.default_rng(0)
    goals, taus = [-0.3, 0.1, 0.5], []
    for goal in goals:
        tau = trajectory(rng, length=5)
        taus.append(eqx.tree_at(lambda tau: tau.states, tau, tau.states.at[:, 1].set(goal)))
    units = step_scaler(set_of(taus))
    assert float(units.std[1]) == pytest.approx(0.01 * np.std(goals), rel=1e-4)
    assert (np.delete(np.asarray(units.std), 1) > 0.1).all()


def test_an_entry_that_never_varies_keeps_its_unit():
    x = jnp.asarray([[2.0, 5.0], [4.0, 5.0], [9.0, 5.0]])
    units = Scaler.of(x, jnp.ones(3, bool))
    assert units.std[1] == 1 and units.mean[1] == 5
    np.testing.assert_array_equal(units.down(jnp.array([2.0, 5.5]))[1], 0.5)


@settings(max_examples=10)
@given(seeds, lengths, lengths)
def test_the_units_of_a_set_are_those_of_its_steps(seed, n, m):
    rng = np.random.default_rng(seed)
    taus = [trajectory(rng, length=n), trajectory(rng, length=m)]
    T = set_of(taus)
    s, a, s_next = (np.concatenate([x[i] for x in map(steps_of, taus)]) for i in range(3))
    for units, rows in (
        (state_scaler(T), s),
        (state_action_scaler(T), np.concatenate([s, a], 1)),
        (step_scaler(T), s_next - s),
    ):
        np.testing.assert_allclose(units.mean, rows.mean(0), rtol=1e-4, atol=1e-5)
        spread = rows.std(0)
        np.testing.assert_allclose(units.std, np.where(spread > 1e-6, spread, 1), rtol=1e-3, atol=1e-5)


def steps_of(tau):
    n = int(tau.length)
    states, actions = np.asarray(tau.states, float), np.asarray(tau.actions, float)
    return states[:n], actions[:n], states[1 : n + 1]


@pytest.mark.parametrize("activation", ["relu", "silu", "elu", "tanh"])
def test_a_network_is_what_a_loop_over_its_layers_gives(activation):
    net = MLP.draw(p, (7, 5), q, activation=activation, key=jr.key(3))
    by_hand = {
        "relu": lambda x: np.maximum(x, 0),
        "silu": lambda x: x / (1 + np.exp(-x)),
        "elu": lambda x: np.where(x > 0, x, np.expm1(x)),
        "tanh": np.tanh,
    }[activation]
    h = x = np.array([0.3, -2.0, 1.1])
    for i, (w, b) in enumerate(zip(net.weights, net.biases, strict=True)):
        h = h @ np.asarray(w) + np.asarray(b)
        h = by_hand(h) if i < len(net.weights) - 1 else h
    np.testing.assert_allclose(net(jnp.asarray(x, jnp.float32)), h, rtol=1e-5, atol=1e-6)


def test_layers_are_drawn_so_that_their_outputs_keep_their_size():
    net = MLP.draw(211, (307,), 11, activation="relu", last_scale=0.01, key=jr.key(5))
    np.testing.assert_allclose(np.std(net.weights[0]) * np.sqrt(211), 1, rtol=0.05)
    np.testing.assert_allclose(np.std(net.weights[1]) * np.sqrt(307), 0.01, rtol=0.05)
    assert all((b == 0).all() for b in net.biases)


@given(seeds)
def test_other_units_inside_leave_the_function_as_it_was(seed):
    rng = np.random.default_rng(seed)
    old_in, new_in, old_out, new_out = (scaler(rng, n) for n in (p, p, q, q))
    net = MLP.draw(p, (7,), q, activation="tanh", key=jr.key(seed))
    other = net.with_input_scaler(old_in, new_in).with_output_scaler(old_out, new_out)
    for x in jnp.asarray(rng.normal(size=(5, p)), jnp.float32):
        before = old_out.up(net(old_in.down(x)))
        np.testing.assert_allclose(new_out.up(other(new_in.down(x))), before, rtol=2e-3, atol=2e-3)


@given(seeds)
def test_outputs_past_the_scaled_ones_are_left_alone(seed):
    rng = np.random.default_rng(seed)
    net = MLP.draw(p, (7,), q + 3, activation="tanh", key=jr.key(seed))
    other = net.with_output_scaler(scaler(rng, q), scaler(rng, q))
    x = jnp.asarray(rng.normal(size=p), jnp.float32)
    np.testing.assert_array_equal(np.asarray(net(x))[q:], np.asarray(other(x))[q:])


def test_what_a_network_gives_does_not_depend_on_its_neighbours():
    net = MLP.draw(p, (7,), q, activation="silu", key=jr.key(3))
    xs = jnp.asarray(np.random.default_rng(0).normal(size=(5, p)), jnp.float32)
    np.testing.assert_allclose(jax.vmap(net)(xs)[3], net(xs[3]), rtol=1e-5)


@pytest.mark.parametrize("unit", [1e-12, 1e-6, 1.0, 1e9])
def test_no_unit_is_too_small_or_too_large(unit):
    rng = np.random.default_rng(4)
    x = rng.normal(3, 2, (23, p)) * unit
    units = Scaler.of(jnp.asarray(x, jnp.float32), jnp.ones(23, bool))
    np.testing.assert_allclose(units.std, x.std(0), rtol=1e-4)


@pytest.mark.parametrize("value", [0.1, 1234.567, 1e-9])
def test_what_rounding_leaves_of_a_constant_is_no_spread(value):
    units = Scaler.of(jnp.full((30011, p), value, jnp.float32), jnp.ones(30011, bool))
    np.testing.assert_array_equal(units.std, 1.0)
