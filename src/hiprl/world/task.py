"""What a world is: something in which an actor can be executed for at most H steps."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from hiprl.data.film import Film
from hiprl.data.trajectory import Trajectory
from hiprl.types import Action, Actor, Flag, Key, Scalar, State
from hiprl.world.names import Names, numbered

Terminates = Callable[[State, Action, State], Flag]
"""(s, a, s′) to True where the world ends an episode with that step. Pure JAX, one transition at a time."""


class World(ABC):
    """The true f, and the judge's r where it has one; the learner sees states and actions only."""

    name: str
    p: int
    """Size of a state."""
    q: int
    """Size of an action. Actions are in [-1, 1]; the world scales them to its own bounds."""
    H: int
    """Most steps in an episode. Reaching it is truncation, not termination."""
    terminates: Terminates | None
    """The known rule of termination; None where it is not known and has to be learned."""
    ends: bool
    """Whether an episode can terminate at all. False: the rule is "never" and nothing is learned about it."""

    anywhere: Float[Array, "n p"] | None = None
    """States that imagined rollouts may begin in, seen or not; None where only seen ones will do."""

    @abstractmethod
    def roll_out(self, actor: Actor, *, key: Key) -> Trajectory:
        """τ ~ (f, π): one episode. The same actor and key give the same trajectory.

        Raises:
            WorldError: the environment raised, gave a value that is not finite, or changed its shapes.
        """

    prices: bool = False
    """Whether it knows what it would have paid for steps that were only imagined."""

    def priced(self, tau: Trajectory) -> Trajectory:
        """An imagined trajectory with what the world would have paid for it, for scripted judges; NaN if unknown."""
        return tau

    def scaled(self, a: np.ndarray) -> np.ndarray:
        """Actions in [-1, 1] as the world's own: one (q,) or a batch (n, q)."""
        return a

    def names(self) -> Names:
        """What the entries of its states and actions are called."""
        return numbered(self.p, self.q)

    def start_filming(self, *, drawn: bool = False) -> dict[str, Any] | None:
        """Films every episode from now on; gives the scene, or None if there is nothing to be seen of this world.

        Args:
            drawn: whether large pictures are wanted, also where a page could draw the bodies.

        Raises:
            InputError: they are, and nothing here can draw them.
        """
        return None

    @property
    def film(self) -> Film | None:
        """Of the newest episode; None if it was not filmed."""
        return None

    @property
    def films_imagined(self) -> bool:
        """Whether, while it films, there is a film of states that were only imagined too."""
        return False

    def film_of(self, states: np.ndarray) -> Film | None:
        """What there would be to be seen in states (n, p) that were only imagined; None if it cannot tell."""
        return None

    def spec(self) -> str | None:
        """What `world_from` makes this environment from in another process; None if made from an object.

        It names the environment alone: a horizon or a rule of termination that was given is given again.
        """

    def close(self) -> None:
        """Let go of what the world holds."""


class Task(eqx.Module):
    """A small world in pure JAX: f, r and s_0. Whole episodes compile, and seeds can be mapped over."""

    name: ClassVar[str]
    ends: ClassVar[bool]
    """Whether an episode can terminate at all."""

    @property
    @abstractmethod
    def p(self) -> int:
        """Size of a state."""

    @property
    @abstractmethod
    def q(self) -> int:
        """Size of an action."""

    @property
    @abstractmethod
    def H(self) -> int:
        """Steps in an episode, where nobody asks for another number."""

    @abstractmethod
    def f(self, s: State, a: Action, key: Key) -> State:
        """The next state, noise included."""

    @abstractmethod
    def r(self, s: State, a: Action) -> Scalar:
        """The latent reward of a step; more is better."""

    @abstractmethod
    def s_0(self, key: Key) -> State:
        """A draw of the first state."""

    def anywhere(self) -> Float[Array, "n p"] | None:
        """States all over the world, for imagined rollouts to begin in; None for those that were seen.

        From states near the first alone a search does not meet a reward that is far from all of them.
        """
        return None

    @abstractmethod
    def terminates(self, s: State, a: Action, s_next: State) -> Flag:
        """Whether the step ends the episode; False always where `ends` is False."""
