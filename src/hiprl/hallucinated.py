"""f̃ = μ + β σ η, eq. (5), and the other kinds of optimism, behind one switch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, TypeAlias, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hiprl.types import Action, Dynamics, Eta, Prediction, Scalar, State

Optimism: TypeAlias = Literal["greedy", "thompson", "eta_policy", "eta_sign", "bonus"]
"""How a search may use what the dynamics model does not know:

- `greedy`: not at all; the mean model.
- `thompson`: each imagined rollout lives in one member of the ensemble.
- `eta_policy`: the policy chooses η as p more actions (the paper; Curi et al., 2020).
- `eta_sign`: η = sign ∂V/∂s′, the first-order optimum of eq. (6) on the box.
- `bonus`: the mean model, and a reward for being where the model is unsure (Sukhija et al., 2025).
"""
OPTIMISM: tuple[Optimism, ...] = get_args(Optimism)


def hallucinate(mu: State, sigma: State, eta: Eta, beta: Float[Array, " p"]) -> State:
    """Next state of the optimistic model: μ + β σ ∘ η.

    Args:
        mu: mean of the predicted next state.
        sigma: epistemic standard deviation, in the units of the state.
        eta: hallucinated control; each entry in [-1, 1].
        beta: width β_k of the confidence set, one a dimension; 0 gives the mean model back.

    Source: HIP-RL eq. (5), after Curi et al. (2020).
    """
    return mu + beta * sigma * eta


class Hallucinated(eqx.Module):
    """The model in which policies are searched: a dynamics with the freedom that `mode` gives."""

    dynamics: Dynamics
    beta: Float[Array, " p"]
    """β_k, already calibrated and scaled."""
    bonus: Scalar
    """Reward a step, in the judge's unit, for a σ as large as a typical step (mode `bonus`)."""
    step_scale: Float[Array, " p"]
    """Size of a typical step s′ - s."""
    low: Float[Array, " p"]
    """Imagined states are kept above this."""
    high: Float[Array, " p"]
    mode: Optimism = eqx.field(static=True)

    @property
    def eta_size(self) -> int:
        """How many entries of a policy's output are η and not action."""
        return self.beta.shape[0] if self.mode == "eta_policy" else 0

    @property
    def hopes(self) -> bool:
        """Whether the mode is paid for, or moved by, what the model does not know."""
        return self.mode in ("eta_policy", "eta_sign", "bonus")

    def worlds(self) -> tuple[Hallucinated, int | None]:
        """The models to spread imagined rollouts over, and the axis along which to map them.

        `thompson` gives the members, stacked; every other mode gives this model, to be shared.
        """
        if self.mode != "thompson":
            return self, None
        return self.in_each_member(), 0

    def in_each_member(self) -> Hallucinated:
        """This model in each member of the belief, stacked: what a pessimist looks at."""
        alone = lambda member: eqx.tree_at(lambda f: f.dynamics, self, member)
        return jax.vmap(alone)(self.dynamics.members())

    def split(self, action_and_eta: Float[Array, " q_plus"]) -> tuple[Action, Eta]:
        """The action and the policy's own η (zero where the mode has none)."""
        q = action_and_eta.shape[0] - self.eta_size
        eta = action_and_eta[q:] if self.eta_size else jnp.zeros_like(self.beta)
        return action_and_eta[:q], eta

    def step(
        self,
        s: State,
        action_and_eta: Float[Array, " q_plus"],
        *,
        draw: State,
        value: Callable[[State], Scalar] | None = None,
    ) -> tuple[State, Scalar]:
        """The next state, noise included, and the bonus earned on the way.

        Args:
            s: where it is.
            action_and_eta: what a policy gives: q entries of action and, in mode `eta_policy`, p of η.
            draw: standard normal, for the noise of the world. A rollout draws for all its steps at once: one
                by one, the draws would cost as much as the networks.
            value: V, needed by `eta_sign`; without it that mode is greedy.
        """
        a, eta = self.split(action_and_eta)
        belief = self.dynamics.predict(s, a)
        if self.mode == "eta_sign" and value is not None:
            # V's slope is taken at μ; η is constant to the gradient of the search
            eta = jax.lax.stop_gradient(jnp.sign(jax.grad(value)(belief.mu)))
        s_next = hallucinate(belief.mu, belief.sigma, eta, self.beta) + belief.noise * draw
        return jnp.clip(s_next, self.low, self.high), self.bonus_of(belief)

    def bonus_of(self, belief: Prediction) -> Scalar:
        """λ times the size of σ, relative to a typical step. Zero but in mode `bonus`."""
        if self.mode != "bonus":
            return jnp.zeros(())
        return self.bonus * jnp.sqrt(jnp.mean((belief.sigma / self.step_scale) ** 2))
