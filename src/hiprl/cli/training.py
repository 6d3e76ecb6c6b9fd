"""`hiprl train`, and `hiprl resume` where a scripted judge answers."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any

from rich.console import Console

from hiprl.api import judge_of, new_store, world_of
from hiprl.cli.commands import DEFAULT_STORE, HOST, PORT, Facts, Resume, Teach, Train
from hiprl.cli.interrupt import stoppable
from hiprl.cli.progress import duration, progress
from hiprl.config import Config, asking, paper, preset
from hiprl.control.gradient import GradientConfig
from hiprl.errors import InputError
from hiprl.feedback.judges import judge_from
from hiprl.feedback.judging import Judging
from hiprl.report.tensorboard import EventFiles, event_folder
from hiprl.session import RunSpec, carry_on, spec_of, start
from hiprl.store.rows import RunRow
from hiprl.store.store import Store
from hiprl.world.build import world_from
from hiprl.world.task import World

SEARCHES = {"gradient": lambda env: GradientConfig(), "ppo": lambda env: paper(env).search}
"""Name to settings, for a search that is not the preset's own."""


def train(command: Train) -> Facts:
    """Begins a run and does all of it; gives its summary."""
    judging = judge_from(command.judge)
    world = world_from(command.env, horizon=command.horizon, terminates=command.terminates)
    asked: dict[str, Any] = {"clip": command.clip, "pick": command.ask}
    asked |= {"practice": command.practice, "imagined": command.imagined}
    spec = RunSpec(
        seed=command.seed,
        config=asking(config_of(command, world.name), judging, **asked),
        judge=command.judge,
        eval_episodes=command.eval_episodes,
        terminates=command.terminates,
    )
    if command.tensorboard is not None:
        event_folder(command.tensorboard)
    with new_store(command.store) as store:
        return follow(store, start(store, world, spec), world, judging, command)


def resume(store: Store, row: RunRow, command: Resume) -> Facts:
    """Goes on with a run that a scripted judge answers; gives its summary."""
    judging = judge_of(row)
    world = world_of(row, terminates=command.terminates)
    if command.tensorboard is not None:
        event_folder(command.tensorboard)
    return follow(store, row.id, world, judging, command)


def config_of(command: Train, env: str) -> Config:
    """The preset's settings, with those of the flags that are set."""
    config = preset(command.preset, env)
    K = command.comparisons
    changes: dict[str, Any] = {"comparisons": K, "warm_up": min(config.warm_up, K)}
    if command.optimism is not None:
        changes["optimism"] = command.optimism
    if command.search is not None:
        other = SEARCHES[command.search](env)
        if not isinstance(config.search, type(other)):
            changes["search"] = other
    if command.plan is not None:
        changes["plan"] = replace(config.plan, kind=command.plan)
    return replace(config, **changes)


def follow(store: Store, run_id: str, world: World, judging: Judging, command: Train | Resume) -> Facts:
    """Does what a run still lacks, tells how far it is, and at the end what came of it and what to type next."""
    console = Console(stderr=True)
    spec, past = spec_of(store, run_id), [facts for _, facts in store.episodes(run_id)]
    goes_on = f" It goes on after episode {len(past)}." if past else ""
    tell(
        console,
        f"Run {run_id}: {world.name}, judge {spec.judge}, {spec.config.comparisons} comparisons, seed {spec.seed}; "
        f"stored in {store.name}.{goes_on}",
    )
    again = f"Go on with: {typed('resume', run_id, store, command)}"
    events = None if command.tensorboard is None else EventFiles(command.tensorboard, run_id, past)
    display = progress(spec.config.comparisons, past, console)

    def watch(facts: Facts) -> None:
        display(facts)
        if events is not None:
            events(facts)

    def farewell() -> None:
        display.stop()
        if events is not None:
            events.close()
        tell(console, f"Stopped; what is finished is stored. {again}")

    try:
        with stoppable(farewell), display:
            summary = carry_on(store, run_id, world, judging, watch=watch)
    except KeyboardInterrupt:
        farewell()
        raise
    except InputError:
        raise
    except Exception as error:
        error.add_note(f"What is finished is stored. {again}")
        raise
    finally:
        world.close()
        if events is not None:
            events.close()
    tell(console, outcome(summary))
    tell(console, f"Next: {typed('show', run_id, store, command)}")
    return summary


def outcome(summary: Facts) -> str:
    """What a run came to, in two short sentences."""
    learned = (
        f"{summary['env']} learned from {summary['comparisons']} comparisons in {duration(summary['wall_seconds'])}."
    )
    if summary["return_mean"] is None:
        return f"{learned} The environment pays no reward, so no return is known."
    mean, std, n = summary["return_mean"], summary["return_std"], summary["eval_episodes"]
    return f"{learned} Return {mean:.1f} ± {std:.1f} over {n} episode{'s' if n > 1 else ''}."


def typed(verb: str, run_id: str, store: Store, command: Train | Resume | Teach) -> str:
    """What to type for a run in the store."""
    words = ["hiprl", verb, run_id]
    if command.store != DEFAULT_STORE:
        words += ["--store", store.name]
    if verb == "resume" and not isinstance(command, Teach) and command.tensorboard is not None:
        words += ["--tensorboard", command.tensorboard]
    if verb in ("resume", "serve") and not isinstance(command, Train):  # where the page was
        words += [] if command.host == HOST else ["--host", command.host]
        words += [] if command.port == PORT else ["--port", str(command.port)]
        words += ["--no-browser"] if command.no_browser and verb == "resume" else []
    if verb == "resume" and command.json:
        words += ["--json"]
    return shlex.join(words)


def tell(console: Console, words: str) -> None:
    """Words for a person, on stderr, as they are."""
    console.print(words, highlight=False, markup=False, soft_wrap=True)
