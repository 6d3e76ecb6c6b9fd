"""What a policy does in the model, as a trajectory to be asked about."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr

from hiprl.control.imagined import Ends
from hiprl.control.plan import Follow
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.hallucinated import Hallucinated
from hiprl.rollout import roll_out
from hiprl.types import Action, Key, Policy, State, stacked_size


@jax.jit
def dream(f_tilde: Hallucinated, policy: Policy, ends: Ends | None, T: Trajectories, *, key: Key) -> Trajectory:
    """An episode of a policy, without exploration, in one member of the belief, drawn by chance. It earns NaN.

    Args:
        f_tilde: the model; of its optimism nothing is used, so that what is shown is likely.
        policy: what a search found.
        ends: when the episode terminates; None for never.
        T: trajectories, in one of whose first states it begins.
    """
    which_key, start_key, steps_key = jr.split(key, 3)
    members = f_tilde.in_each_member()
    i = jr.randint(which_key, (), 0, stacked_size(members.dynamics))
    member = jax.tree.map(lambda x: x[i], members)
    q, unused = T.rows.actions.shape[-1], jnp.zeros(f_tilde.eta_size)  # the policy's η means nothing where σ is 0

    def f(s: State, a: Action, key: Key) -> State:
        return member.step(s, jnp.append(a, unused), draw=jr.normal(key, s.shape))[0]

    tau = roll_out(
        f,
        Follow(policy, q, explore=False),
        jr.choice(start_key, T.first_states()),
        H=T.rows.actions.shape[1],
        r=lambda s, a: jnp.asarray(jnp.nan),
        terminates=ends,
        key=steps_key,
    )
    return eqx.tree_at(lambda tau: tau.imagined, tau, jnp.asarray(True))
