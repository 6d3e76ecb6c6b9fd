"""What no browser sends, over a socket, to a server in a process of its own."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest

from benchmarks.clicker import started
from hiprl.store.store import open_store
from tests.web.made import a_taught_run

GET = b"GET / HTTP/1.1\r\nHost: localhost\r\n"
POST = b"POST /api/runs/RUN/answers HTTP/1.1\r\nHost: localhost\r\nX-Hiprl: 1\r\n"
SAID = b'{"k": 1, "judge": "a", "answer": {"form": "equal"}}'
SENT = [
    *(b"", b"\r\n\r\n", b"\x00" * 100, b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03", b"GET\r\n\r\n", b"G" * 70000),
    *(b"GET / HTTP/9.9\r\n\r\n", b"GET http://evil.example/ HTTP/1.1\r\nHost: evil.example\r\n\r\n", GET + b"\r\n"),
    *(b"BREW / HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"GET /\x80\xff HTTP/1.1\r\n\r\n"),
    *(b"GET /%ff%00 HTTP/1.1\r\nHost: localhost\r\n\r\n", b"GET //enter//../../etc/passwd HTTP/1.1\r\n\r\n"),
    *(GET + b"Cookie: hiprl=\xff\xfe\r\n\r\n", GET + b"Cookie: " + b"a=b; " * 5000 + b"\r\n\r\n", GET + b": x\r\n\r\n"),
    *(
        GET + b"Content-Length: -1\r\n\r\n",
        GET + b"Content-Length: 1e9\r\n\r\n",
        GET + b"Content-Length: 9999999\r\n\r\n",
    ),
    *(POST + b"Content-Length: 51\r\nContent-Length: 5\r\n\r\n" + SAID, POST + b"Content-Length: 51\r\n\r\n" + SAID),
    *(POST + b"Transfer-Encoding: chunked\r\n\r\nzz\r\n" + SAID, POST + b"Content-Length: 90\r\n\r\n" + SAID),
    POST + b"Transfer-Encoding: chunked\r\n\r\n" + b"2000\r\n" + b" " * 8192 + b"\r\n" + b"4000\r\n" + b" " * 16384,
    b"POST /enter HTTP/1.1\r\nHost: localhost\r\nContent-Length: 12\r\n\r\ntoken=%ff%fe",
    b"GET /api/runs/RUN/events HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\r\n",
]


@pytest.mark.slow
def test_what_no_browser_sends_gets_no_traceback_and_writes_nothing(tmp_path: Path):
    path = str(tmp_path / "runs.db")
    with open_store(path) as store, started("serve", "--store", path, "--port", "8700") as page:
        run_id = a_taught_run(store)
        port = int(re.search(r":(\d+)/", page.address)[1])
        for sent in SENT:
            reply = said_to(port, sent.replace(b"RUN", run_id.encode()))
            assert not re.match(rb"HTTP/1\.1 (2|5)", reply), (sent[:80], reply[:80])
            assert b"Traceback" not in reply and run_id.encode() not in reply
        assert not store.answers(run_id) and store.goal(run_id) is None and len(store.questions(run_id)) == 3
        assert said_to(port, b"GET /enter HTTP/1.1\r\nHost: localhost\r\n\r\n", patience=60).startswith(b"HTTP/1.1 200")
        assert len(page.said) == 1, "".join(page.said)  # its address, and nothing else


def said_to(port: int, sent: bytes, patience: float = 2) -> bytes:
    """What comes back within a while, or until the line is cut."""
    with socket.create_connection(("127.0.0.1", port), timeout=patience) as line:
        try:
            line.sendall(sent)
            line.shutdown(socket.SHUT_WR)
            return b"".join(iter(lambda: line.recv(65536), b""))
        except OSError:
            return b""
