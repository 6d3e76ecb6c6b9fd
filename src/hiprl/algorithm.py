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
from hiprl.control.dream import dream
from hiprl.control.imagined import Ends, SearchReport, SearchState
from hiprl.control.plan import Noisy, planned
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
from hiprl.types import Count, Flag, Key, Scalar
from hiprl.world.task import World

BEGINNING = (1 << 30) - 1  # folded into the run's key before the loop; no run has as many episodes
LOST = 2  # setbacks at a policy that is worse than random actions, after which a search begins anew
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


class Attempt(eqx.Module):
    """An episode in the world, and the search behind it."""

    tau: Trajectory
    state: SearchState
    """The search whose policy was executed."""
    report: SearchReport
    """What that search believes to have reached."""
    searched: bool = eqx.field(static=True)
    """False in the warm-up, where the actions are random."""
    dream: Trajectory | None = None
    """What its policy does in the model; None where nobody is asked about that."""

    def added(self, T: Trajectories) -> Trajectories:
        """T with what came of this."""
        return (T if self.dream is None else T.add(self.dream)).add(self.tau)


class Question(eqx.Module):
    """A new trajectory, and what of it and of T is to be compared."""

    attempt: Attempt
    clips: Clip
    """A stack: what is shown, in order. The new trajectory is the last of T once it was added."""

    @property
    def tau(self) -> Trajectory:
        """The new trajectory."""
        return self.attempt.tau

    @property
    def shown(self) -> tuple[Clip, ...]:
        """The clips one by one."""
        return self.clips.each()


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
    """What an episode says about the models that did not know it yet."""

    calibration: Calibration
    """Taken on with the run."""
    errors: ModelErrors
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
    return Trajectories.empty(config.trajectories, H=world.H, p=world.p, q=world.q)


def begin(world: World, config: Config, *, key: Key) -> Run:
    """Algorithm 1 before its loop: T = {τ_0}, by random actions."""
    model_key, world_key = jr.split(jr.fold_in(key, BEGINNING))
    tau_0 = world.roll_out(Uniform(jnp.ones(()), world.q), key=world_key)
    return nothing_known(no_trajectories(world, config).add(tau_0), config, key=model_key)


def attempt(run: Run, world: World, config: Config, *, key: Key) -> Attempt:
    """Searches in the hallucinated model, and acts for one episode.

    Raises:
        FitDiverged: what the search believes to have reached is not finite.
    """
    search_key, world_key, dream_key = jr.split(key, 3)
    state, setbacks = restart(run, config)
    if int(run.k) + 1 < config.warm_up:
        random = Uniform.draw(world.q, key=search_key) if config.babble == "varied" else Uniform(jnp.ones(()), world.q)
        return Attempt(world.roll_out(random, key=world_key), state, SearchReport.nothing(), searched=False)
    f_tilde = hallucinated(run, world, config)  # μ + βση, eq. (5)
    ends = ends_of(run, world)
    more = {"setbacks": setbacks, "anywhere": world.anywhere, "key": search_key}
    state, report = search(f_tilde, run.reward, ends, run.T.executed(), state, config.search, **more)  # eq. (6)
    if not report.finite:
        raise FitDiverged(
            f"the policy search of episode {int(run.k) + 1} gave numbers that are not finite; imagined returns must be "
            "finite. The run is stored up to the episode before: try a smaller learning rate, or another seed."
        )
    acting = planned(state, f_tilde, run.reward, ends, config.plan, q=world.q, gamma=config.search.discount(world.H))
    tau = world.roll_out(Noisy(acting, config.plan.noise), key=world_key)  # plans (a, η), executes a
    if not config.question.imagined:
        return Attempt(tau, state, report, searched=True)
    imagined = dream(f_tilde, state.policy, ends, run.T, key=dream_key)
    return Attempt(tau, state, report, searched=True, dream=world.priced(imagined))


def propose(run: Run, world: World, config: Config, *, key: Key) -> Question:
    """Acts for one episode and picks what to compare."""
    act_key, pick_key = jr.split(key)
    new = attempt(run, world, config, key=act_key)
    return Question(new, pick_clips(new.added(run.T), run.reward, config.question, key=pick_key))  # τ′ ~ T, or better


def learn(run: Run, question: Question, answer: Answer, world: World, config: Config, *, key: Key) -> Run:
    """Takes the answer in and refits the models.

    Raises:
        FitDiverged: the loss of the dynamics model is not finite.
    """
    calibration = scored(run, question.attempt, config).calibration
    calibration = calibration.after_answer(number_of(answer), expected(run, question))
    T = question.attempt.added(run.T)
    P = run.P.answered(answer, question.shown, at_hand=T.count)
    reward = estimate_reward(P, T, run.reward, config.reward)  # eq. (7)
    known = eqx.tree_at(lambda run: (run.k, run.P, run.reward), run, (run.k + 1, P, reward))
    return lived(known, question.attempt, calibration, world, config, key=key)


def practise(run: Run, world: World, config: Config, *, key: Key) -> Run:
    """An episode that nobody is asked about: all but r̂ learns from it."""
    act_key, learn_key = jr.split(key)
    new = attempt(run, world, config, key=act_key)
    return lived(run, new, scored(run, new, config).calibration, world, config, key=learn_key)


def episode(run: Run, world: World, config: Config, ask: Ask, *, key: Key) -> Episode:
    """Episode k. `key` is the run's own: a stopped run goes on with the same draws."""
    propose_key, ask_key, learn_key, _ = jr.split(jr.fold_in(key, run.k), 4)
    question = propose(run, world, config, key=propose_key)
    answer = ask(question, run, key=ask_key)
    return Episode(question, answer, learn(run, question, answer, world, config, key=learn_key))


def practised(run: Run, world: World, config: Config, *, key: Key) -> Run:
    """The run after the practice that belongs to its newest answer. `key` is the run's own."""
    *_, practice_key = jr.split(jr.fold_in(key, run.k - 1), 4)
    for again_key in jr.split(practice_key, config.practice_after(int(run.k))):
        run = practise(run, world, config, key=again_key)
    return run


def lived(run: Run, new: Attempt, calibration: Calibration, world: World, config: Config, *, key: Key) -> Run:
    """The run with one more episode in T, and the model of the world refitted to it.

    Raises:
        FitDiverged: its loss is not finite.
    """
    dynamics_key, ending_key = jr.split(key)
    T = new.added(run.T)
    archive = run.archive.put(T.last, new.state) if new.searched else run.archive
    dynamics, ending = run.dynamics, run.ending
    if int(run.k) + 1 >= config.warm_up:  # the next episode will search
        steps = config.dynamics.warm_steps if new.searched else config.dynamics.cold_steps
        dynamics, fitted = estimate_dynamics(T.executed(), dynamics, config.dynamics, steps=steps, key=dynamics_key)
        if not jnp.isfinite(fitted.loss):
            raise FitDiverged(
                f"the dynamics model of episode {int(run.k)} lost its numbers: the loss is not finite after any "
                "of its training steps. All up to here is stored: try a smaller learning rate, or another seed."
            )
        if world.ends and world.terminates is None:
            ending = estimate_ending(T.executed(), ending, key=ending_key)
    made = (T, dynamics, ending, calibration, archive)
    return eqx.tree_at(lambda run: (run.T, run.dynamics, run.ending, run.calibration, run.archive), run, made)


@partial(jax.jit, static_argnames=("config",))
def restart(run: Run, config: Config) -> tuple[SearchState, Count]:
    """Where the next search begins, and how many searches from there went wrong.

    It begins at the executed policy that the newest r̂ ranks best, or at the newest one. A search that went wrong is
    one whose policy did worse in the world than an older one, by r̂ and never by the true reward. To begin at the best
    of the archive is to notice it and to recover at once; to search less far from there, to learn from it. Where even
    the best is worse than random actions were, and does not improve, a search begins anew: an r̂ that was wrong at
    first can have led where no gradient leads back.
    """
    if not config.restart:
        return run.archive.get(run.T.last), jnp.zeros((), jnp.int32)
    tried, returns = run.archive.filled, run.reward.returns(run.T)
    best = run.archive.best(returns)
    setbacks = jnp.sum(tried & (jnp.arange(run.T.capacity) > best))
    random = jnp.max(jnp.where(run.T.real & ~tried, returns, -jnp.inf))
    lost = (setbacks >= LOST) & (returns[best] < random)
    start = jnp.where(lost, 0, best)  # τ_0 is random: nothing is behind it
    return run.archive.get(start), jnp.where(lost, 0, setbacks)


def hallucinated(run: Run, world: World, config: Config) -> Hallucinated:
    """f̃ with the calibrated β, kept in the box of what was seen, and of what the world says can be."""
    low, high = run.T.executed().box(margin=BOX_MARGIN, also=world.anywhere)
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
def scored(run: Run, new: Attempt, config: Config) -> Scores:
    """The models as they were before, judged by an episode that they have not seen."""
    errors = model_errors(run.dynamics.ensemble, new.tau)
    first = eqx.tree_at(lambda tau: tau.length, new.tau, jnp.minimum(new.tau.length, config.search.trial_steps))
    executed = J(first, run.reward)
    overpromised = new.searched & (new.report.imagined - executed > OVERPROMISE * jnp.abs(executed))
    calibration = run.calibration
    if new.searched:
        calibration = calibration.after_episode(errors, decay=config.kappa_decay, overpromised=overpromised)
    return Scores(calibration, errors, executed, overpromised)


@jax.jit
def expected(run: Run, question: Question) -> Gap:
    """What r̂ expects of an answer; NaN before the first, when not even the scale of one is known."""
    T = question.attempt.added(run.T)
    guess = run.reward.gap(T.clip(question.shown[0]), T.clip(question.shown[-1]))
    return jax.tree.map(lambda x: jnp.where(run.P.count > 0, x, jnp.nan), guess)
