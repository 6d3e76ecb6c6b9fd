"""How far to trust the models: β for the dynamics, α for the reward, both from predictions made before the answer.

An episode is scored with the models as they were before they saw it (prequential), so nothing here flatters itself.
"""

from __future__ import annotations

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hiprl.data.trajectory import Trajectory
from hiprl.models.ensemble import Ensemble
from hiprl.models.reward import Gap
from hiprl.types import Count, Flag, Scalar

LEVEL = 0.9  # the share of errors that a calibrated width covers
NORMAL_90 = 1.6449  # of a standard normal, 90 % lies within this
MIN_BETA, MAX_BETA = 0.3, 5.0


def conformal_quantile(scores: Float[Array, " n"], count: Count) -> Scalar:
    """The ceil(LEVEL (n + 1))-th smallest of the first `count` scores, or the greatest where there are few.

    Source: split conformal prediction, Vovk et al. (2005).
    """
    ranked = jnp.sort(jnp.where(jnp.arange(scores.shape[0]) < count, scores, jnp.inf))
    rank = jnp.ceil(LEVEL * (count + 1)).astype(jnp.int32)
    return ranked[jnp.clip(jnp.minimum(rank, count) - 1, 0, scores.shape[0] - 1)]


class Calibration(eqx.Module):
    """β_k and α_k of Assumptions 2.3 and 3.1, as the run's own errors set them."""

    beta: Float[Array, " p"]
    """One a dimension: 90 % of the errors of the newest episode's μ, beyond the noise, are within β σ."""
    kappa: Scalar
    """What β is multiplied by; halved when imagination promised far more than execution gave."""
    z: Float[Array, " K"]
    """|g - ĝ| / σ_g of each answer, predicted before it came."""
    count: Count
    """How many of `z` are filled."""

    @classmethod
    def start(cls, p: int, K: int, *, kappa: float) -> Calibration:
        return cls(jnp.ones(p), jnp.asarray(kappa), jnp.zeros(K), jnp.zeros((), jnp.int32))

    @property
    def alpha(self) -> Scalar:
        """α_k: 90 % of the errors of predicted preferences are within α σ_g. 1 before any answer."""
        return jnp.where(self.count > 0, conformal_quantile(self.z, self.count), 1.0)

    def after_answer(self, g: Scalar, predicted: Gap) -> Calibration:
        """Counts one answer that was predicted before it came; a prediction without a σ_g says nothing."""
        z = jnp.abs(g - predicted.mean) / predicted.sigma
        known = jnp.isfinite(z)
        z = jnp.where(known, self.z.at[self.count].set(z), self.z)
        return eqx.tree_at(lambda c: (c.z, c.count), self, (z, self.count + known))

    def after_episode(self, seen: ModelErrors, *, decay: float, overpromised: Flag) -> Calibration:
        """Takes β from the newest episode; κ decays by rule, and is halved after a promise that was not kept."""
        kappa = self.kappa * decay * jnp.where(overpromised, 0.5, 1.0)
        return eqx.tree_at(lambda c: (c.beta, c.kappa), self, (seen.beta, kappa))


class ModelErrors(eqx.Module):
    """What a dynamics model got wrong about one trajectory that it had not seen."""

    deviation: Scalar
    """Mean distance ‖s′ - μ(s, a)‖, in the units of the state (Fig. 3)."""
    relative: Scalar
    """Root mean square error a dimension, over the size of a typical step."""
    coverage: Scalar
    """Share of the errors within the nominal 90 % of noise and σ together."""
    beta: Float[Array, " p"]
    """Width that would have covered 90 % of the errors beyond the noise."""


def model_errors(ensemble: Ensemble, tau: Trajectory) -> ModelErrors:
    """Scores one-step predictions along τ."""
    rows = tau.transitions()
    mask = rows.mask[:, None]
    count = jnp.maximum(jnp.sum(rows.mask), 1)
    belief = jax.vmap(ensemble.predict)(rows.s, rows.a)
    error = jnp.where(mask, rows.s_next - belief.mu, 0.0)
    p = error.shape[1]
    total = jnp.sqrt(belief.sigma**2 + belief.noise**2)
    covered = jnp.sum(jnp.where(mask, jnp.abs(error) <= NORMAL_90 * total, False))
    beyond_noise = jnp.sqrt(jnp.maximum(error**2 - belief.noise**2, 0.0)) / belief.sigma
    beta = jax.vmap(conformal_quantile, in_axes=(1, None))(beyond_noise, count)  # executed steps come first
    return ModelErrors(
        deviation=jnp.sum(jnp.linalg.norm(error, axis=1)) / count,
        relative=jnp.sqrt(jnp.sum((error / ensemble.step_scale[None]) ** 2) / (count * p)),
        coverage=covered / (count * p),
        beta=jnp.clip(beta, MIN_BETA, MAX_BETA),
    )


@partial(jax.jit, static_argnames=("horizons",))
def rollout_errors(ensemble: Ensemble, tau: Trajectory, horizons: tuple[int, ...]) -> Float[Array, " horizons"]:
    """Mean ‖s_{t+h} - ŝ_{t+h}‖ over t for each h, when μ is followed from s_t under the executed actions.

    NaN where the trajectory is shorter than h.
    """
    longest = max(horizons)
    H = tau.actions.shape[0]
    states = jnp.where((jnp.arange(H + 1) <= tau.length)[:, None], tau.states, 0.0)
    actions = jnp.where(tau.steps[:, None], tau.actions, 0.0)
    t = jnp.arange(H)

    def step(s_hat: Float[Array, "H p"], h: Count):
        a = actions[jnp.minimum(t + h, H - 1)]
        s_hat = jax.vmap(lambda s, a: ensemble.predict(s, a).mu)(s_hat, a)
        valid = t + h + 1 <= tau.length
        error = jnp.linalg.norm(s_hat - states[jnp.minimum(t + h + 1, H)], axis=1)
        return s_hat, jnp.sum(jnp.where(valid, error, 0.0)) / jnp.sum(valid)

    _, errors = jax.lax.scan(step, states[:-1], jnp.arange(longest))
    return errors[jnp.asarray(horizons) - 1]
