"""Which of the policies that were executed a run reports: the one that the newest r̂ ranks best by what it did."""

from __future__ import annotations

import jax.numpy as jnp
import jax.random as jr
import numpy as np

from hiprl.algorithm import Run, ends_of, hallucinated
from hiprl.config import Config
from hiprl.control.plan import Follow, planned
from hiprl.data.trajectory_set import Trajectories
from hiprl.types import Actor, Count, Key
from hiprl.world.task import World


def confirmed(run: Run, world: World, config: Config, *, key: Key) -> tuple[Count, Count]:
    """Which policy of the archive to report, and how many steps it took to be sure.

    A policy that was lucky in its one episode should not win, nor one that owes its luck to the noise in its actions.
    Half of the `confirmations` go to as many policies that r̂ ranks best, one each and without noise, the others in turn
    to the two that are best by the mean of these; the best of all by that mean wins. No question is asked about them.
    """
    returns = np.asarray(run.reward.returns(run.T))
    ranked = sorted(map(int, np.flatnonzero(run.archive.filled)), key=lambda i: -returns[i]) or [0]
    executed: dict[int, list[float]] = {}
    mean = lambda i: float(np.mean(executed[i]))
    steps = jnp.zeros((), jnp.int32)
    for n, again_key in enumerate(jr.split(key, config.confirmations)):
        if n < min(len(ranked), (config.confirmations + 1) // 2):
            i = ranked[n]
            executed[i] = []
        else:
            i = min(sorted(executed, key=mean, reverse=True)[:2], key=lambda i: len(executed[i]))
        tau = world.roll_out(actor_of(run, i, world, config), key=again_key)
        alone = Trajectories.empty(1, H=world.H, p=world.p, q=world.q).add(tau)
        executed[i].append(float(run.reward.returns(alone)[0]))
        steps += tau.length
    best = max(executed, key=mean) if executed else ranked[0]
    return jnp.asarray(best, jnp.int32), steps


def best_actor(run: Run, world: World, config: Config) -> Actor:
    """The policy whose executed trajectory the newest r̂ ranks best."""
    return actor_of(run, run.archive.best(run.reward.returns(run.T)), world, config)


def actor_of(run: Run, i: Count | int, world: World, config: Config) -> Actor:
    """The policy behind trajectory `i`, executed without exploration, and with planning only if the run planned."""
    state = run.archive.get(i)
    if config.plan.kind == "mpc":
        f_tilde, ends = hallucinated(run, world, config), ends_of(run, world)
        return planned(state, f_tilde, run.reward, ends, config.plan, q=world.q, gamma=config.search.discount(world.H))
    return Follow(state.policy, world.q, explore=False)
