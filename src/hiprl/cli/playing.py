"""`hiprl play`: the learned behaviour, to be looked at."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import Any

import jax.random as jr

from hiprl.api import world_of
from hiprl.cli.commands import Facts, Play
from hiprl.cli.saying import say
from hiprl.cli.serving import graphical
from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.report.record import beside
from hiprl.report.video import video_file, write_video
from hiprl.session import learned_actor, refuse_seed
from hiprl.store.store import open_store
from hiprl.types import Actor
from hiprl.web.alone import page_of
from hiprl.world.quiet import quiet
from hiprl.world.task import World

LOOK = 1 << 29  # folded into nothing else: what is played is no part of the run


def play(command: Play) -> Facts:
    """Executes the learned policy and writes what is to be seen into files."""
    if command.steps < 1:
        raise InputError(f"got {command.steps} steps to play; at least 1 is needed. Say `--steps 400`.")
    refuse_seed(command.seed)
    video = None if command.video is None else video_file(command.video)
    with open_store(command.store, create=False) as store:
        row = store.find_run(command.run)
        world = world_of(row, terminates=command.terminates)
        actor = learned_actor(store, row.id, world)
        goal, final = store.goal(row.id), store.final(row.id)
    own = command.html is None and video is None  # beside the store, and opened
    told: Facts = {"run": row.id, "file": None, "video": None, "bytes": 0, "length": 0}
    try:
        if video is not None:
            scene, film, told["length"] = shown(world, actor, command, drawn=True)
            write_video(video, film, scene["dt"])
            told |= {"video": str(video), "bytes": video.stat().st_size}
            say(f"{video} shows {frames(film) - 1} of {told['length']} steps.")
        if own or command.html is not None:
            scene, film, told["length"] = shown(world, actor, command, drawn=False)
            title = f"{world.name}: {goal}" if goal else f"{world.name}, learned from {comparisons(final)} comparisons"
            path = beside(command.store, row.id) / "play.html" if own else Path(str(command.html)).expanduser()
            write(path, page_of(scene, [("", film)], title), make_folder=own)
            told |= {"file": str(path), "bytes": told["bytes"] + path.stat().st_size}
            say(f"{path} shows {frames(film) - 1} of {told['length']} steps; open it in any browser.")
            if own and graphical():
                webbrowser.open(path.resolve().as_uri())
    finally:
        world.close()
    return told


def shown(world: World, actor: Actor, command: Play, *, drawn: bool) -> tuple[dict[str, Any], Film, int]:
    """The scene, what is to be seen of an episode, and how many steps that had."""
    with quiet():
        scene = world.start_filming(drawn=drawn)
    if scene is None:
        raise InputError(
            f"there is nothing to be seen of {world.name}: it has neither a MuJoCo model nor pictures of its own. "
            "Make it with render_mode='rgb_array', in a function that you name as module:function."
        )
    tau = world.roll_out(actor, key=jr.fold_in(jr.key(command.seed), LOOK))
    assert world.film is not None
    return scene, world.film.cut(0, command.steps), int(tau.length)


def write(path: Path, text: str, *, make_folder: bool) -> None:
    """Writes a page."""
    try:
        if make_folder:
            path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as e:
        raise InputError(f"cannot write {path}: {e.strerror}. Name a file in a folder that takes it.") from e


def frames(film: Film) -> int:
    """How many looks it has."""
    return len(film.poses if film.poses is not None else film.pictures or ())


def comparisons(final: Facts | None) -> str:
    """From how many a run has learned."""
    return "some" if final is None else str(final["comparisons"])
