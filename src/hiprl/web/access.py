"""Who may come in: a token that is good once, or a password, and a cookie afterwards; and what a browser may do."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
from collections.abc import Callable
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LONGEST_PASSWORD = 200  # letters
LARGEST = 16 * 1024  # bytes of a request: an answer has a few hundred
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with none, browsers do not say from where a form was sent
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
OPEN_PATHS = ("/enter", "/static/")  # for everybody


class Doors:
    """What opens the pages on a store. A browser that came in by one of them is known to all, and to later ones."""

    def __init__(self, secret: str, password: str | None = None, *, told: Callable[[str], None] = lambda token: None):
        """What the pages share, and what opens this one.

        Args:
            secret: the store's.
            password: that lets in everybody who knows it. Who came in with another one has to enter again.
            told: called with each token that opens the page once: a used one is followed by another.
        """
        self._password, self._told = password, told
        self._session = hmac.new(secret.encode(), (password or "").encode(), hashlib.sha256).hexdigest()
        self.cookie = f"hiprl-{hashlib.sha256(self._session.encode()).hexdigest()[:6]}"
        """Its name: browsers share cookies among all ports of a machine, where pages on other stores may be."""
        self._lock = threading.Lock()
        self.token = secrets.token_urlsafe(24)

    def enters(self, given: str) -> bool:
        """Whether this is the password, or the token, which then is another."""
        if self._password is not None and hmac.compare_digest(given.encode(), self._password.encode()):
            return True
        with self._lock:
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return False
            self.token = secrets.token_urlsafe(24)
        self._told(self.token)
        return True

    def knows(self, request: Request) -> bool:
        """Whether this browser came in before."""
        return hmac.compare_digest(request.cookies.get(self.cookie, "").encode(), self._session.encode())

    def let_in(self, response: Response) -> Response:
        """The response with the cookie by which the browser is known."""
        response.set_cookie(self.cookie, self._session, httponly=True, samesite="strict", path="/")
        return response


def foreign(headers: Headers) -> bool:
    """Whether a request that changes something was sent by another site's page.

    A browser that says so itself is believed: behind a proxy, the host that is asked may not be the one in its address.
    """
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    if site is not None:
        return site not in ("same-origin", "none")
    return origin is not None and urlsplit(origin).netloc != headers.get("host")


class Guard:
    """Limits the size of requests, and tells browsers what no page of ours does."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        size = Headers(scope=scope).get("content-length", "0")
        if not size.isdecimal() or int(size) > LARGEST:
            await Response("too large", 413, headers=HEADERS)(scope, receive, send)
            return
        read = 0

        async def limited() -> Message:
            nonlocal read
            message = await receive()
            read += len(message.get("body", b""))
            if read > LARGEST:  # it did not say how much it sends, or less
                raise HTTPException(413, "That is too large.")
            return message

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                still = scope["path"].startswith("/static/")  # the same for all, and asked for by its ETag
                headers.setdefault("Cache-Control", "no-cache" if still else "no-store")
            await send(message)

        await self._app(scope, limited, guarded)
