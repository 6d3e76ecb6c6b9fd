"""Algorithm 1: propose a trajectory to compare, learn from the answer, and again.

An episode is cut at the question. A judge by rule answers at once; a person answers through the store, whenever
they like; neither part knows which.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jax.tree_util import Partial

from hiprl.config import Config
from hiprl.control.archive import Archive
from hiprl.control.imagined import Ends, SearchReport, SearchState
from hiprl.control.plan import Follow, planned
from hiprl.control.policy import Uniform
from hiprl.control.search import new_search, search
from hiprl.data.answer import Answer
from hiprl.data.preference import Clip, Preferences
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import FitDiverged
from hiprl.feedback.questions import pick_clips
from hiprl.hallucinated import Hallucinated
from hiprl.models.calibration import Calibration, ModelErrors, model_errors
from hiprl.models.dynamics import DynamicsState, estimate_dynamics, new_dynamics
from hiprl.models.ending import Ending, estimate_ending, new_ending
from hiprl.models.estimate import estimate_reward, new_reward
from hiprl.models.reward import BOX_MARGIN, EstimatedReward, Gap
from hiprl.rollout import J
from hiprl.types import Actor, Count, Flag, Key, Scalar
from hiprl.world.task import World

BEGINNING = (1 << 30) - 1  # folded into the run's key before the loop; no run has as many episodes
OVERPROMISE = 3.0  # times the executed return, by which imagination may exceed it before κ is halved


class Run(eqx.Module):
    """All that is known after k answers."""

    k: Count
    T: Trajectories
    P: Preferences
    dynamics: DynamicsState
    reward: EstimatedReward
    ending: Ending
    calibration: Calibration
    archive: Archive
    """The searches behind the trajectories of T."""


class Question(eqx.Module):
    """A new trajectory, and what of it and of T is to be compared."""

    tau: Trajectory
    clips: Clip
    """A stack: what is shown, in order. The new trajectory is the one after the last of T."""
    state: SearchState
    """The search whose policy was executed."""
    report: SearchReport
    """What that search believes to have reached."""
    searched: bool = eqx.field(static=True)
    """False in the warm-up, where the actions are random."""

    @property
    def shown(self) -> tuple[Clip, ...]:
        """The clips one by one."""
        of, start, length = self.clips.of, self.clips.start, self.clips.length
        return tuple(Clip(of[i], start[i], length[i]) for i in range(of.shape[0]))


@runtime_checkable
class Ask(Protocol):
    """The judge: says g(τ, τ′) of the clips of a question, or what they can."""

    def __call__(self, question: Question, run: Run, *, key: Key) -> Answer: ...


class Episode(NamedTuple):
    """What one turn of Algorithm 1's loop came to."""

    question: Question
    answer: Answer
    run: Run
    """What is known after it."""


class Scores(eqx.Module):
    """What an episode and its answer say about the models that did not know them yet."""

    calibration: Calibration
    """Taken on with the run."""
    errors: ModelErrors
    predicted: Gap
    """What r̂ expected the answer to be."""
    executed: Scalar
    """Return by r̂ of what was executed, over as many steps as the search tried its policy for in imagination."""
    overpromised: Flag
    """The search promised far more than this."""


def nothing_known(T: Trajectories, config: Config, *, key: Key) -> Run:
    """P = ∅, and models that know the units of T and nothing else."""
    dynamics_key, search_key, ending_key, reward_key = jr.split(key, 4)
    p, q = T.rows.states.shape[-1], T.rows.actions.shape[-1]
    blank = new_search(T, q + config.eta_size(p), config.search, key=search_key)
    P = Preferences.empty(config.comparisons, m=max(2, config.question.items))
    return Run(
        k=jnp.zeros((), jnp.int32),
        T=T,
        P=P,
        dynamics=new_dynamics(T, config.dynamics, key=dynamics_key),
        reward=new_reward(P, T, config.reward, key=reward_key),
        ending=new_ending(T, key=ending_key),
        calibration=Calibration.start(p, config.comparisons, kappa=config.kappa),
        archive=Archive.empty(T.capacity, blank),
    )


def no_trajectories(world: World, config: Config) -> Trajectories:
    """T = ∅ with room for all that a run will execute."""
    return Trajectories.empty(config.comparisons + 1, H=world.H, p=world.p, q=world.q)


def begin(world: World, config: Config, *, key: Key) -> Run:
    """Algorithm 1 before its loop: T = {τ_0}, by random actions."""
    model_key, world_key = jr.split(jr.fold_in(key, BEGINNING))
    tau_0 = world.roll_out(Uniform(jnp.ones(()), world.q), key=world_key)
    return nothing_known(no_trajectories(world, config).add(tau_0), config, key=model_key)


def propose(run: Run, world: World, config: Config, *, key: Key) -> Question:
    """Acts for one episode and picks what to compare."""
    search_key, world_key, pick_key = jr.split(key, 3)
    asked = partial(pick_clips, reward=run.reward, config=config.question, key=pick_key)  # τ′ ~ T, or the most telling
    state, setbacks = restart(run, config)
    if int(run.k) + 1 < config.warm_up:
        random = Uniform.draw(world.q, key=search_key) if config.babble == "varied" else Uniform(jnp.ones(()), world.q)
        tau = world.roll_out(random, key=world_key)
        return Question(tau, asked(run.T.add(tau)), state, SearchReport.nothing(), searched=False)
    f_tilde = hallucinated(run, config)  # μ + βση, eq. (5)
    ends = ends_of(run, world)
    more = {"setbacks": setbacks, "key": search_key}
    state, report = search(f_tilde, run.reward, ends, run.T, state, config.search, **more)  # eq. (6)
    acting = planned(state, f_tilde, run.reward, ends, config.plan, q=world.q, gamma=config.search.discount(world.H))
    tau = world.roll_out(acting, key=world_key)  # plans (a, η), executes a
    return Question(tau, asked(run.T.add(tau)), state, report, searched=True)


def learn(run: Run, question: Question, answer: Answer, world: World, config: Config, *, key: Key) -> Run:
    """Takes the answer in and refits the models.

    Raises:
        FitDiverged: the loss of the dynamics model is not finite.
    """
    dynamics_key, ending_key = jr.split(key)
    T = run.T.add(question.tau)
    P = run.P.answered(answer, question.shown, at_hand=T.count)
    calibration = scored(run, question, number_of(answer), config).calibration
    reward = estimate_reward(P, T, run.reward, config.reward)  # eq. (7)
    dynamics, ending = run.dynamics, run.ending
    if int(run.k) + 2 >= config.warm_up:  # the next episode will search
        first = int(run.k) + 2 == config.warm_up
        steps = config.dynamics.cold_steps if first else config.dynamics.warm_steps
        dynamics, fitted = estimate_dynamics(T, dynamics, config.dynamics, steps=steps, key=dynamics_key)
        if not jnp.isfinite(fitted.loss):
            raise FitDiverged(
                f"the dynamics model of episode {int(run.k) + 1} lost its numbers: the loss is not finite after any "
                "of its training steps. All up to here is stored: try a smaller learning rate, or another seed."
            )
        if world.ends and world.terminates is None:
            ending = estimate_ending(T, ending, key=ending_key)
    archive = run.archive.put(T.last, question.state) if question.searched else run.archive
    return Run(run.k + 1, T, P, dynamics, reward, ending, calibration, archive)


def episode(run: Run, world: World, config: Config, ask: Ask, *, key: Key) -> Episode:
    """Episode k. `key` is the run's own: a stopped run goes on with the same draws."""
    propose_key, ask_key, learn_key = jr.split(jr.fold_in(key, run.k), 3)
    question = propose(run, world, config, key=propose_key)
    answer = ask(question, run, key=ask_key)
    return Episode(question, answer, learn(run, question, answer, world, config, key=learn_key))


def restart(run: Run, config: Config) -> tuple[SearchState, Count]:
    """Where the next search begins, and how many searches from there went wrong.

    It begins at the executed policy that the newest r̂ ranks best, or at the newest one. A search that went wrong is
    one whose policy did worse in the world than an older one, by r̂ and never by the true reward. To begin at the best
    of the archive is to notice it and to recover at once; to search less far from there, to learn from it.
    """
    if not config.restart:
        return run.archive.get(run.T.last), jnp.zeros((), jnp.int32)
    best = run.archive.best(run.reward.returns(run.T))
    return run.archive.get(best), jnp.where(run.archive.filled[best], run.T.last - best, 0)


def hallucinated(run: Run, config: Config) -> Hallucinated:
    """f̃ with the calibrated β, kept in the box of what was seen."""
    low, high = run.T.box(margin=BOX_MARGIN)
    ensemble = run.dynamics.ensemble
    return Hallucinated(
        dynamics=ensemble,
        beta=run.calibration.kappa * run.calibration.beta,
        bonus=config.bonus * run.reward.unit,
        step_scale=ensemble.step_scale,
        low=low,
        high=high,
        mode=config.optimism,
    )


def number_of(answer: Answer) -> Scalar:
    """The number that an answer is; NaN where it is of another form."""
    return jnp.asarray(answer.value if answer.form == "number" else jnp.nan, jnp.float32)


def ends_of(run: Run, world: World) -> Ends | None:
    """When imagined episodes terminate: by the known rule, by the learned one, or never."""
    if not world.ends:
        return None
    return run.ending if world.terminates is None else Partial(world.terminates)


@partial(jax.jit, static_argnames=("config",))
def scored(run: Run, question: Question, g: Scalar, config: Config) -> Scores:
    """The models as they were before, judged by an episode and an answer that they have not seen."""
    T = run.T.add(question.tau)
    guess = run.reward.gap(T.clip(question.shown[0]), T.clip(question.shown[-1]))
    nothing = jnp.asarray(jnp.nan)  # before the first answer not even the scale of an answer is known
    predicted = jax.tree.map(lambda x: jnp.where(run.P.count > 0, x, nothing), guess)
    errors = model_errors(run.dynamics.ensemble, question.tau)
    first = eqx.tree_at(
        lambda tau: tau.length, question.tau, jnp.minimum(question.tau.length, config.search.trial_steps)
    )
    executed = J(first, run.reward)
    promised = question.report.imagined
    overpromised = question.searched & (promised - executed > OVERPROMISE * jnp.abs(executed))
    calibration = run.calibration.after_answer(g, predicted)
    if question.searched:
        calibration = calibration.after_episode(errors, decay=config.kappa_decay, overpromised=overpromised)
    return Scores(calibration, errors, predicted, executed, overpromised)


def confirmed(run: Run, world: World, config: Config, *, key: Key) -> tuple[Count, Count]:
    """Which policy of the archive to report, and how many steps it took to be sure.

    A policy that was lucky in its one episode should not win: what r̂ ranks best is executed again, `confirmations`
    times in all, and a policy's rank is the mean over its executions. No question is asked about them.
    """
    total = jnp.where(run.archive.filled, run.reward.returns(run.T), -jnp.inf)
    times = jnp.ones_like(total)
    steps = jnp.zeros((), jnp.int32)
    for again_key in jr.split(key, config.confirmations):
        best = jnp.argmax(total / times)
        tau = world.roll_out(actor_of(run, best, world, config), key=again_key)
        executed = no_trajectories(world, config).add(tau)
        total = total.at[best].add(run.reward.returns(executed)[0])
        times, steps = times.at[best].add(1), steps + tau.length
    return jnp.argmax(total / times).astype(jnp.int32), steps


def best_actor(run: Run, world: World, config: Config) -> Actor:
    """The policy whose executed trajectory the newest r̂ ranks best."""
    return actor_of(run, run.archive.best(run.reward.returns(run.T)), world, config)


def actor_of(run: Run, i: Count, world: World, config: Config) -> Actor:
    """The policy behind trajectory `i`, executed without exploration, and with planning only if the run planned."""
    state = run.archive.get(i)
    if config.plan.kind == "mpc":
        f_tilde, ends = hallucinated(run, config), ends_of(run, world)
        return planned(state, f_tilde, run.reward, ends, config.plan, q=world.q, gamma=config.search.discount(world.H))
    return Follow(state.policy, world.q, explore=False)
