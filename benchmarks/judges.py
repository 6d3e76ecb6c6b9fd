"""Many judges at once at one `hiprl serve`: how long they wait, and whether every answer is there once.

Each judge is a client of its own that listens to the progress as a page does, asks for a pair, looks at it for a while
and answers, by turns. Waits are those of
a client: from its request until all of the reply is there. Half of a judge's requests are answers, half ask for a pair,
and a pair comes with its clips. The clips are HalfCheetah's, filmed.
"""

from __future__ import annotations

import asyncio
import random
import re
import tempfile
import time
from collections import Counter
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.clicker import started
from benchmarks.common import Report, parser, progress

ENV = "HalfCheetah-v5"
EPISODES = 6
CLIP = 50


class Waits(NamedTuple):
    """Seconds of each request."""

    pairs: list[float]
    answers: list[float]


def filled(where: str, questions: int, *, env: str = ENV) -> str:
    """A run with films of random actions and so many open questions; gives its id."""
    import jax.numpy as jnp
    import jax.random as jr

    from hiprl.config import Config, teachable
    from hiprl.control.policy import Uniform
    from hiprl.spec import to_plain
    from hiprl.store.rows import PEOPLE, ClipRow
    from hiprl.store.store import open_store
    from hiprl.world.build import world_from

    world = world_from(env)
    scene = world.start_filming()
    draw = random.Random(0)
    with open_store(where) as store:
        spec = {"config": to_plain(teachable(Config())), "horizon": world.H, "judge": PEOPLE}
        run_id = store.add_run(env, 0, spec, {})
        store.set_scene(run_id, scene)
        store.set_goal(run_id, "run forwards")
        lengths = []
        for i in range(EPISODES):
            tau = world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.key(i))
            store.add_trajectory(run_id, i, tau, "random", film=world.film.to_bytes())
            lengths.append(int(tau.length))
        for k in range(1, questions + 1):
            one, other = draw.sample(range(EPISODES), 2)
            clips = [ClipRow(i, draw.randrange(max(lengths[i] - CLIP, 1)), CLIP) for i in (one, other)]
            store.ask(run_id, k, clips)
    return run_id


async def listen(client: Any, run_id: str) -> None:
    """Holds the line on which a page is told how far the run is."""
    async with client.stream("GET", f"/api/runs/{run_id}/events", timeout=None) as reply:
        async for _ in reply.aiter_bytes():
            pass


async def judge(client: Any, run_id: str, name: str, answers: int, pause: float, waits: Waits) -> list[int]:
    """Answers so many questions; gives their numbers."""
    draw, answered = random.Random(name), []
    await asyncio.sleep(draw.uniform(0, pause))  # nobody begins on the stroke
    news = asyncio.create_task(listen(client, run_id))
    for _ in range(answers):
        began = time.perf_counter()
        reply = await client.get(f"/api/runs/{run_id}/next", params={"judge": name})
        waits.pairs.append(time.perf_counter() - began)
        question = reply.raise_for_status().json()["question"]
        if question is None:
            break
        await asyncio.sleep(draw.uniform(0.5, 1.5) * pause)
        said = {"form": "level", "value": draw.randint(-2, 2), "levels": 5}
        body = {"k": question["k"], "judge": name, "swapped": question["swapped"], "answer": said}
        began = time.perf_counter()
        reply = await client.post(f"/api/runs/{run_id}/answers", json=body, headers={"X-Hiprl": "1"})
        waits.answers.append(time.perf_counter() - began)
        if reply.raise_for_status().json()["new"]:
            answered.append(question["k"])
    news.cancel()
    return answered


async def all_at_once(address: str, run_id: str, judges: int, answers: int, pause: float) -> tuple[Waits, list[int]]:
    """What they waited, and which questions they answered."""
    import httpx2 as httpx

    home, waits = re.match(r"http://[^/]+", address)[0], Waits([], [])
    async with AsyncExitStack() as stack:
        first = await stack.enter_async_context(httpx.AsyncClient(base_url=home))
        await first.get(address)  # the token lets this client in, and the others with it
        clients = [httpx.AsyncClient(base_url=home, timeout=60, cookies=first.cookies) for _ in range(judges)]
        each = [
            judge(await stack.enter_async_context(client), run_id, f"judge {i}", answers, pause, waits)
            for i, client in enumerate(clients)
        ]
        answered = await asyncio.gather(*each)
    return waits, [k for one in answered for k in one]


def kept(where: str, run_id: str) -> list[int]:
    """The questions that the store has answers to, one entry for each answer."""
    from hiprl.store.store import open_store

    with open_store(where, create=False) as store:
        return [row.k for row in store.answers(run_id)]


def share(waits: list[float], part: float) -> float:
    """The wait that this part of all does not exceed, in milliseconds."""
    return 1000 * sorted(waits)[min(int(part * len(waits)), len(waits) - 1)]


def main() -> None:
    """Lets them judge and reports."""
    made = parser(__doc__)
    made.add_argument("--judges", type=int, default=20, help="how many at once")
    made.add_argument("--answers", type=int, default=20, help="that each of them gives")
    made.add_argument("--pause", type=float, default=2.0, help="seconds that a judge looks at a pair, on average")
    made.add_argument("--store", help="address of a PostgreSQL database; a new SQLite file if not given")
    options = made.parse_args()
    if options.quick:
        options.judges, options.answers, options.pause = 3, 2, 0.1
    with tempfile.TemporaryDirectory() as folder:
        where = options.store or str(Path(folder) / "judged.db")
        progress(f"{options.judges} judges, {options.answers} answers each")
        run_id = filled(where, options.judges * options.answers)
        with started("serve", run_id, "--store", where, "--port", "8700") as page:
            began = time.perf_counter()
            everything = all_at_once(page.address, run_id, options.judges, options.answers, options.pause)
            waits, answered = asyncio.run(everything)
            seconds = time.perf_counter() - began
        stored = kept(where, run_id)
    report = Report("Judges at once")
    both = {"pairs": waits.pairs, "answers": waits.answers, "all": waits.pairs + waits.answers}
    for what, values in both.items():
        report.add(
            requests=what,
            number=len(values),
            median_ms=share(values, 0.5),
            p95_ms=share(values, 0.95),
            most_ms=1000 * max(values),
        )
    twice = sum(n - 1 for n in Counter(stored).values())
    lost = len(set(answered) - set(stored))
    report.notes.append(
        f"{options.judges} judges gave {len(answered)} answers in {seconds:.0f} s; in the store {len(stored)}, "
        f"lost {lost}, doubled {twice}."
    )
    report.show()
    report.write(options.json, lost=lost, doubled=twice, judges=options.judges, store=where.split(":")[0])


if __name__ == "__main__":
    main()
