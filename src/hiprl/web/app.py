"""The routes of the labelling page, put together."""

from __future__ import annotations

import json
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, quote

import anyio
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, RedirectResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.templating import Jinja2Templates

from hiprl.data.answer import Answer
from hiprl.data.words import goal_in, name_in
from hiprl.errors import Answered, HiprlError, InputError
from hiprl.store.store import Store
from hiprl.web.access import LONGEST_PASSWORD, OPEN_PATHS, Doors, Guard, foreign
from hiprl.web.shown import Shown, taught_by_people, turned

HERE = Path(__file__).parent
RUN = re.compile(r"[a-z0-9-]{1,250}")
PAUSE = 0.5  # seconds that a wrong guess of the password takes, one at a time
LOOK = 1.0  # seconds between two looks for news
STAY = 15.0  # seconds after which a word is sent to a page, so that the line stays open

Handler = Callable[..., Any]
"""Of a request and, where something is sent, the object that was."""


Picture = Callable[[str], bytes]
"""Of a run's id: a PNG."""


def app_of(store: Store, doors: Doors, *, hosts: list[str], pictures: Mapping[str, Picture] | None = None) -> Starlette:
    """The page for a store.

    Args:
        store: what it shows, and where answers go.
        doors: who may come in.
        pictures: what can be drawn of a run, by name.
        hosts: names by which browsers may call it; others are refused, as a foreign site may point its name here.
    """
    shown, drawn = Shown(store), dict(pictures or {})
    templates, guessing = Jinja2Templates(HERE / "templates"), anyio.Lock()

    def guarded(handler: Handler) -> Callable[[Request], Awaitable[Response]]:
        """The handler for those who came in, in a thread; what is wrong is said in words."""

        async def handle(request: Request) -> Response:
            if not doors.knows(request):
                if request.url.path.startswith("/api/"):
                    return JSONResponse({"error": "Enter first: open the address that the terminal shows."}, 401)
                return RedirectResponse(f"/enter?next={quote(there(request.url.path))}", 303)
            sent = [await body_of(request)] if request.method == "POST" else []
            result = await run_in_threadpool(handler, request, *sent)
            return result if isinstance(result, Response) else JSONResponse(result)

        return handle

    def run_of(request: Request) -> str:
        run_id = request.path_params["run"]
        try:
            return store.run(run_id if RUN.fullmatch(run_id) else "").id
        except InputError as e:
            raise HTTPException(404, f"There is no run {run_id[:60]!r}.") from e

    def page(name: str) -> Callable[[Request], Awaitable[Response]]:
        def render(request: Request) -> Response:
            run_id = run_of(request)
            row, finished = store.run(run_id), store.final(run_id) is not None
            people = taught_by_people(row)
            if not people and name != "run":  # there is nothing to say on the other pages
                return RedirectResponse(f"/runs/{run_id}", 303)
            told = {"run": run_id, "env": row.env, "goal": store.goal(run_id), "people": people, "finished": finished}
            return templates.TemplateResponse(request, f"{name}.html", told)

        return guarded(render)

    def runs(request: Request) -> Response:
        return templates.TemplateResponse(request, "runs.html", {"runs": shown.runs()})

    def scene(request: Request) -> Any:
        found = store.scene(run_of(request))
        if found is None:
            raise HTTPException(404, "Nothing was filmed in this run; only runs of `hiprl teach` are.")
        return JSONResponse(found, headers={"Cache-Control": "private, max-age=86400"})

    def next_question(request: Request) -> Any:
        run_id = run_of(request)
        judge = name_in(request.query_params.get("judge", ""))
        row = None if store.enough(run_id) else store.claim(run_id, judge)
        return {"question": None if row is None else shown.question(row), "progress": shown.lately(run_id, seconds=0.0)}

    def last_question(request: Request) -> Any:
        run_id, judge = run_of(request), name_in(request.query_params.get("judge", ""))
        mine = [row for row in store.answers(run_id) if row.judge == judge]
        if not mine:
            return {"question": None}
        row = mine[-1]
        question = next(question for question in store.questions(run_id) if question.k == row.k)
        return {"question": shown.question(question, swapped=row.swapped, answer=row.answer)}

    def one_question(request: Request) -> Any:
        run_id, k = run_of(request), int(request.path_params["k"])
        for question in store.questions(run_id):
            if question.k == k:
                return {"question": shown.question(question, swapped=False, answer=question.answer)}
        raise HTTPException(404, f"Run {run_id} has no question {k}.")

    def answer(request: Request, body: dict[str, Any]) -> Any:
        run_id, k, swapped = run_of(request), body.get("k"), body.get("swapped", False)
        said, judge = body.get("answer"), name_in(body.get("judge", ""))
        if type(k) is not int or not 0 <= k < 1 << 31 or not isinstance(swapped, bool) or not isinstance(said, dict):
            raise HTTPException(400, "An answer has k, judge, swapped and answer.")
        given = turned(Answer.taken(said), swapped)
        new = store.answer(run_id, k, given, judge, swapped=swapped, own=True)  # a turn at it may be over by now
        return {"new": new, "progress": shown.lately(run_id, seconds=0.0)}

    def goal(request: Request, body: dict[str, Any]) -> Any:
        run_id, words = run_of(request), goal_in(body.get("goal"))
        store.set_goal(run_id, words)
        return {"goal": words}

    def enough(request: Request, body: dict[str, Any]) -> Any:
        run_id, judge = run_of(request), name_in(body.get("judge", ""))
        if not store.answers(run_id):
            raise HTTPException(400, "Nothing was answered yet, so that there is nothing to learn from. Answer first.")
        store.say_enough(run_id, judge)
        return {"progress": shown.lately(run_id, seconds=0.0)}

    def facts(request: Request) -> Any:
        run_id = run_of(request)
        linked = [{"url": f"/runs/{run_id}/pictures/{name}.png", "title": name.replace("-", " ")} for name in drawn]
        return shown.facts(run_id) | {"pictures": linked if store.episodes(run_id) else []}

    def picture(request: Request) -> Response:
        draw = drawn.get(request.path_params["name"])
        if draw is None:
            raise HTTPException(404, "There is no picture of this name.")
        return Response(draw(run_of(request)), media_type="image/png")

    async def events(request: Request) -> Response:
        if not doors.knows(request):
            return JSONResponse({"error": "Enter first."}, 401)
        run_id = await run_in_threadpool(run_of, request)

        async def news() -> AsyncIterator[str]:
            before, silent = None, 0.0
            while not await request.is_disconnected():
                told = await run_in_threadpool(partial(shown.lately, run_id, seconds=LOOK / 2))
                if told != before:
                    before, silent = told, 0.0
                    yield f"event: progress\ndata: {json.dumps(told)}\n\n"
                elif silent >= STAY:
                    silent = 0.0
                    yield ": still here\n\n"
                await anyio.sleep(LOOK)
                silent += LOOK

        at_once = {"X-Accel-Buffering": "no"}  # also through nginx
        return StreamingResponse(news(), media_type="text/event-stream", headers=at_once)

    async def enter(request: Request) -> Response:
        told = dict(request.query_params)
        if request.method == "POST":
            if foreign(request.headers):
                raise HTTPException(403, "This came from another site.")
            told = form_of(await request.body())
        given, to = told.get("token", ""), there(told.get("next", "/"))
        if 0 < len(given) <= LONGEST_PASSWORD and doors.enters(given):
            return doors.let_in(RedirectResponse(to, 303))
        if doors.knows(request):
            return RedirectResponse(to, 303)
        wrong = bool(given) or request.method == "POST"
        if wrong:
            async with guessing:
                await anyio.sleep(PAUSE)
        shown_there = {"next": to, "error": "That does not open this page; a token is good once." if wrong else ""}
        return templates.TemplateResponse(request, "enter.html", shown_there, status_code=403 if wrong else 200)

    async def refused(request: Request, error: Exception) -> Response:
        """What went wrong, in words: JSON for scripts, a page for people, and never a traceback."""
        status, words = 500, "Something went wrong here; nothing was lost. Try again."
        if isinstance(error, HTTPException):
            status, words = error.status_code, str(error.detail)
        elif isinstance(error, HiprlError):
            kinds = {Answered: 409, InputError: 400, HiprlError: 503}
            status, words = next(code for kind, code in kinds.items() if isinstance(error, kind)), str(error)
        words = words.encode(errors="backslashreplace").decode()  # what was sent may hold half a sign
        if request.url.path.startswith("/api/"):
            return JSONResponse({"error": words}, status)
        told = {"status": status, "title": "Not here" if status == 404 else "That did not work", "text": words}
        return templates.TemplateResponse(request, "error.html", told, status_code=status)

    api = "/api/runs/{run}"
    routes = [
        Route("/", guarded(runs)),
        Route("/enter", enter, methods=["GET", "POST"]),
        Route("/runs/{run}", page("run")),
        Route("/runs/{run}/teach", page("teach")),
        Route("/runs/{run}/review", page("review")),
        Route("/runs/{run}/pictures/{name}.png", guarded(picture)),
        Route(f"{api}/scene", guarded(scene)),
        Route(f"{api}/next", guarded(next_question)),
        Route(f"{api}/last", guarded(last_question)),
        Route(f"{api}/now", guarded(lambda request: shown.now(run_of(request)))),
        Route(f"{api}/answers", guarded(lambda request: shown.answers(run_of(request))), methods=["GET"]),
        Route(f"{api}/answers", guarded(answer), methods=["POST"]),
        Route(f"{api}/questions/{{k:int}}", guarded(one_question)),
        Route(f"{api}/facts", guarded(facts)),
        Route(f"{api}/goal", guarded(goal), methods=["POST"]),
        Route(f"{api}/enough", guarded(enough), methods=["POST"]),
        Route(f"{api}/events", events),
        Mount("/static", StaticFiles(directory=HERE / "static")),
    ]
    return Starlette(
        routes=routes,
        middleware=[Middleware(Guard), Middleware(TrustedHostMiddleware, allowed_hosts=hosts)],
        exception_handlers={HTTPException: refused, HiprlError: refused, Exception: refused},
    )


async def body_of(request: Request) -> dict[str, Any]:
    """The object that a script of ours sent."""
    if foreign(request.headers) or request.headers.get("x-hiprl") != "1":
        raise HTTPException(403, "This came from another site.")
    try:
        found = json.loads(await request.body())
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise HTTPException(400, "A JSON object is needed.")
    return found


def form_of(body: bytes) -> dict[str, str]:
    """What a form sent; nothing, where it was none."""
    try:
        return dict(parse_qsl(body.decode(), max_num_fields=8))
    except ValueError:
        return {}


def there(path: str) -> str:
    """Where to go after the door: a page of ours, whatever an address says."""
    inside = path.startswith("/") and not path.startswith(("//", "/\\")) and path.isprintable()
    return path if inside and not path.startswith(OPEN_PATHS) else "/"
