"""Which of the policies that were executed a run reports: the one that the newest r̂ ranks best by what it did."""

from __future__ import annotations

import math

import jax.numpy as jnp
import jax.random as jr
import numpy as np

from hiprl.algorithm import Run, ends_of, hallucinated
from hiprl.config import Config
from hiprl.control.plan import Follow, planned
from hiprl.data.trajectory_set import Trajectories
from hiprl.types import Actor, Count, Key
from hiprl.world.task import World

EACH = 5  # confirmations for each of the policies among which they choose


def confirmed(run: Run, world: World, config: Config, *, key: Key) -> tuple[Count, Count]:
    """Which policy of the archive to report, and how many steps it took to be sure.

    A policy that was lucky in its one episode should not win, nor one that owes its luck to the noise in its actions.
    The few that r̂ ranks best are executed again without noise; the better half of them by the mean of these stays, and
    so on, with as many of the `confirmations` in each round, until one is left. All meet the same draws (where an
    episode begins, noise in the world), so that what differs is theirs. No question is asked about these episodes.

    Source: sequential halving, Karnin et al. (2013), "Almost optimal exploration in multi-armed bandits".
    """
    returns = np.asarray(run.reward.returns(run.T))
    ranked = sorted(map(int, np.flatnonzero(run.archive.filled)), key=lambda i: -returns[i]) or [0]
    left = config.confirmations
    alive = ranked[: max(2, left // EACH)] if left > 1 else ranked[:1]
    draws = list(jr.split(key, left)) if left else []
    executed: dict[int, list[float]] = {i: [] for i in alive}
    actors = {i: actor_of(run, i, world, config) for i in alive}
    nothing, steps = Trajectories.empty(1, H=world.H, p=world.p, q=world.q), jnp.zeros((), jnp.int32)
    for rounds in range(math.ceil(math.log2(len(alive))), 0, -1):
        each = max(1, left // rounds // len(alive))
        left -= each * len(alive)
        for i in alive * each:
            tau = world.roll_out(actors[i], key=jr.clone(draws[len(executed[i])]))
            executed[i].append(float(run.reward.returns(nothing.add(tau))[0]))
            steps += tau.length
        alive = sorted(alive, key=lambda i: np.mean(executed[i]), reverse=True)[: (len(alive) + 1) // 2]
    return jnp.asarray(alive[0], jnp.int32), steps


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
