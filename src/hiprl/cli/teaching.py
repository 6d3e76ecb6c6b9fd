"""`hiprl teach`, and `hiprl resume` where people answer: a trainer, and the page on which people answer."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console

from hiprl.api import new_store, world_of
from hiprl.cli.commands import Facts, Resume, Teach
from hiprl.cli.interrupt import stoppable
from hiprl.cli.progress import progress
from hiprl.cli.saying import say
from hiprl.cli.serving import WITH_PARENT, listening
from hiprl.cli.training import outcome, tell, typed
from hiprl.config import Config, teachable
from hiprl.data.words import goal_in
from hiprl.errors import InputError
from hiprl.session import RunSpec, spec_of, start
from hiprl.store.rows import PEOPLE, RunRow
from hiprl.store.store import Store
from hiprl.teaching import FIRST, taught
from hiprl.world.build import world_from
from hiprl.world.task import World

WARM_UP = 10  # episodes of random actions at most: enough pairs for the first questions, also where episodes are short
HEARD = 3.0  # seconds that the page stays at the end where nobody can say when: those who look at it hear of the end


def teach(command: Teach) -> Facts:
    """Begins a run that people teach, with its page; gives its summary."""
    refuse_address(command)
    wanted = None if command.goal is None else goal_in(command.goal)
    world = world_from(command.env, horizon=command.horizon, terminates=command.terminates)
    K = command.comparisons
    config = teachable(Config(comparisons=K, warm_up=max(min(FIRST, K), min(WARM_UP, K // 3))))
    if command.clip is not None:
        config = replace(config, question=replace(config.question, clip=command.clip or None))
    if command.imagined:
        refuse_unseen(world)
        config = replace(config, question=replace(config.question, imagined=True))
    spec = RunSpec(seed=command.seed, config=config, judge=PEOPLE, terminates=command.terminates)
    with new_store(command.store) as store:
        run_id = start(store, world, spec)
        if wanted is not None:
            store.set_goal(run_id, wanted)
        with page(run_id, store, command):
            return follow(store, run_id, world, command)


def refuse_address(command: Teach | Resume) -> None:
    """Raises InputError if no page can be where it is to be: better before a run is stored than after."""
    if command.port != 0:
        listening(command.host, command.port).close()


def refuse_unseen(world: World) -> None:
    """Sees to it that there is something to be seen of what was only imagined.

    Raises:
        InputError: only what happens can be filmed.
    """
    if world.start_filming() is not None and not world.films_imagined:
        raise InputError(
            f"got --imagined for {world.name}, of which only what happens can be filmed; what is imagined is drawn "
            "from observations that begin with the places and velocities of all joints of a MuJoCo model, as those of "
            "HalfCheetah-v5 do. Leave --imagined out, or observe the joints."
        )


def resume(store: Store, row: RunRow, command: Resume) -> Facts:
    """Goes on with a run that people teach, with its page."""
    if command.tensorboard is not None:
        raise InputError(
            f"got --tensorboard for run {row.id}, which people teach; event files are written of runs with a scripted "
            "judge. Leave it out: the run's page shows the same."
        )
    world = world_of(row, terminates=command.terminates)
    with page(row.id, store, command):
        return follow(store, row.id, world, command)


@contextlib.contextmanager
def page(run_id: str, store: Store, command: Teach | Resume) -> Iterator[None]:
    """The page, in a process of its own, for as long as this one lives; where it ends before, that is said."""
    refuse_address(command)
    if command.port == 0:
        yield
        return
    words = [sys.executable, "-m", "hiprl", "serve", run_id, "--store", command.store]
    words += ["--host", command.host, "--port", str(command.port)] + ([] if command.no_browser else ["--browser"])
    own = os.environ | {WITH_PARENT: "1"}
    process = subprocess.Popen(words, stdin=subprocess.PIPE, env=own, start_new_session=True)  # Ctrl-C is for this one
    ending = threading.Event()

    def told_if_it_ends() -> None:
        code = process.wait()
        if not ending.is_set():
            open_it = typed("serve", run_id, store, command)
            say(f"The page has ended (exit {code}); what was answered is stored, and the run goes on. Again: {open_it}")

    threading.Thread(target=told_if_it_ends, daemon=True).start()
    try:
        yield
    finally:
        ending.set()
        assert process.stdin is not None
        process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5)
        process.kill()


def follow(store: Store, run_id: str, world: World, command: Teach | Resume) -> Facts:
    """Learns from the answers that come, and tells what it waits for."""
    console = Console(stderr=True)
    K, past = spec_of(store, run_id).config.comparisons, [facts for _, facts in store.episodes(run_id)]
    tell(console, f"Run {run_id}: {world.name}, taught by people with up to {K} answers; stored in {store.name}.")
    again = f"Go on with: {typed('resume', run_id, store, command)}"
    display = progress(K, past, console, by_people=True)

    def farewell() -> None:
        display.stop()
        tell(console, f"Stopped; what is finished is stored. {again}")

    try:
        with stoppable(farewell), display:
            summary = taught(store, run_id, world, watch=display, wait=display.wait)
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
    tell(console, outcome(summary))
    tell(console, f"Next: {typed('show', run_id, store, command)}")
    if command.port:
        with contextlib.suppress(KeyboardInterrupt):
            if sys.stdin.isatty():
                say("The page stays open; press Enter to end.")  # stdout is for the summary
                sys.stdin.readline()
            else:
                time.sleep(HEARD)
    return summary
