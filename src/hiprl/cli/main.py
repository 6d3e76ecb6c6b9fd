"""Reads the command line, runs a command, prints its JSON, sets the exit status."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from io import TextIOWrapper
from typing import cast

import tyro

from hiprl.cli.commands import Command, Compare, Export, Facts, Import, Play, Relearn, Resume, Serve, Show, Teach, Train
from hiprl.cli.interrupt import INTERRUPTED
from hiprl.cli.saying import say
from hiprl.errors import HiprlError, InputError

DONE, FAILED, WRONG_INPUT = 0, 1, 2

DESCRIPTION = (
    "Teach an agent a behaviour from a handful of comparisons, with no reward function.\n"
    "`hiprl COMMAND --help` explains a command, `hiprl --version` says which version this is."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit status: 0 done, 1 failed, 2 wrong input, 130 stopped by Ctrl-C."""
    arguments = sys.argv[1:] if arguments is None else arguments
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that has no ± shows something else
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(version("hiprl"))
        return DONE
    try:
        command = read(arguments)
    except SystemExit as stop:  # help was asked for, or tyro has said what is wrong
        return stop.code if isinstance(stop.code, int) else WRONG_INPUT
    except BrokenPipeError:  # `hiprl train --help | head` has read enough
        return silenced()
    from hiprl.cli.machine import prepare

    prepare()
    return run(lambda: do(command), as_json=command.json)


def read(arguments: Sequence[str]) -> Command:
    """The command that a line of arguments stands for. Leaves by SystemExit with help, or with what is wrong."""
    settings = (tyro.conf.DisallowNone, tyro.conf.FlagCreatePairsOff, tyro.conf.HelptextFromCommentsOff)
    return cast(
        "Command", tyro.cli(Command, prog="hiprl", description=DESCRIPTION, args=list(arguments), config=settings)
    )


def do(command: Command) -> Facts:
    """Does what a command says. What that needs takes seconds to import, and is imported here."""
    if isinstance(command, Serve):  # a page needs no JAX
        from hiprl.cli import serving

        return serving.serve(command)
    from hiprl.cli import exchange, playing, relearning, resuming, showing, teaching, training

    match command:
        case Train():
            return training.train(command)
        case Teach():
            return teaching.teach(command)
        case Resume():
            return resuming.resume(command)
        case Show():
            return showing.show(command)
        case Play():
            return playing.play(command)
        case Compare():
            return showing.compare(command)
        case Relearn():
            return relearning.relearn(command)
        case Export():
            return exchange.export(command)
        case Import():
            return exchange.bring(command)


def run(command: Callable[[], Facts], *, as_json: bool) -> int:
    """Runs a command, and turns how it ended into words on stderr and an exit status."""
    try:
        facts = command()
        if as_json:
            print(json.dumps(facts), flush=True)
        return DONE
    except KeyboardInterrupt:
        return INTERRUPTED  # where something was under way, it has said so itself
    except BrokenPipeError:  # `hiprl show | head` has read enough
        return silenced()
    except Exception as error:
        if os.environ.get("HIPRL_TRACEBACK", "") not in ("", "0"):
            raise
        if isinstance(error, HiprlError):
            say("\n".join([f"error: {error}", *notes_of(error)]))
            return WRONG_INPUT if isinstance(error, InputError) else FAILED
        said = " ".join(str(error).split())
        unexpected = (
            f"error: {type(error).__name__}: {said[:500] or 'no message'}\n"
            "This is a bug of hiprl, or of something it stands on: please report it, with what the same command says "
            "when HIPRL_TRACEBACK=1 is set before it."
        )
        say("\n".join([unexpected, *notes_of(error)]))
        return FAILED


def silenced() -> int:
    """The status of a command whose reader has gone; what Python still wants to write goes nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


def notes_of(error: BaseException) -> list[str]:
    """What was added to an error on its way."""
    return getattr(error, "__notes__", [])
