"""One door to all worlds: `world_from` whatever names, makes or is an environment."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Any, cast

import gymnasium as gym
import numpy as np

from hiprl.errors import InputError
from hiprl.world.gym import GymWorld
from hiprl.world.jax_world import JaxWorld
from hiprl.world.linear import default_linear
from hiprl.world.load import attribute_from, environment_from_id
from hiprl.world.pendulum import SwingUp
from hiprl.world.quiet import quiet
from hiprl.world.task import Task, Terminates, World
from hiprl.world.words import described, near, said


def world_from(env: Any, *, horizon: int | None = None, terminates: Any = None) -> World:
    """The world that `env` stands for.

    Args:
        env: one of

            - a Gymnasium id: `Hopper-v5`, or `package:Id-v0` to import a package that registers it;
            - `module:function`: a function of yours without arguments that returns an environment;
            - a built-in name, with settings after a colon if wanted: `linear`, `swing-up`,
              `swing-up:action_cost=0.1`;
            - a gymnasium.Env, a Task, a World, or a function that returns one of them.
        horizon: most steps in an episode; needed where the environment sets no limit. For an id it replaces
            the registered limit, for an environment that you made it can only shorten.
        terminates: when an episode ends, as a function of (s, a, s′) in pure JAX or as `module:function`.
            Without it, the known rule; where there is none, the algorithm learns one.

    Raises:
        InputError: there is no such environment, or hiprl cannot learn in it.
    """
    if horizon is not None and (not isinstance(horizon, (int, np.integer)) or horizon < 1):
        raise InputError(
            f"got horizon={horizon!r}; an episode needs a whole number of steps, at least 1. "
            "Give the most steps of an episode, as --horizon 200 or horizon=200."
        )
    if isinstance(terminates, str):
        terminates = attribute_from(terminates, what="a rule of termination")
    if terminates is not None and not callable(terminates):
        raise InputError(
            f"got {described(terminates)} as the rule of termination; it must be a function of (s, a, s_next) in "
            "JAX that gives True where the episode ends. Pass such a function, or "
            "hiprl.world.termination.never."
        )
    rule = cast("Terminates | None", terminates)
    if not isinstance(env, str):
        return _world(env, env, horizon, rule, name=None, spec=None)
    built_in, colon, rest = env.partition(":")
    if built_in in _TASKS and (not colon or "=" in rest or not rest):
        task, spec = _built_in(built_in, rest)
        return _world(task, env, horizon, rule, name=None, spec=spec)
    if colon and _ATTRIBUTE.fullmatch(rest):
        factory = attribute_from(env, what="an environment")
        return _world(factory, env, horizon, rule, name=env, spec=env)
    made = environment_from_id(env, horizon=horizon, built_in=tuple(_TASKS))
    spec = made.spec.id if made.spec is not None else env  # with its version, if `env` leaves that out
    return _world(made, env, horizon, rule, name=spec, spec=f"{built_in}:{spec}" if colon else spec)


def _world(
    found: Any,
    env: Any,
    horizon: int | None,
    rule: Terminates | None,
    *,
    name: str | None,
    spec: str | None,
) -> World:
    """The world for an object; a function is called once. `env` is what the user gave, for messages."""
    if not isinstance(found, (World, Task, gym.Env)) and callable(found):
        found = _called(found, env)
    if isinstance(found, World):
        if horizon not in (None, found.H) or rule is not None:
            raise InputError(
                f"got the world {found.name} with a horizon or a rule of termination; a world has its own. "
                f"Give them where you make the world (its horizon is {found.H})."
            )
        return found
    if isinstance(found, Task):
        if rule is not None:
            raise InputError(
                f"got the task {found.name} with a rule of termination; a task has its own. "
                "Leave the rule out, or write it into the task's `terminates`."
            )
        return JaxWorld(found, horizon=horizon, spec=spec)
    if isinstance(found, gym.Env):
        return GymWorld(found, horizon=horizon, terminates=rule, name=name, spec=spec)
    origin = f" from {env!r}" if isinstance(env, str) else ""
    raise InputError(
        f"got {described(found)}{origin}; hiprl needs a gymnasium.Env, a Task or a World. Return one of "
        "these. Environments of the older `gym` package run with shimmy.GymV21CompatibilityV0 around them."
    )


def _called(factory: Callable[[], Any], env: Any) -> Any:
    try:
        with quiet():
            return factory()
    except Exception as error:
        what = repr(env) if isinstance(env, str) else getattr(env, "__qualname__", repr(env))
        raise InputError(
            f"got {what}, and calling it failed with {said(error)}. hiprl needs a function "
            "that makes an environment when called without arguments. Give its arguments default values, or "
            "wrap it in a function that fills them in."
        ) from error


def _built_in(name: str, text: str) -> tuple[Task, str]:
    """The task and the same name with its settings in order."""
    make, allowed = _TASKS[name]
    settings: dict[str, float] = {}
    for part in text.split(",") if text else ():
        key, _, value = part.partition("=")
        try:
            settings[key.strip()] = number = float(value)
        except ValueError:
            number = math.nan
        known = key.strip() in allowed
        if not known or not (math.isfinite(number) and number >= 0):
            raise InputError(
                f"got {part!r} in {name}:{text}; {name} has the settings {', '.join(allowed)}, each a number "
                f"from 0. {'' if known else near(key.strip(), allowed)}Write for example {name}:{allowed[0]}=0.1."
            )
    spec = ",".join(f"{key}={settings[key]!r}" for key in sorted(settings))
    return make(**settings), f"{name}:{spec}" if spec else name


_TASKS: Mapping[str, tuple[Callable[..., Task], tuple[str, ...]]] = {
    "linear": (default_linear, ("noise_std",)),
    "swing-up": (SwingUp, ("action_cost",)),
}
_ATTRIBUTE = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)*")
