"""EstDynamics(T): the ensemble fitted to all transitions seen so far."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Float, UInt32

from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.models.ensemble import Ensemble, Member
from hiprl.models.fit import FitReport, fit
from hiprl.models.network import FEW, Activation, Scaler, state_action_scaler, step_scaler
from hiprl.models.rows import RowDraw
from hiprl.types import Count, Key, Scalar

SPREAD = 10.0
"""A fit begins anew once an input is so many times as wide as it was. Weights that fit a small region are too steep
for a large one: their variance is at its bound there, where it has no gradient, and errors count for nothing."""
NEW_WEIGHTS, LOUDNESS = 2, 3  # folded into the key of a fit
JUDGED = 1024  # transitions by which a fit is judged
WEIGHED = 8192  # those by which the noise is
LEAST = 1e-3  # share of the variance of its noise that is left of it


@dataclass(frozen=True, kw_only=True)
class DynamicsConfig:
    """How the dynamics ensemble is built and fitted."""

    M: int = 5
    """Members of the ensemble (paper: 5)."""
    hidden: tuple[int, ...] | None = None
    """Units of the hidden layers (paper: two layers of 32); None for three layers of 128, or two of 64 where s and a
    have 8 entries together at most."""
    activation: Activation = "silu"
    """Between layers (paper: relu)."""
    learning_rate: float = 3e-3
    """Greatest of AdamW's rate, which rises at the start of each fit and falls towards its end (paper: 1e-3)."""
    weight_decay: float = 1e-4
    """Of AdamW; 0 gives Adam."""
    batch: int = 256
    """Rows a member sees in one gradient step."""
    cold_steps: int = 2000
    """Gradient steps of the first fit."""
    warm_steps: int = 1600
    """Gradient steps of each later fit, which starts where the last one ended."""
    chunk: int = 100
    """Gradient steps between two looks at the held-out loss."""
    held_out: float = 0.1
    """Share of the transitions that no member trains on."""
    bootstrap: bool = True
    """Whether each member weighs the transitions by Poisson(1) draws of its own (paper: no)."""
    quieten: bool = True
    """Whether a member's noise is lowered to its errors where it is larger (paper: no)."""

    def __post_init__(self) -> None:
        if self.M < 2:
            raise InputError(
                f"got an ensemble of M = {self.M}; at least 2 members are needed, as σ is the spread of their means. "
                "Take 5, as the paper does."
            )

    def layers(self, size: int) -> tuple[int, ...]:
        """Units of the hidden layers, where s and a have `size` entries together."""
        usual = (64, 64) if size <= FEW else (128, 128, 128)
        return usual if self.hidden is None else self.hidden


class DynamicsState(eqx.Module):
    """The ensemble, and the draw by which each member weighs each transition for the whole run."""

    ensemble: Ensemble
    bootstrap: UInt32[Array, "..."]
    """Raw data of the key from which the weights are made again for every fit."""


@partial(jax.jit, static_argnames=("config",))
def new_dynamics(T: Trajectories, config: DynamicsConfig, *, key: Key) -> DynamicsState:
    """An ensemble that knows no more of the world than its units: those of T."""
    net_key, bootstrap_key = jr.split(key)
    ensemble = drawn(state_action_scaler(T), step_scaler(T), config, key=net_key)
    return DynamicsState(ensemble, jr.key_data(bootstrap_key))


def drawn(inputs: Scaler, steps: Scaler, config: DynamicsConfig, *, key: Key) -> Ensemble:
    """One with new weights, for (s, a) and s′ - s in these units."""
    shape = {"M": config.M, "hidden": config.layers(inputs.size), "activation": config.activation}
    return Ensemble.draw(inputs, steps, **shape, key=key)


def nll(member: Member, s: Float[Array, " p"], a: Float[Array, " q"], step: Float[Array, " p"]) -> Scalar:
    """Negative log likelihood of a standardised step s′ - s, summed over dimensions, less its constant."""
    mean, var = member.standardised(s, a)
    return 0.5 * jnp.sum((step - mean) ** 2 / var + jnp.log(var))


def one_cycle(peak: float, steps: Count, now: Count) -> Scalar:
    """Learning rate at step `now` of `steps`: up from a tenth of the peak in a tenth of the time, then down; cosines.

    `steps` may be traced, so that short and long fits are one program. Source: Smith and Topin (2018).
    """
    share = now / steps
    up, down = jnp.clip(share / 0.1, 0.0, 1.0), jnp.clip((share - 0.1) / 0.9, 0.0, 1.0)
    rising = 0.1 + 0.9 * 0.5 * (1 - jnp.cos(jnp.pi * up))
    return peak * jnp.where(share < 0.1, rising, 0.5 * (1 + jnp.cos(jnp.pi * down)))


@partial(jax.jit, static_argnames=("config",))
def estimate_dynamics(
    T: Trajectories, state: DynamicsState, config: DynamicsConfig, *, steps: Count | int, key: Key
) -> tuple[DynamicsState, FitReport]:
    """Fits the ensemble to T, from the weights it has, by `steps` gradient steps: whole chunks of them.

    Where T has spread to far more than it was, it begins with new weights instead, and takes at least `cold_steps`.

    Source: HIP-RL Algorithm 1, EstDynamics; Appendix B.
    """
    rows = T.transitions()
    inputs, scaler = state_action_scaler(T), step_scaler(T)
    same = jax.vmap(Member.rescaled, in_axes=(0, None, None))(state.ensemble.stack, inputs, scaler)
    new = drawn(inputs, scaler, config, key=jr.fold_in(key, NEW_WEIGHTS)).stack
    anew = jnp.any(inputs.std[None] > SPREAD * state.ensemble.stack.inputs.std)
    stack = jax.tree.map(partial(jnp.where, anew), new, same)
    steps = jnp.where(anew, jnp.maximum(steps, config.cold_steps), steps)
    targets = jax.vmap(scaler.down)(rows.s_next - rows.s)

    weight_key, held_key = jr.split(jr.wrap_key_data(state.bootstrap))
    n, M = rows.mask.shape[0], config.M
    weights = jr.poisson(weight_key, 1.0, (M, n)) if config.bootstrap else jnp.ones((M, n))
    held = jr.bernoulli(held_key, config.held_out, (n,))
    held = held & (jnp.sum(rows.mask & held) > 0)  # nothing held out yet: judge by the training rows
    train_draw = RowDraw.of(rows.mask & ~held)
    held_draw = RowDraw.of(rows.mask & jnp.where(jnp.any(held), held, True))

    net_of = lambda stack: stack.net  # the scalers are not trained

    def member_loss(net, weight, idx):
        member = Member(net, inputs, scaler)
        loss = jax.vmap(nll, in_axes=(None, 0, 0, 0))(member, rows.s[idx], rows.a[idx], targets[idx])
        return jnp.mean(weight[idx] * loss)

    def train_loss(nets, step_key: Key) -> Scalar:
        idx = train_draw(step_key, (M, config.batch))
        return jnp.sum(jax.vmap(member_loss)(nets, weights.astype(jnp.float32), idx))

    fit_key, judge_key = jr.split(key)
    judged = held_draw(judge_key, (JUDGED,))

    def held_out_loss(nets) -> Scalar:
        ones = jnp.ones(n)
        return jnp.mean(jax.vmap(member_loss, in_axes=(0, None, None))(nets, ones, judged))

    chunks = jnp.maximum(steps // config.chunk, 1)
    rate = lambda now: one_cycle(config.learning_rate, chunks * config.chunk, jnp.asarray(now))
    nets, report = fit(
        net_of(stack),
        train_loss,
        held_out_loss,
        optax.adamw(rate, weight_decay=config.weight_decay),
        chunk=config.chunk,
        chunks=chunks,
        key=fit_key,
    )
    fitted = eqx.tree_at(net_of, stack, nets)
    if config.quieten:
        weighed = held_draw(jr.fold_in(key, LOUDNESS), (WEIGHED,))
        seen = rows.s[weighed], rows.a[weighed], targets[weighed]
        fitted = jax.vmap(no_louder_than_its_errors, in_axes=(0, None, None, None))(fitted, *seen)
    return DynamicsState(Ensemble(fitted), state.bootstrap), report


def no_louder_than_its_errors(
    member: Member, s: Float[Array, "n p"], a: Float[Array, "n q"], step: Float[Array, "n p"]
) -> Member:
    """The member with its noise lowered, where on these steps it is larger than the member's errors.

    The likelihood asks that squared errors are as large as variances by their ratio, on average, and that leaves
    variances too large where few rows have large errors. Imagined gaits then fall that would hold.
    """
    mean, var = jax.vmap(member.standardised)(s, a)
    errors, expected = jnp.sum((step - mean) ** 2, axis=0), jnp.sum(var, axis=0)
    return member.quieter(jnp.clip(errors / expected, LEAST, 1.0))
