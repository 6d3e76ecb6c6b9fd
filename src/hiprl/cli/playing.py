"""`hiprl play`: the learned behaviour, to be looked at."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import jax.random as jr

from hiprl.api import world_of
from hiprl.cli.commands import Facts, Play
from hiprl.cli.serving import graphical
from hiprl.cli.showing import say
from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.report.record import beside
from hiprl.session import learned_actor
from hiprl.store.store import open_store
from hiprl.web.alone import page_of
from hiprl.world.quiet import quiet

LOOK = 1 << 29  # folded into nothing else: what is played is no part of the run


def play(command: Play) -> Facts:
    """Executes the learned policy once and writes what is to be seen into a file."""
    if command.steps < 1:
        raise InputError(f"got {command.steps} steps to play; at least 1 is needed. Say `--steps 400`.")
    with open_store(command.store, create=False) as store:
        row = store.find_run(command.run)
        world = world_of(row, terminates=command.terminates)
        actor = learned_actor(store, row.id, world)
        goal, final = store.goal(row.id), store.final(row.id)
    with quiet():
        scene = world.start_filming()
    if scene is None:
        raise InputError(
            f"there is nothing to be seen of {world.name}: it has neither a MuJoCo model nor pictures of its own. "
            "Make it with render_mode='rgb_array', in a function that you name as module:function."
        )
    tau = world.roll_out(actor, key=jr.fold_in(jr.key(command.seed), LOOK))
    film = world.film
    world.close()
    assert film is not None
    title = f"{world.name}: {goal}" if goal else f"{world.name}, learned from {comparisons(final)} comparisons"
    path = Path(command.html).expanduser() if command.html is not None else beside(command.store, row.id) / "play.html"
    text = page_of(scene, [("", film.cut(0, command.steps))], title)
    try:
        if command.html is None:
            path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as e:
        raise InputError(f"cannot write {path}: {e.strerror}. Name a file in a folder that takes it.") from e
    say(f"{path} shows {frames(film.cut(0, command.steps)) - 1} of {int(tau.length)} steps; open it in any browser.")
    if command.html is None and graphical():
        webbrowser.open(path.resolve().as_uri())
    return {"run": row.id, "file": str(path), "bytes": len(text.encode()), "length": int(tau.length)}


def frames(film: Film) -> int:
    """How many looks it has."""
    return len(film.poses if film.poses is not None else film.pictures or ())


def comparisons(final: Facts | None) -> str:
    """From how many a run has learned."""
    return "some" if final is None else str(final["comparisons"])
