"""Finds an environment by its name: an id of Gymnasium's registry, or a function in the user's own module."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from typing import Any

import gymnasium as gym

from hiprl.errors import InputError
from hiprl.world.quiet import quiet
from hiprl.world.words import near, said


def environment_from_id(name: str, *, horizon: int | None = None, built_in: tuple[str, ...] = ()) -> gym.Env:
    """The environment registered as `name` (`Hopper-v5`, or `module:Id-v0` to import a module first).

    Args:
        name: the id.
        horizon: most steps in an episode, in place of the registered limit.
        built_in: more names to offer when `name` is not known.

    Raises:
        InputError: no such id, or it cannot be made here.
    """
    module, colon, _ = name.rpartition(":")
    if colon:
        _module(module, name, "an environment")
    try:
        with quiet():
            # hiprl checks each step itself, and says more.
            return gym.make(name, max_episode_steps=horizon, disable_env_checker=True)
    except (gym.error.UnregisteredEnv, gym.error.DeprecatedEnv) as error:
        raise InputError(
            f"got {name!r}, which is no registered environment; hiprl needs a Gymnasium id, module:function, "
            f"or one of {', '.join(built_in) or 'its own names'}. {near(name, (*gym.registry, *built_in))}To "
            "use an id that a package registers, write package:id."
        ) from error
    except gym.error.DependencyNotInstalled as error:
        raise InputError(
            f"got {name!r}, which needs a package that is not installed ({str(error).strip().rstrip('.')}); "
            "hiprl itself brings only MuJoCo. Install what the message names, then try again."
        ) from error
    except Exception as error:
        raise InputError(
            f"got {name!r}, and making it failed with {said(error)}. An environment must "
            f"come up by gymnasium.make({name!r}). Get that to work first."
        ) from error


def attribute_from(path: str, *, what: str) -> Callable[..., Any]:
    """The function that `module:function` names; the working folder is searched after the installed packages.

    Args:
        path: the module's dotted name, a colon, the function's name in it.
        what: what the function is for, in the messages.

    Raises:
        InputError: the module cannot be imported, has no such attribute, or it cannot be called.
    """
    module_name, _, attribute = path.partition(":")
    found: Any = _module(module_name, path, what)
    for part in attribute.split("."):
        if not hasattr(found, part):
            names = [name for name, value in vars(found).items() if callable(value) and not name.startswith("_")]
            raise InputError(
                f"got {path!r}, but {module_name} has no {attribute}; {what} needs a function of that "
                f"module. {near(part, names)}Write module:function with a name that the module defines."
            )
        found = getattr(found, part)
    if not callable(found):
        raise InputError(
            f"got {path!r}, a value of type {type(found).__name__} that cannot be called; {what} needs a "
            "function. Define a function that returns it, and name that one."
        )
    return found


def _module(name: str, path: str, what: str) -> Any:
    try:
        return _import(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            hint = f" Leave out the ending: {name.removesuffix('.py')}." if name.endswith(".py") else ""
            raise InputError(
                f"got {path!r}, but there is no module {name}; {what} needs one that Python can import. "
                f"Check its name, install it, or run where {name.partition('.')[0]} lies.{hint}"
            ) from error
        raise _broken(path, name, error, what) from error
    except Exception as error:
        raise _broken(path, name, error, what) from error


def _import(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        here = os.getcwd()
        if error.name != name.partition(".")[0] or here in sys.path:
            raise
        # A console script does not search the folder in which it is run. It goes last and stays: what is
        # imported from it may import its neighbours later.
        sys.path.append(here)
        importlib.invalidate_caches()
        return importlib.import_module(name)


def _broken(path: str, name: str, error: Exception, what: str) -> InputError:
    return InputError(
        f"got {path!r}, but importing {name} failed with {said(error)}. {what} needs a "
        "module that "
        f'can be imported. Get `python -c "import {name}"` to work first.'
    )
