"""The commands and their flags, as frozen dataclasses of plain values.

`hiprl --help` reads this module and must be quick: what a command needs is imported when it runs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeAlias, get_args

from tyro.conf import Positional, UseAppendAction, arg, subcommand
from tyro.constructors import PrimitiveConstructorSpec

Facts: TypeAlias = dict[str, Any]

Preset: TypeAlias = Literal["default", "paper"]
Optimism: TypeAlias = Literal["greedy", "thompson", "eta_policy", "eta_sign", "bonus"]
Search: TypeAlias = Literal["gradient", "ppo"]
Ask: TypeAlias = Literal["uniform", "information"]
Features: TypeAlias = Literal["smooth", "linear"]
Answers: TypeAlias = Literal["all", "choices"]
Plan: TypeAlias = Literal["none", "sample", "mpc"]

DEFAULT_STORE = "runs/hiprl.db"
HOST, PORT = "127.0.0.1", 8642
"""Where the page is, unless told otherwise."""

Store: TypeAlias = Annotated[str, arg(metavar="PATH|URL")]
Json: TypeAlias = Annotated[bool, arg(help_behavior_hint="(default: off)")]
Host: TypeAlias = Annotated[str, arg(metavar="ADDRESS")]
Port: TypeAlias = Annotated[int, arg(metavar="N")]
Imagined: TypeAlias = Annotated[bool, arg(help_behavior_hint="(default: off)")]
NoBrowser: TypeAlias = Annotated[bool, arg(help_behavior_hint="(default: off)")]
Folder: TypeAlias = Annotated[str | None, arg(metavar="DIR", help_behavior_hint="(default: none)")]
Rule: TypeAlias = Annotated[
    str | None,
    arg(
        metavar="MODULE:FUNCTION",
        help_behavior_hint="(default: the known rule of the environment; if there is none, one is learned)",
    ),
]


def one_of(names: Any) -> PrimitiveConstructorSpec[Any]:
    """How a flag is read that is one of these words, or None where it is not given: nobody is to type that."""
    words = get_args(names)

    def read(given: list[str]) -> str:
        if given[0] not in words:
            raise ValueError(f"got {given[0]!r}; it is one of {', '.join(words)}. Choose one of these.")
        return given[0]

    return PrimitiveConstructorSpec(
        nargs=1,
        metavar=f"{{{','.join(words)}}}",
        instance_from_str=read,
        is_instance=lambda instance: instance is None or instance in words,
        str_from_instance=lambda instance: [str(instance)],
    )


def by_preset(default: str, paper: str) -> Any:
    """How a flag is shown whose default depends on the preset."""
    return arg(help_behavior_hint=f"(default: {default}; with preset paper: {paper})")


@dataclass(frozen=True, kw_only=True)
class Train:
    """Learn a behaviour from comparisons that a scripted judge answers.

    The run is stored as it goes on: after Ctrl-C or a crash, `hiprl resume RUN` continues it with the same draws.
    """

    env: Annotated[Positional[str], arg(metavar="ENV")]
    """Environment: a Gymnasium id such as Hopper-v5 or package:Id-v0;
    module:function for a function of yours that makes one;
    or a built-in one: linear, swing-up, swing-up:action_cost=0.1."""
    judge: Annotated[str, arg(metavar="NAME[:SETTING=VALUE,...]")] = "exact"
    """Who compares, by the environment's own reward (what the settings mean: docs/commands.md#judges):
    exact gives the difference of the returns;
    noisy:STD adds an error with this standard deviation, in the unit of the return;
    choice says which is better (settings beta, mistake, skip, equal, myopic);
    graded says it in levels (levels, mistake, noise); slider from -1 to 1 (noise);
    ranking puts k clips in order (k, beta, mistake); rating judges one clip (levels, noise)."""
    clip: Annotated[
        int | None, arg(metavar="STEPS", help_behavior_hint="(default: 0 for exact and noisy, 50 for the others)")
    ] = None
    """Steps of the clips that are compared; 0 for whole trajectories."""
    ask: Annotated[
        Ask | None,
        one_of(Ask),
        arg(help_behavior_hint="(default: uniform for exact and noisy, information for the others)"),
    ] = None
    """How clips are picked: the newest trajectory and any older ones, or what is expected to tell most."""
    comparisons: Annotated[int, arg(metavar="K")] = 30
    """Comparisons that the judge answers."""
    practice: Annotated[
        int | None, arg(metavar="N", help_behavior_hint="(default: 0 for exact and noisy, 1 for the others)")
    ] = None
    """Episodes after each answer that nobody is asked about: they cost steps in the environment, and time."""
    imagined: Imagined = False
    """Ask about what each new policy does in the model as well, where the world can tell what it would pay for that:
    the built-in ones can."""
    seed: int = 0
    """Decides all draws; whole number."""
    preset: Preset = "default"
    """Settings to start from: the best that we know, or those of the paper."""
    optimism: Annotated[Optimism | None, one_of(Optimism), by_preset("thompson", "eta_policy")] = None
    """How a search may use what the dynamics model does not know:
    greedy: not at all (the mean of the ensemble);
    thompson: each imagined rollout lives in one member of it;
    eta_policy: the policy picks where in the uncertainty to land (the paper);
    eta_sign: the gradient of the value picks that;
    bonus: uncertainty is rewarded."""
    search: Annotated[Search | None, one_of(Search), by_preset("gradient", "ppo")] = None
    """How a policy is searched in the model: by gradients through it, or by PPO in it (the paper)."""
    plan: Annotated[Plan | None, one_of(Plan), by_preset("none", "sample")] = None
    """How the policy is executed: as it is (none), drawn from (sample), or improved at each step by planning ahead in
    the model (mpc). While it learns, some noise is added, but not with preset paper."""
    horizon: Annotated[int | None, arg(metavar="H", help_behavior_hint="(default: the environment's own limit)")] = None
    """Most steps in an episode; needed where the environment has no limit."""
    terminates: Rule = None
    """When an episode ends: a function of (s, a, s_next) in JAX that gives true there."""
    eval_episodes: Annotated[int, arg(metavar="N")] = 10
    """Episodes over which the learned policy is reported at the end; they teach nothing."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file, made if there is none, or postgresql+psycopg://user:password@host/database."""
    tensorboard: Folder = None
    """Write TensorBoard event files into this folder, one folder a run in it."""
    json: Json = False
    """End with one JSON object on the last line of stdout."""


@dataclass(frozen=True, kw_only=True)
class Resume:
    """Go on with a run that was stopped or killed, with the draws that it would have had."""

    run: Annotated[Positional[str], arg(metavar="RUN")]
    """The run's id, or the start of it."""
    terminates: Annotated[
        str | None, arg(metavar="MODULE:FUNCTION", help_behavior_hint="(default: what the run began with)")
    ] = None
    """When an episode ends; needed where the run was begun from Python with a function."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    tensorboard: Folder = None
    """Write TensorBoard event files into this folder, one folder a run in it."""
    host: Host = HOST
    """Where people teach the run: address at which the page listens, by default for this machine alone."""
    port: Port = PORT
    """Port of that page, or the next free one; 0 for no page."""
    no_browser: NoBrowser = False
    """Only print the address of that page; do not open it."""
    json: Json = False
    """End with one JSON object on the last line of stdout, the same as train gives."""


@dataclass(frozen=True, kw_only=True)
class Show:
    """Numbers and pictures of a run: what it learned, how well its models know, what imagination promised."""

    run: Annotated[Positional[str | None], arg(metavar="[RUN]", help_behavior_hint="(default: the newest run)")] = None
    """The run's id, or the start of it. Without it, all runs of the store are listed too."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    out: Annotated[
        str | None, arg(metavar="DIR", help_behavior_hint="(default: a folder named as the run, beside the store)")
    ] = None
    """Folder for the pictures (PNG), made if there is none."""
    json: Json = False
    """End with one JSON object on the last line of stdout; the table goes to stderr."""


@dataclass(frozen=True, kw_only=True)
class Compare:
    """Runs side by side: those that differ in their seed alone are one arm.

    Tells the return over seeds with its interval, and the comparisons needed to reach a given return.
    """

    runs: Annotated[Positional[tuple[str, ...]], arg(metavar="[RUN ...]", help_behavior_hint="(or --all)")] = ()
    """Ids of runs, or the start of them."""
    all: Annotated[bool, arg(help_behavior_hint="(default: off)")] = False
    """Take all runs of the stores."""
    store: Annotated[
        UseAppendAction[tuple[str, ...]],
        arg(metavar="PATH|URL", help_behavior_hint=f"(default: {DEFAULT_STORE}; repeatable)"),
    ] = ()
    """Where the runs are kept; give it once for each store."""
    reach: Annotated[
        float | None,
        arg(
            metavar="RETURN",
            help_behavior_hint="(default: nine tenths of the way from random actions to the best arm)",
        ),
    ] = None
    """Return to reach, in the unit of the environment's reward, for counting the comparisons needed."""
    out: Annotated[
        str | None, arg(metavar="DIR", help_behavior_hint="(default: the folder comparison beside the first store)")
    ] = None
    """Folder for the picture (PNG), made if there is none."""
    json: Json = False
    """End with one JSON object on the last line of stdout; the table goes to stderr."""


@dataclass(frozen=True, kw_only=True)
class Relearn:
    """Learn the reward again from a run's answers, in other ways, and say how well each predicts answers kept from it.

    Nobody is asked anything, and the run stays as it is.
    """

    run: Annotated[Positional[str], arg(metavar="RUN")]
    """The run's id, or the start of it."""
    features: Features = "smooth"
    """What the reward is made of: a smooth function of each entry of state and action, or their linear parts alone."""
    answers: Answers = "all"
    """What of the answers counts: all that was said, or only which clip was better."""
    folds: Annotated[int, arg(metavar="N")] = 10
    """Parts into which the answers are put; each is predicted from the others."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout; the table goes to stderr."""


@dataclass(frozen=True, kw_only=True)
class Teach:
    """Teach a behaviour yourself: compare clips in the browser while it trains. No reward is needed.

    Prints the address of the page. It practises while it waits for you, and takes answers up as they come.
    """

    env: Annotated[Positional[str], arg(metavar="ENV")]
    """Environment, as for train."""
    goal: Annotated[str | None, arg(metavar="WORDS", help_behavior_hint="(default: asked on the page)")] = None
    """What it is to learn, in your own words; shown above the clips."""
    comparisons: Annotated[int, arg(metavar="K")] = 30
    """Answers after which it practises a while longer, and ends."""
    clip: Annotated[int | None, arg(metavar="STEPS", help_behavior_hint="(default: 50)")] = None
    """Steps of the clips that are compared; 0 for whole episodes."""
    imagined: Imagined = False
    """Show also what it believes that it could do, in clips that are marked as imagined."""
    seed: int = 0
    """Decides all draws; whole number."""
    horizon: Annotated[int | None, arg(metavar="H", help_behavior_hint="(default: the environment's own limit)")] = None
    """Most steps in an episode; needed where the environment has no limit."""
    terminates: Rule = None
    """When an episode ends: a function of (s, a, s_next) in JAX that gives true there."""
    host: Host = HOST
    """Address at which the page listens: by default for this machine alone; 0.0.0.0 for all that can reach it."""
    port: Port = PORT
    """Port of the page, or the next free one; 0 for no page (`hiprl serve` shows it)."""
    no_browser: NoBrowser = False
    """Only print the address of the page; do not open it."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout, the same as train gives."""


@dataclass(frozen=True, kw_only=True)
class Serve:
    """Show the page alone, for all runs of a store and any number of judges, until Ctrl-C.

    Prints an address that lets one browser in, and another one once it was used. With a password in the environment
    (HIPRL_PASSWORD), that opens the page too.
    """

    run: Annotated[Positional[str | None], arg(metavar="[RUN]", help_behavior_hint="(default: the list of runs)")] = (
        None
    )
    """The run whose page is opened first: its id, or the start of it."""
    host: Host = HOST
    """Address to listen at: by default for this machine alone; 0.0.0.0 for all that can reach it."""
    port: Port = PORT
    """Port, or the next free one."""
    browser: Annotated[bool, arg(help_behavior_hint="(default: off)")] = False
    """Open the page in a browser."""
    store: Store = DEFAULT_STORE
    """Where the runs are kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout."""


@dataclass(frozen=True, kw_only=True)
class Play:
    """Look at what a run has learned: one file with the behaviour in 3-D, which opens in any browser and can be mailed.

    Without --html and --video it lies beside the store, and is opened where there is a screen.
    """

    run: Annotated[Positional[str], arg(metavar="RUN")]
    """The run's id, or the start of it."""
    html: Annotated[
        str | None, arg(metavar="FILE", help_behavior_hint="(default: beside the store; none with --video alone)")
    ] = None
    """Where to write it."""
    video: Annotated[str | None, arg(metavar="FILE", help_behavior_hint="(default: none)")] = None
    """Write a video (MP4) of the same episode; needs pip install 'hiprl[video]' and, for a MuJoCo body, OpenGL."""
    steps: Annotated[int, arg(metavar="N")] = 500
    """At most so many steps of the episode."""
    seed: int = 0
    """Decides where the episode begins; whole number."""
    terminates: Annotated[
        str | None, arg(metavar="MODULE:FUNCTION", help_behavior_hint="(default: what the run began with)")
    ] = None
    """When an episode ends; needed where the run was begun from Python with a function."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout."""


@dataclass(frozen=True, kw_only=True)
class Export:
    """Take a run's answers or its trajectories away, in a file that other programs read."""

    run: Annotated[Positional[str], arg(metavar="RUN")]
    """The run's id, or the start of it."""
    to: Annotated[str, arg(metavar="FILE")]
    """A name that ends in .jsonl for all questions and answers (JSON Lines),
    or in .npz for all trajectories (NumPy arrays; actions between -1 and 1, rewards as the environment paid them)."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout."""


@dataclass(frozen=True, kw_only=True)
class Import:
    """Take in answers that were given elsewhere, to questions of a run in the store.

    All of them or, if one does not fit its question, none. A newer answer replaces an older one, and the older one
    stays to be seen.
    """

    file: Annotated[Positional[str], arg(metavar="FILE")]
    """Answers as `hiprl export RUN --to answers.jsonl` writes them."""
    store: Store = DEFAULT_STORE
    """Where the run is kept: a file or an address, as for train."""
    json: Json = False
    """End with one JSON object on the last line of stdout."""


Command: TypeAlias = (
    Annotated[Train, subcommand("train")]
    | Annotated[Teach, subcommand("teach")]
    | Annotated[Serve, subcommand("serve")]
    | Annotated[Resume, subcommand("resume")]
    | Annotated[Show, subcommand("show")]
    | Annotated[Play, subcommand("play")]
    | Annotated[Compare, subcommand("compare")]
    | Annotated[Relearn, subcommand("relearn")]
    | Annotated[Export, subcommand("export")]
    | Annotated[Import, subcommand("import")]
)
