"""When an episode terminates, learned from those that did, for worlds whose rule is not known."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import optax
from jaxtyping import Array, Float

from hiprl.data.trajectory_set import Trajectories
from hiprl.models.fit import fit
from hiprl.models.network import MLP, Scaler
from hiprl.models.rows import RowDraw
from hiprl.types import Action, Flag, Key, Scalar, State

STEPS, CHUNK, BATCH = 600, 100, 256


class Ending(eqx.Module):
    """A classifier of (s, a, s′): does the episode terminate with this step?"""

    net: MLP
    inputs: Scaler
    """Of (s, a, s′) together."""
    seen: Flag
    """Whether any episode has terminated yet. While none has, none is expected to."""

    def logit(self, s: State, a: Action, s_next: State) -> Scalar:
        """Log odds of termination, when ends and other steps are equally frequent."""
        return self.net(self.inputs.down(jnp.concatenate([s, a, s_next])))[0]

    def __call__(self, s: State, a: Action, s_next: State) -> Flag:
        return self.seen & (self.logit(s, a, s_next) > 0)


@jax.jit
def new_ending(T: Trajectories, *, key: Key) -> Ending:
    """A classifier that expects no end."""
    inputs, _ = _units(T)
    net = MLP.draw(inputs.size, (64, 64), 1, activation="silu", key=key)
    return Ending(net, inputs, jnp.asarray(False))


def _units(T: Trajectories) -> tuple[Scaler, Float[Array, "n x"]]:
    """Mean and spread of (s, a, s′), and the rows themselves."""
    rows = T.transitions()
    x = jnp.concatenate([rows.s, rows.a, rows.s_next], axis=1)
    return Scaler.of(x, rows.mask), x


@jax.jit
def estimate_ending(T: Trajectories, ending: Ending, *, key: Key) -> Ending:
    """Fits the classifier to T. Each minibatch holds as many ends as other steps, since ends are rare."""
    rows = T.transitions()
    inputs, x = _units(T)
    net = ending.net.with_input_scaler(ending.inputs, inputs)
    z = jax.vmap(inputs.down)(x)
    ends, others = RowDraw.of(rows.mask & rows.terminated), RowDraw.of(rows.mask & ~rows.terminated)

    def minibatch(key: Key) -> tuple[Float[Array, "n x"], Float[Array, "n x"]]:
        end_key, other_key = jr.split(key)
        half = (BATCH // 2,)
        return z[ends(end_key, half)], z[others(other_key, half)]

    def loss(net: MLP, at_end: Float[Array, "n x"], before: Float[Array, "n x"]) -> Scalar:
        ended, went_on = jax.vmap(net)(at_end), jax.vmap(net)(before)
        return jnp.mean(jax.nn.softplus(-ended)) + jnp.mean(jax.nn.softplus(went_on))

    fit_key, judge_key = jr.split(key)
    judged = minibatch(judge_key)
    net, _ = fit(
        net,
        lambda net, key: loss(net, *minibatch(key)),
        lambda net: loss(net, *judged),
        optax.adamw(1e-3, weight_decay=1e-3),
        chunk=CHUNK,
        chunks=STEPS // CHUNK,
        key=fit_key,
    )
    return Ending(net, inputs, ends.count > 0)
