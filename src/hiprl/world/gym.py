"""Any Gymnasium environment with real-valued states and actions, stepped on the host."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium as gym
import jax
import jax.random as jr
import numpy as np
from gymnasium import spaces

from hiprl.data.film import Film
from hiprl.data.trajectory import Trajectory, trajectory_from
from hiprl.errors import InputError, WorldError
from hiprl.types import Action, Actor, Key, State
from hiprl.world.camera import Camera, camera_of
from hiprl.world.names import Names, names_of
from hiprl.world.quiet import quiet
from hiprl.world.task import Terminates, World
from hiprl.world.termination import known_rule, never
from hiprl.world.words import described, said


class GymWorld(World):
    """Executes actors in one environment, which it owns from then on.

    States are observations as float32. Actions in [-1, 1] are scaled to the environment's bounds. An episode
    ends where the environment says so (terminated), and is cut where it says so (truncated) or after H steps.
    An actor computes on the device that holds its arrays; each step brings one action to the host.
    """

    env: gym.Env

    def __init__(
        self,
        env: gym.Env,
        *,
        horizon: int | None = None,
        terminates: Terminates | None = None,
        name: str | None = None,
        spec: str | None = None,
    ):
        """Checks that hiprl can learn in `env`.

        Args:
            env: an environment with one vector of numbers as state and a bounded one as action.
            horizon: most steps in an episode. Without it, the environment's own limit; if that is smaller, it
                wins.
            terminates: when an episode ends, in pure JAX. Without it, the known rule for `env`, if any.
            name: what to call it in messages and reports; by default the id it is registered under.
            spec: what `world_from` can make it from again, if anything.

        Raises:
            InputError: its observations or actions are of another kind, it has no horizon, or `terminates`
                does not fit.
        """
        self.env = env
        self.name = name or _name(env)
        self._spec = spec
        self.p = _state_size(env.observation_space, self.name)
        self.q = _action_size(env.action_space, self.name)
        self.H = _horizon(env, horizon, self.name)
        self.terminates = known_rule(env) if terminates is None else _checked(terminates, self.p, self.q)
        self.ends = self.terminates is not never
        low, high = env.action_space.low, env.action_space.high  # pyright: ignore[reportAttributeAccessIssue]
        self._low, self._high = low, high
        self._camera: Camera | None = None
        self._looks: list[Any] = []
        self._reads = False
        self._centre, self._half = low / 2 + high / 2, high / 2 - low / 2

    def roll_out(self, actor: Actor, *, key: Key) -> Trajectory:
        seed_key, act_key = jr.split(key)
        leaves, tree = jax.tree.flatten(actor)
        states = np.empty((self.H + 1, self.p), np.float32)
        actions = np.empty((self.H, self.q), np.float32)
        rewards = np.empty(self.H, np.float32)
        terminated, n = False, 0
        with quiet():
            states[0] = self._reset(int(jr.bits(seed_key)))
            self._looks = self._look()
            while n < self.H:
                a = np.asarray(_act(tree, leaves, states[n], act_key, np.int32(n)))
                s_next, reward, terminated, truncated = self._step(a, n)
                states[n + 1], actions[n], rewards[n] = s_next, a, reward
                n += 1
                self._looks += self._look()
                if terminated or truncated:
                    break
        return trajectory_from(states[: n + 1], actions[:n], H=self.H, terminated=terminated, rewards=rewards[:n])

    def scaled(self, a: np.ndarray) -> np.ndarray:
        return np.minimum(np.maximum(self._centre + self._half * a, self._low), self._high)

    def start_filming(self, *, drawn: bool = False) -> dict[str, Any] | None:
        """Films from now on. A registered environment that draws itself if asked when made is made again for that."""
        self._camera, self._reads = camera_of(self.env, drawn=drawn), False
        if self._camera is None and (env := self._that_draws()) is not None:
            self.env.close()
            self.env, self._camera = env, camera_of(env, drawn=drawn)
        if self._camera is not None and not drawn:
            with quiet():
                self._reads = self._camera.reads(self._reset(0))
        return None if self._camera is None else self._camera.scene

    def _that_draws(self) -> gym.Env | None:
        """The same environment, made to draw itself; None where it cannot, as where it lacks a package for that."""
        spec = self.env.spec
        if spec is None or self._spec is None or self._spec.rpartition(":")[2] != spec.id:
            return None  # it was made by a function of the user's, who knows what it is to draw
        if "rgb_array" not in self.env.metadata.get("render_modes", ()):
            return None
        try:
            with quiet():
                env = gym.make(spec, render_mode="rgb_array", disable_env_checker=True)
                env.reset(seed=0)
                env.render()
        except Exception:  # a package is missing, or it draws only elsewhere: its states are shown then
            return None
        return env

    @property
    def film(self) -> Film | None:
        return None if self._camera is None or not self._looks else self._camera.film(self._looks)

    @property
    def films_imagined(self) -> bool:
        return self._reads

    def film_of(self, states: np.ndarray) -> Film | None:
        return self._camera.film_of(states) if self._camera is not None and self._reads else None

    def names(self) -> Names:
        return names_of(self.env, self.p, self.q)

    def spec(self) -> str | None:
        return self._spec

    def close(self) -> None:
        self.env.close()

    def _look(self) -> list[Any]:
        return [] if self._camera is None else [self._camera.look()]

    def _reset(self, seed: int) -> np.ndarray:
        try:
            result = self.env.reset(seed=seed)
        except Exception as error:
            raise self._raised(error, "reset(seed=...)") from error
        if not (isinstance(result, tuple) and len(result) == 2):
            raise WorldError(
                f"{self.name} gave {described(result)} from reset; Gymnasium asks for (observation, info). "
                "Return both from the environment's reset."
            )
        return self._state(result[0], "reset")

    def _step(self, a: np.ndarray, t: int) -> tuple[np.ndarray, float, bool, bool]:
        if not np.isfinite(a).all():
            raise WorldError(
                f"the actor gave the action {a} at step {t} of {self.name}; an action needs real numbers in "
                "[-1, 1]. The policy or its models have diverged: go back to an earlier checkpoint, or "
                "train more gently."
            )
        try:
            result = self.env.step(self.scaled(a))
        except Exception as error:
            raise self._raised(error, f"step {t}") from error
        if not (isinstance(result, tuple) and len(result) == 5):
            raise WorldError(
                f"{self.name} gave {described(result)} at step {t}; Gymnasium asks for (observation, reward, "
                "terminated, truncated, info). Return these five from the environment's step."
            )
        observation, reward, terminated, truncated, _ = result
        s_next = self._state(observation, f"step {t}")
        return s_next, self._reward(reward, t), bool(terminated), bool(truncated)

    def _state(self, observation: Any, when: str) -> np.ndarray:
        """The observation as float32, copied: some environments hand out the same buffer each time."""
        try:
            with np.errstate(over="ignore"):  # what float32 cannot hold becomes infinite: reported below
                s = np.array(observation, np.float32)
        except (TypeError, ValueError) as error:
            raise WorldError(
                f"{self.name} gave {described(observation)} as observation at {when}; it declares {self.p} "
                "numbers. Make the environment return an array of that shape."
            ) from error
        if s.shape != (self.p,):
            raise WorldError(
                f"{self.name} gave an observation of shape {s.shape} at {when}; it declares shape "
                f"({self.p},). Make the environment return that shape in reset and in every step, or correct "
                "observation_space."
            )
        if not np.isfinite(s).all():
            bad = [int(i) for i in np.flatnonzero(~np.isfinite(s))]
            raise WorldError(
                f"{self.name} gave an observation that is not finite at {when} (entries {bad[:8]}); hiprl "
                "needs real numbers. The simulation may be unstable: use a smaller time step or narrower "
                "action bounds, or end the episode before this state."
            )
        return s

    def _reward(self, reward: Any, t: int) -> float:
        """What the environment paid; NaN for None, which means that it has no reward."""
        try:
            paid = np.nan if reward is None else np.asarray(reward, np.float64).item()
        except (TypeError, ValueError) as error:
            raise WorldError(
                f"{self.name} gave {described(reward)} as reward at step {t}; a reward is one number, or "
                "None. Return a float from the environment's step, or None if it has no reward."
            ) from error
        if np.isinf(paid):
            raise WorldError(
                f"{self.name} gave the reward {paid} at step {t}; a reward is a real number, or None. "
                "Bound it in the environment's step, or return None if it has no reward."
            )
        return paid

    def _raised(self, error: Exception, when: str) -> WorldError:
        return WorldError(
            f"{self.name} broke at {when} with {said(error)}. An environment must run an "
            f"episode of {self.H} steps with any actions in its bounds. The error is in the environment, or "
            "in something it needs: see its traceback, and try gymnasium.utils.env_checker.check_env on it."
        )


@partial(jax.jit, static_argnums=0)
def _act(tree: Any, leaves: list[Any], s: State, key: Key, t: Any) -> Action:
    """The actor's action; taking it apart once an episode saves a quarter of each call."""
    return jax.tree.unflatten(tree, leaves).act(s, key=jr.fold_in(key, t))


def _name(env: gym.Env) -> str:
    spec = env.unwrapped.spec
    return spec.id if spec is not None else type(env.unwrapped).__name__


def _horizon(env: gym.Env, horizon: int | None, name: str) -> int:
    own = _time_limit(env)
    if horizon is None and own is None:
        raise InputError(
            f"got {name}, which sets no limit to an episode; hiprl needs one. "
            "Give the most steps of an episode, as --horizon 200 or horizon=200."
        )
    return min(h for h in (horizon, own) if h is not None)


def _time_limit(env: gym.Env) -> int | None:
    """Steps after which the environment cuts its episodes, as far as it says so."""
    spec = env.unwrapped.spec
    limits = [spec.max_episode_steps] if spec is not None else []
    while isinstance(env, gym.Wrapper):
        if isinstance(env, gym.wrappers.TimeLimit):
            limits.append(env._max_episode_steps)
        env = env.env
    return min((limit for limit in limits if limit is not None), default=None)


def _checked(rule: Terminates, p: int, q: int) -> Terminates:
    """`rule`, if it gives one truth value a transition."""
    s, a = jax.ShapeDtypeStruct((p,), np.float32), jax.ShapeDtypeStruct((q,), np.float32)
    mend = "Write it in jax.numpy for a single transition, and return a comparison of its numbers."
    try:
        gives = jax.eval_shape(rule, s, a, s)
    except Exception as error:
        raise InputError(
            f"got a rule of termination that fails with {said(error)}. It is called as "
            f"rule(s, a, s_next) with shapes ({p},), ({q},), ({p},), inside compiled JAX code. {mend}"
        ) from error
    if getattr(gives, "shape", None) != () or gives.dtype != bool:
        raise InputError(
            f"got a rule of termination that gives {gives}; it must give one truth value, bool of shape (). {mend}"
        )
    return rule


def _state_size(space: spaces.Space, name: str) -> int:
    shape = space.shape if isinstance(space, spaces.Box) else None
    if shape is not None and len(shape) == 1 and shape[0] > 0:
        return shape[0]
    if shape is not None and len(shape) >= 3:
        raise InputError(
            f"got {name} with images as observations (shape {shape}); hiprl needs one vector of numbers. "
            "Use a version of the environment that observes its state, or turn the images into a few numbers "
            "with gymnasium.wrappers.TransformObservation."
        )
    if shape is not None and 0 in shape:
        raise InputError(
            f"got {name} with observations of shape {shape}, which hold nothing; hiprl needs at least one "
            "number. Make the environment observe its state."
        )
    if shape is None and not space.is_np_flattenable:
        raise InputError(
            f"got {name} with observations of kind {type(space).__name__}; hiprl needs one vector of "
            "numbers. No wrapper gives these a fixed length: pick numbers out of them with "
            "gymnasium.wrappers.TransformObservation."
        )
    raise InputError(
        f"got {name} with observations of kind {type(space).__name__} (shape {space.shape}); hiprl needs one "
        "vector of numbers. Wrap it: write a function that returns "
        "gymnasium.wrappers.FlattenObservation(env), and give module:function in place of the id."
    )


def _action_size(space: spaces.Space, name: str) -> int:
    if isinstance(space, (spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)):
        raise InputError(
            f"got {name} with actions of kind {type(space).__name__}; hiprl needs real-valued actions (a "
            "Box). Take a version with continuous actions, as MountainCarContinuous-v0 is of MountainCar-v0 and "
            "InvertedPendulum-v5 of CartPole-v1."
        )
    if not isinstance(space, spaces.Box):
        raise InputError(
            f"got {name} with actions of kind {type(space).__name__}; hiprl needs one vector of real numbers "
            "(a Box). Wrap it in gymnasium.wrappers.TransformAction with a function that takes such a "
            "vector apart."
        )
    if len(space.shape) != 1 or space.shape[0] == 0 or not np.issubdtype(space.dtype, np.floating):
        raise InputError(
            f"got {name} with actions of shape {space.shape} and dtype {space.dtype}; hiprl needs one vector "
            "of real numbers. Wrap it in gymnasium.wrappers.TransformAction with a function that makes its "
            "actions from such a vector."
        )
    if not (np.isfinite(space.low).all() and np.isfinite(space.high).all()):
        raise InputError(
            f"got {name} with actions between {space.low} and {space.high}; hiprl needs finite bounds, and "
            "neither RescaleAction nor ClipAction can mend that. Say how large an action may be: "
            "gymnasium.wrappers.TransformAction(env, lambda a: a, gymnasium.spaces.Box(-1, 1, "
            f"({space.shape[0]},))) with your bounds in place of -1 and 1."
        )
    if not (space.low < space.high).all():
        raise InputError(
            f"got {name} with actions between {space.low} and {space.high}; each entry needs a lower bound "
            "below its upper bound. Correct action_space, and leave out the entries that cannot move."
        )
    return space.shape[0]
