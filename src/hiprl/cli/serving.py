"""`hiprl serve`: the labelling page alone."""

from __future__ import annotations

import contextlib
import io
import ipaddress
import os
import signal
import socket
import sys
import threading
import webbrowser
from functools import partial
from urllib.parse import quote

import uvicorn

from hiprl.cli.commands import Facts, Serve
from hiprl.cli.saying import say
from hiprl.errors import InputError
from hiprl.store.store import Store, open_store
from hiprl.web.access import LONGEST_PASSWORD, Doors
from hiprl.web.app import Picture, app_of

PASSWORD = "HIPRL_PASSWORD"
"""Of the page, in the environment: a command line is for all to see."""
WITH_PARENT = "HIPRL_WITH_PARENT"
"""Set where the page is to end with the process that began it: when its input ends."""
TRACEBACK = "HIPRL_TRACEBACK"
"""Set where what goes wrong in a request is to be seen here too: any program that hangs up too soon is such a thing."""
TRIED_PORTS = 20
DRAWN = (
    "overview",
    "learning",
    "transition-deviation",
    "preference-deviation",
    "calibration",
    "imagination",
    "rollout-error",
)
"""Pictures of a run, as `hiprl.report.figures` names them."""
LOOKING = 75  # seconds that a line stays open for the next answer: a person looks at a pair for longer than a script


def serve(command: Serve) -> Facts:
    """Shows the page until Ctrl-C; gives where it was."""
    password = os.environ.get(PASSWORD) or None
    if password is not None and len(password) > LONGEST_PASSWORD:
        raise InputError(
            f"got a password of {len(password)} letters in {PASSWORD}; at most {LONGEST_PASSWORD} are asked for. "
            "Take a shorter one."
        )
    with open_store(command.store, create=False) as store:
        run_id = None if command.run is None else store.find_run(command.run).id
        listener = listening(command.host, command.port)
        host, port = listener.getsockname()[:2]
        home = known_as(host)
        to = "/" if run_id is None else f"/runs/{run_id}/teach"

        def address(token: str) -> str:
            return f"http://{home}:{port}/enter?token={token}&next={quote(to)}"

        def again(token: str) -> None:
            say(f"In another browser: {address(token)}")

        doors = Doors(store.secret(), password, told=again)
        hosts = ["localhost", "127.0.0.1", "[::1]", home] if loopback(host) else ["*"]
        app = app_of(store, doors, hosts=hosts, pictures=drawings(store))
        quietly = uvicorn.Config(
            app,
            log_level="error" if os.environ.get(TRACEBACK, "") not in ("", "0") else "critical",
            server_header=False,
            timeout_keep_alive=LOOKING,
            timeout_graceful_shutdown=1,
        )
        server = uvicorn.Server(quietly)
        if os.environ.get(WITH_PARENT):
            threading.Thread(target=end_with_input, args=(server,), daemon=True).start()
        say(f"Open {address(doors.token)}")
        if not loopback(host):
            say("Others can reach this page: who has the address or the password may answer.")
        if command.browser and graphical():
            threading.Thread(target=webbrowser.open, args=(address(doors.token),), daemon=True).start()
        with contextlib.suppress(KeyboardInterrupt):
            server.run(sockets=[listener])
        return {"address": f"http://{home}:{port}", "store": store.name}


def drawings(store: Store) -> dict[str, Picture]:
    """What `hiprl show` draws of a run by its facts, drawn when somebody looks."""
    one_at_a_time = threading.Lock()  # Matplotlib's settings belong to the whole process

    def picture(name: str, run_id: str) -> bytes:
        # A page is there at once: nothing it stands on needs JAX or Matplotlib, which take seconds to import.
        from hiprl.report.figures import figure_of
        from hiprl.report.record import record
        from hiprl.report.style import look

        drawn = io.BytesIO()
        with one_at_a_time, look():
            figure_of(record(store, store.run(run_id)), name).savefig(drawn, format="png")
        return drawn.getvalue()

    return {name: partial(picture, name) for name in DRAWN}


def listening(host: str, port: int) -> socket.socket:
    """A socket at this port, or at the next free one.

    Raises:
        InputError: there is no such port, none is free, or the address is not one of this machine.
    """
    if not 0 <= port < 65536:
        raise InputError(f"got port {port}; a port is a number from 0 to 65535. Say for example `--port 8700`.")
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        for tried in range(port, min(port + TRIED_PORTS, 65536)):
            listener = socket.socket(family)
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                listener.bind((host, tried))
                listener.listen()  # until one does, two may hold the same port
            except OSError as e:
                listener.close()
                if e.errno not in (98, 48, 10048):  # in use, on Linux, macOS and Windows
                    raise
                continue
            return listener
    except (OSError, OverflowError) as e:
        raise InputError(
            f"cannot listen at {host} port {port} ({e}); an address of this machine and a free port are needed. "
            "Leave both out, or say for example `--port 8700`."
        ) from e
    raise InputError(f"the ports from {port} on are all in use; a free one is needed. Say for example `--port 8700`.")


def loopback(host: str) -> bool:
    """Whether only this machine can reach this address."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def known_as(host: str) -> str:
    """What a browser calls an address of this machine."""
    if host in ("127.0.0.1", "::1", "localhost"):
        return "localhost"
    if host in ("0.0.0.0", "::"):  # all addresses, and the address of none
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


def graphical() -> bool:
    """Whether a browser would have a window; one in the terminal would be in the way."""
    return sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def end_with_input(server: uvicorn.Server) -> None:
    """Ends the page when the process that began it is gone."""
    sys.stdin.buffer.read()
    os.kill(os.getpid(), signal.SIGINT)
    server.should_exit = True
