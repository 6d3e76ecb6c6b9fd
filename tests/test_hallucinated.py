import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jaxtyping import Array, Float

from hiprl.hallucinated import OPTIMISM, Hallucinated, hallucinate
from hiprl.types import Dynamics, Prediction
from tests.data.samples import M, p, seeds

STILL = jnp.zeros(p)
S, A_, U = jnp.array([0.3, -1.2, 0.7]), jnp.array([0.4, -0.9]), jnp.array([0.5, -1.0, 0.25])


class Sure(Dynamics):
    """One belief of which it is certain: s′ = s + shift."""

    shift: Float[Array, " p"]

    def predict(self, s, a):
        return Prediction(s + self.shift, jnp.zeros_like(s), jnp.zeros_like(s))

    def members(self):
        return jax.tree.map(lambda x: x[None], self)


class Torn(Dynamics):
    """Members that shift by different amounts; σ is as given, and so is the noise."""

    shifts: Float[Array, "M p"]
    sigma: Float[Array, " p"]
    noise: Float[Array, " p"]

    def predict(self, s, a):
        return Prediction(s + jnp.mean(self.shifts, axis=0) + 0.1 * a[0], self.sigma, self.noise)

    def members(self):
        return jax.vmap(Sure)(self.shifts)


def model(mode, *, beta=1.7, noise=0.0, reach=9.0, bonus=2.5):
    shifts = jnp.asarray(np.random.default_rng(7).normal(size=(M, p)), jnp.float32)
    return Hallucinated(
        dynamics=Torn(shifts, jnp.array([0.2, 0.5, 0.3]), jnp.full(p, noise)),
        beta=jnp.full(p, beta),
        bonus=jnp.asarray(bonus),
        step_scale=jnp.array([0.5, 2.0, 1.5]),
        low=jnp.full(p, -reach),
        high=jnp.full(p, reach),
        mode=mode,
    )


def output(mode):
    """What a policy gives in this mode: actions, and η where the policy has to choose it."""
    return jnp.concatenate([A_, U]) if mode == "eta_policy" else A_


@given(seeds)
def test_without_eta_the_mean_comes_back(seed):
    rng = np.random.default_rng(seed)
    mu, sigma, beta = (jnp.asarray(rng.uniform(0.1, 3, p), jnp.float32) for _ in range(3))
    np.testing.assert_array_equal(hallucinate(mu, sigma, jnp.zeros(p), beta), mu)
    np.testing.assert_array_equal(hallucinate(mu, sigma, jnp.ones(p), 0 * beta), mu)


@given(seeds, st.floats(0, 5))
def test_no_eta_leads_further_than_beta_sigma(seed, width):
    rng = np.random.default_rng(seed)
    mu, sigma = jnp.asarray(rng.normal(size=p), jnp.float32), jnp.asarray(rng.uniform(0, 3, p), jnp.float32)
    eta, beta = jnp.asarray(rng.uniform(-1, 1, p), jnp.float32), jnp.full(p, width)
    away = np.abs(hallucinate(mu, sigma, eta, beta) - mu)
    assert (away <= np.asarray(beta * sigma) + 1e-5).all()
    edge = np.abs(hallucinate(mu, sigma, jnp.sign(eta), beta) - mu)
    np.testing.assert_allclose(edge, beta * sigma, atol=1e-5)


@pytest.mark.parametrize("mode", OPTIMISM)
def test_an_output_is_split_into_the_action_and_eta(mode):
    f_tilde = model(mode)
    a, eta = f_tilde.split(output(mode))
    np.testing.assert_array_equal(a, A_)
    np.testing.assert_array_equal(eta, U if mode == "eta_policy" else np.zeros(p))
    assert f_tilde.eta_size == (p if mode == "eta_policy" else 0)


@pytest.mark.parametrize("mode", ["greedy", "thompson", "bonus", "eta_sign"])
def test_without_a_reason_to_hope_the_step_is_the_mean(mode):
    f_tilde = model(mode)
    s_next, _ = f_tilde.step(S, A_, draw=STILL)
    np.testing.assert_allclose(s_next, f_tilde.dynamics.predict(S, A_).mu, rtol=1e-6)


def test_the_policy_chooses_eta():
    f_tilde = model("eta_policy", beta=1.7)
    s_next, _ = f_tilde.step(S, output("eta_policy"), draw=STILL)
    by_hand = np.asarray(f_tilde.dynamics.predict(S, A_).mu) + 1.7 * np.array([0.2, 0.5, 0.3]) * np.array(
        [0.5, -1, 0.25]
    )
    np.testing.assert_allclose(s_next, by_hand, rtol=1e-6)


@given(st.lists(st.sampled_from([-3.0, -0.2, 0.4, 2.0]), min_size=p, max_size=p))
def test_eta_is_the_sign_of_the_slope_of_the_value(slope):
    f_tilde, w = model("eta_sign", beta=0.8), jnp.asarray(slope)
    s_next, _ = f_tilde.step(S, A_, value=lambda s: w @ s, draw=STILL)
    by_hand = np.asarray(f_tilde.dynamics.predict(S, A_).mu) + 0.8 * np.array([0.2, 0.5, 0.3]) * np.sign(slope)
    np.testing.assert_allclose(s_next, by_hand, rtol=1e-5)


def test_the_slope_is_that_at_the_mean_and_no_step_is_better_to_first_order():
    f_tilde = model("eta_sign", beta=0.01)
    value = lambda s: jnp.sin(2 * s[0]) + s[1] ** 2 - s[2] * s[0]
    reached = float(value(f_tilde.step(S, A_, value=value, draw=STILL)[0]))
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(p, -1).T
    belief = f_tilde.dynamics.predict(S, A_)
    best = max(
        float(value(hallucinate(belief.mu, belief.sigma, jnp.asarray(c, jnp.float32), f_tilde.beta))) for c in corners
    )
    assert reached >= best - 1e-6


def test_a_bonus_is_paid_for_being_unsure_and_only_in_its_mode():
    by_hand = 2.5 * np.sqrt(np.mean((np.array([0.2, 0.5, 0.3]) / np.array([0.5, 2.0, 1.5])) ** 2))
    for mode in OPTIMISM:
        _, bonus = model(mode, bonus=2.5).step(S, output(mode), draw=STILL)
        np.testing.assert_allclose(float(bonus), by_hand if mode == "bonus" else 0.0, rtol=1e-6)


def test_thompson_spreads_rollouts_over_the_members():
    f_tilde = model("thompson")
    worlds, axis = f_tilde.worlds()
    assert axis == 0
    s_next, _ = jax.vmap(lambda world: world.step(S, A_, draw=STILL))(worlds)
    np.testing.assert_allclose(s_next, np.asarray(S) + np.asarray(f_tilde.dynamics.shifts), rtol=1e-6)


@pytest.mark.parametrize("mode", [mode for mode in OPTIMISM if mode != "thompson"])
def test_the_other_modes_share_one_model(mode):
    f_tilde = model(mode)
    worlds, axis = f_tilde.worlds()
    assert worlds is f_tilde and axis is None


@pytest.mark.parametrize("mode", OPTIMISM)
def test_a_pessimist_sees_each_member_without_any_hope(mode):
    f_tilde = model(mode)
    each = f_tilde.in_each_member()
    assert jax.tree.leaves(each)[0].shape[0] == M
    s_next, _ = jax.vmap(lambda world: world.step(S, output(mode), draw=STILL))(each)
    np.testing.assert_allclose(s_next, np.asarray(S) + np.asarray(f_tilde.dynamics.shifts), rtol=1e-6)


def test_the_noise_is_a_draw_times_the_spread_that_the_model_says():
    f_tilde = model("greedy", noise=0.4)
    draw = jnp.array([0.5, -2.0, 1.25])
    s_next, _ = f_tilde.step(S, A_, draw=draw)
    mu = np.asarray(f_tilde.dynamics.predict(S, A_).mu)
    np.testing.assert_allclose(s_next, mu + 0.4 * np.asarray(draw), rtol=1e-5)


def test_imagined_states_stay_in_the_box():
    f_tilde = model("greedy", noise=50.0, reach=0.9)
    s_next, _ = jax.vmap(lambda draw: f_tilde.step(S, A_, draw=draw))(jr.normal(jr.key(3), (31, p)))
    assert (np.abs(s_next) <= 0.9 + 1e-6).all()
