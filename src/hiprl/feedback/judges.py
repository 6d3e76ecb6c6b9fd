"""Judges: any function of the clips shown, and scripted ones that answer by the true return, in every form.

`exact` and `noisy` give numbers in the unit of the return. The others perceive returns in spreads: the unit is the
standard deviation of the true returns of the clips of this length that are at hand. So a judge with an error errs as
often whatever the scale of the reward; in the unit of the return the same judge would be sure of all or of nothing.

Source: the teachers of B-Pref, Lee et al. (2021), "B-Pref: Benchmarking Preference-Based Reinforcement Learning".
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax.random as jr
import numpy as np

from hiprl.data.answer import (
    CANNOT_TELL,
    EQUALLY_GOOD,
    MOST_LEVELS,
    Answer,
    choice,
    level,
    ranking,
    rating,
    slider,
)
from hiprl.data.preference import gap
from hiprl.data.trajectory import Trajectory
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError
from hiprl.feedback.judging import Judging
from hiprl.types import Key


def judge_from(judge: Any) -> Judging:
    """A judge from a name with its settings, such as `choice:beta=5,mistake=0.1`, or from a function of the clips.

    Raises:
        InputError: no judge of that name, or settings that it does not have.
    """
    if callable(judge):
        return Judging(answer=lambda clips, hand, **_: judge(*(clip.seen() for clip in clips)))
    name, _, settings = judge.partition(":") if isinstance(judge, str) else ("", "", "")
    if name not in SCRIPTED:
        raise InputError(
            f"got the judge {judge!r}; a scripted judge is "
            + ", ".join(f"`{scripted.usage}`" for scripted in SCRIPTED.values())
            + ", where settings with an = may be left out. Say for example `--judge noisy:50`, or pass a function "
            "from Python."
        )
    if name == "noisy" and "=" not in settings:
        settings = f"std={settings}"
    return SCRIPTED[name].make(**_settings(judge, SCRIPTED[name], settings))


def spread(hand: Trajectories, steps: int) -> float:
    """Standard deviation of the true returns of the clips of so many steps at hand, in the unit of the return.

    0 where there are none; not finite where the environment paid nothing.
    """
    returns = returns_at_hand(hand, steps)
    with np.errstate(invalid="ignore"):
        return float(np.std(returns)) if returns.size else 0.0


def returns_at_hand(hand: Trajectories, steps: int) -> np.ndarray:
    """True return of each clip of so many steps, 1 or more, that can be cut from the trajectories, side by side."""
    rewards, lengths = np.asarray(hand.rows.rewards, np.float64), np.asarray(hand.rows.length)
    paid = [rewards[i, : lengths[i]] for i in range(int(hand.count))]
    return np.array([window.sum() for r in paid for window in _windows(r, steps)])


def _windows(x: np.ndarray, steps: int) -> np.ndarray:
    """Pieces of `x` of so many entries, without what is left over; all of `x` where it is not longer."""
    n = len(x) // steps
    return x[: n * steps].reshape(n, steps) if len(x) > steps else x[None]


class Perceived(NamedTuple):
    """What a scripted judge goes by, in spreads of the clips at hand."""

    rewards: tuple[np.ndarray, ...]
    """Of each step of each clip shown."""
    worst: float
    """Lowest return at hand."""
    middle: float
    """Mean of the returns at hand."""

    @property
    def returns(self) -> np.ndarray:
        """Of each clip shown."""
        return np.array([r.sum() for r in self.rewards])

    @property
    def difference(self) -> float:
        """By how much the first of two is better."""
        first, second = self.returns
        return float(first - second)


def perceived(clips: tuple[Trajectory, ...], hand: Trajectories, steps: int | None = None) -> Perceived | None:
    """The clips shown against those at hand of so many steps, or as many as the longest; None where nothing was paid.

    An episode that ends early is a short clip among long ones. Where all at hand are the same, the unit is that of the
    return.
    """
    rewards = [np.asarray(clip.rewards, np.float64)[: int(clip.length)] for clip in clips]
    steps = steps or max(len(r) for r in rewards)
    returns, unit = returns_at_hand(hand, steps), spread(hand, steps) or 1.0
    if not (math.isfinite(unit) and all(np.isfinite(r).all() for r in rewards)):
        return None
    worst, middle = (returns.min(), returns.mean()) if returns.size else (0.0, 0.0)
    return Perceived(tuple(r / unit for r in rewards), float(worst / unit), float(middle / unit))


Rule: TypeAlias = Callable[[Perceived, Key], Answer]
"""How a scripted judge answers."""


def _by_rule(rule: Rule) -> Callable[..., Any]:
    """The answer of a judge that goes by what is perceived; NaN, which is none, where nothing was paid."""

    def answer(
        clips: tuple[Trajectory, ...], hand: Trajectories, *, steps: int | None = None, key: Key
    ) -> Answer | float:
        seen = perceived(clips, hand, steps)
        return math.nan if seen is None else rule(seen, key)

    return answer


def noisy(std: float) -> Judging:
    """Numbers: the difference of the true returns with a Gaussian error.

    Args:
        std: standard deviation of the error, in the unit of the return.
    """

    def answer(clips: tuple[Trajectory, ...], hand: Trajectories, *, steps: int | None = None, key: Key) -> float:
        del hand, steps
        tau, other = clips
        return float(gap(tau, other)) + (std * float(jr.normal(key)) if std else 0.0)

    return Judging(answer=answer, form="number")


exact = noisy(0.0)
"""Numbers: the difference of the true returns, as the paper's judge gives it."""


def by_choice(
    *, beta: float = math.inf, mistake: float = 0.0, skip: float = 0.0, equal: float = 0.0, myopic: float = 1.0
) -> Judging:
    """Says which of two clips is better: the teachers of B-Pref, with spreads in place of the average return.

    Args:
        beta: rationality, in 1/spread: P(first) = sigmoid(β * difference). With inf the better clip is always
            preferred, and of two that are the same neither: `equal`.
        mistake: probability of saying the other way round.
        skip: `unsure` where even the better clip's return is less than this many spreads above the worst at hand.
            B-Pref's threshold is a share of the average return; it takes 0 for the worst, as rewards are 0 or more
            there.
        equal: `equal` where the returns differ by less than this many spreads. As with `skip`, by the whole return.
        myopic: the weight of a step is this to the power of the steps left after it, so that the end counts most.

    Source: Lee et al. (2021), Algorithm 1 (SimTeacher); β after Bradley and Terry (1952).
    """

    def rule(seen: Perceived, key: Key) -> Answer:
        choice_key, mistake_key = jr.split(key)
        if skip > 0 and seen.returns.max() - seen.worst < skip:
            return CANNOT_TELL
        if abs(seen.difference) < equal:
            return EQUALLY_GOOD
        first, second = (_myopic_return(r, myopic) for r in seen.rewards)
        if math.isinf(beta) and first == second:
            return EQUALLY_GOOD
        prefers_first = _prefers_first(first - second, beta, key=choice_key)
        return choice(prefers_first != _happens(mistake, key=mistake_key))

    return Judging(answer=_by_rule(rule), form="choice")


def by_level(*, levels: int = 5, mistake: float = 0.0, noise: float = 0.0) -> Judging:
    """Says by how much the first of two clips is better, in levels; one spread is the top one.

    Args:
        levels: how many, 2 to 1001.
        mistake: probability of saying the same of the clips the other way round.
        noise: standard deviation of a Gaussian error of the difference, in spreads.
    """

    def rule(seen: Perceived, key: Key) -> Answer:
        noise_key, level_key, mistake_key = jr.split(key, 3)
        value = nearest_level(_with_noise(seen.difference, noise, key=noise_key), levels, key=level_key)
        return level(-value if _happens(mistake, key=mistake_key) else value, levels)

    return Judging(answer=_by_rule(rule), form="level", levels=levels)


def by_slider(*, noise: float = 0.0) -> Judging:
    """Says by how much the first of two clips is better, from -1 to 1; one spread or more is 1.

    Args:
        noise: standard deviation of a Gaussian error of the difference, in spreads.
    """

    def rule(seen: Perceived, key: Key) -> Answer:
        return slider(_clipped(_with_noise(seen.difference, noise, key=key)))

    return Judging(answer=_by_rule(rule), form="slider")


def by_ranking(*, k: int = 4, beta: float = math.inf, mistake: float = 0.0) -> Judging:
    """Ranks clips, best first: the best is drawn by the softmax of β * return, then the best of the rest, and so on.

    Args:
        k: how many clips it needs to see; it ranks all that it is shown.
        beta: rationality, in 1/spread. With inf the clips come in the order of their returns, and those that are the
            same in any order.
        mistake: probability of a ranking drawn uniformly.

    Source: Plackett (1975), Luce (1959).
    """

    def rule(seen: Perceived, key: Key) -> Answer:
        draw_key, mistake_key, order_key = jr.split(key, 3)
        if _happens(mistake, key=mistake_key):
            return ranking(jr.permutation(order_key, len(seen.returns)))
        return ranking(plackett_luce_order(seen.returns, beta, key=draw_key))

    return Judging(answer=_by_rule(rule), form="ranking", items=k)


def by_rating(*, levels: int = 5, noise: float = 0.0) -> Judging:
    """Says how good one clip is against the mean of those at hand, in levels; one spread above is the top one.

    Args:
        levels: how many, 2 to 1001.
        noise: standard deviation of a Gaussian error, in spreads.
    """

    def rule(seen: Perceived, key: Key) -> Answer:
        noise_key, level_key = jr.split(key)
        (g,) = seen.returns
        value = _with_noise(float(g) - seen.middle, noise, key=noise_key)
        return rating(nearest_level(value, levels, key=level_key), levels)

    return Judging(answer=_by_rule(rule), form="rating", items=1, levels=levels)


def nearest_level(x: float, levels: int, *, key: Key) -> float:
    """The level nearest to `x`, where ±1 and beyond are the outermost; half way, either with the same probability."""
    half = (levels - 1) / 2
    place = (_clipped(x) + 1) * half  # 0 is the lowest level, levels - 1 the highest
    below, above = math.ceil(place - 0.5), math.floor(place + 0.5)  # the same, except half way
    return (above if _happens(0.5, key=key) else below) - half


def plackett_luce_order(u: np.ndarray, beta: float, *, key: Key) -> np.ndarray:
    """Numbers of the clips of these utilities in an order drawn by Plackett-Luce, best first.

    To sort β u plus Gumbel variables is the same as to draw one after the other by softmax (Yellott, 1977).
    """
    gumbel = np.asarray(jr.gumbel(key, u.shape), np.float64)
    v = u if math.isinf(beta) else beta * u + gumbel
    return np.lexsort((-gumbel, -v))  # the last key sorts first; the other is for ties


def _prefers_first(difference: float, beta: float, *, key: Key) -> bool:
    """Whether the first of two clips is preferred: P = sigmoid(β * difference)."""
    if math.isinf(beta):
        return difference > 0
    return beta * difference + float(jr.logistic(key)) > 0  # sigmoid is the logistic distribution function


def _myopic_return(rewards: np.ndarray, discount: float) -> float:
    """Sum of the rewards, each weighted by `discount` to the power of the steps left after it."""
    left = np.arange(len(rewards))[::-1]
    return float(np.sum(rewards * discount**left))


def _with_noise(x: float, std: float, *, key: Key) -> float:
    return x + std * float(jr.normal(key))


def _happens(probability: float, *, key: Key) -> bool:
    return bool(jr.bernoulli(key, probability))


def _clipped(x: float) -> float:
    return min(max(x, -1.0), 1.0)


class Setting(NamedTuple):
    """A setting of a scripted judge, as it is written after the colon."""

    read: Callable[[str], float | int]
    """Raises ValueError where it is no number."""
    fits: Callable[[float | int], bool]
    needed: str
    """What it has to be, in words."""


class Scripted(NamedTuple):
    """A judge that has a name."""

    make: Callable[..., Judging]
    """Takes the settings as keywords."""
    usage: str
    """All that can be written."""
    example: str
    """Something that can be typed as it is."""
    settings: dict[str, Setting]
    """What each of them has to be."""


_STD = Setting(float, lambda x: 0 <= x < math.inf, "the error of an answer in the unit of the return, 0 or more")
_SPREADS = Setting(float, lambda x: 0 <= x < math.inf, "a number of spreads, 0 or more")
_PROBABILITY = Setting(float, lambda x: 0 <= x <= 1, "a probability, 0 to 1")
_RATIONALITY = Setting(float, lambda x: x >= 0, "0 or more, or inf")
_DISCOUNT = Setting(float, lambda x: 0 < x <= 1, "more than 0 and at most 1")
_LEVELS = Setting(int, lambda x: 2 <= x <= MOST_LEVELS, f"a whole number, 2 to {MOST_LEVELS}")
_CLIPS = Setting(int, lambda x: 2 <= x <= 8, "a whole number, 2 to 8")

SCRIPTED: dict[str, Scripted] = {
    "exact": Scripted(lambda: exact, "exact", "exact", {}),
    "noisy": Scripted(noisy, "noisy:STD", "noisy:50", {"std": _STD}),
    "choice": Scripted(
        by_choice,
        "choice:beta=B,mistake=E,skip=S,equal=D,myopic=G",
        "choice:beta=5,mistake=0.1",
        {"beta": _RATIONALITY, "mistake": _PROBABILITY, "skip": _SPREADS, "equal": _SPREADS, "myopic": _DISCOUNT},
    ),
    "graded": Scripted(
        by_level,
        "graded:levels=L,mistake=E,noise=S",
        "graded:levels=5,noise=0.2",
        {"levels": _LEVELS, "mistake": _PROBABILITY, "noise": _SPREADS},
    ),
    "slider": Scripted(by_slider, "slider:noise=S", "slider:noise=0.2", {"noise": _SPREADS}),
    "ranking": Scripted(
        by_ranking,
        "ranking:k=K,beta=B,mistake=E",
        "ranking:k=4,beta=5",
        {"k": _CLIPS, "beta": _RATIONALITY, "mistake": _PROBABILITY},
    ),
    "rating": Scripted(
        by_rating,
        "rating:levels=L,noise=S",
        "rating:levels=5,noise=0.2",
        {"levels": _LEVELS, "noise": _SPREADS},
    ),
}
"""The judges that have a name, with what each can be told."""


def _settings(judge: str, scripted: Scripted, text: str) -> dict[str, float | int]:
    """What is written after the colon: `key=value,key=value`."""
    given = {}
    for part in text.split(",") if text else []:
        name, equals, value = (x.strip() for x in part.partition("="))
        if not equals or name not in scripted.settings or name in given:
            has = f"{', '.join(scripted.settings)}, each given at most once as name=value"
            raise InputError(
                f"got the judge {judge!r} with the setting {part!r}; `{scripted.usage}` has "
                f"{has if scripted.settings else 'no settings'}. Say for example `--judge {scripted.example}`."
            )
        given[name] = _value(judge, scripted, name, value)
    return given


def _value(judge: str, scripted: Scripted, name: str, text: str) -> float | int:
    """One setting, read and checked."""
    setting = scripted.settings[name]
    try:
        value = setting.read(text)
    except ValueError:
        value = math.nan
    if not setting.fits(value):
        raise InputError(
            f"got the judge {judge!r} with {text or 'nothing'!r} for {name}; in `{scripted.usage}` it is "
            f"{setting.needed}. Say for example `--judge {scripted.example}`."
        )
    return value
