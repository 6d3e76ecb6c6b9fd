"""How soon the page is there, and what a pair of clips weighs: a real browser, WebGL in software, nothing cached.

Of each environment six episodes of random actions are filmed, and questions about two clips of 50 steps asked. Needs
Playwright (in hiprl's extra `dev`) and a Chromium of the system.
"""

from __future__ import annotations

import re
import statistics
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.clicker import chromium, started
from benchmarks.common import Report, parser, progress
from benchmarks.judges import filled

ENVS = ("InvertedPendulum-v5", "HalfCheetah-v5", "Hopper-v5", "Ant-v5", "Humanoid-v5")
QUESTIONS = 3
PAINT = "() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? null"


def looked_at(browser: Any, address: str, home: str, run_id: str) -> dict[str, float]:
    """One visit by a browser that was never here: milliseconds, and bytes on the wire."""
    context = browser.new_context()
    page = context.new_page()
    pairs: list[int] = []
    page.on("response", lambda r: pairs.append(int(r.headers["content-length"])) if "/next?" in r.url else None)
    page.goto(address)
    page.evaluate("localStorage.setItem('hiprl.judge', 'me')")
    page.goto("about:blank")
    page.goto(f"{home}/runs/{run_id}/teach")
    page.wait_for_selector("#teach[data-mode=asking] canvas", timeout=120_000)
    pair, paint = page.evaluate("() => performance.now()"), page.evaluate(PAINT)
    context.close()
    return {"first_paint": paint, "first_pair": pair, "bytes": max(pairs)}


def main() -> None:
    """Visits the page of each environment and reports."""
    made = parser(__doc__)
    made.add_argument("--envs", nargs="+", default=list(ENVS), metavar="ENV", help="what is to be seen")
    made.add_argument("--visits", type=int, default=5, help="visits each, of which the median counts")
    options = made.parse_args()
    if options.quick:
        options.envs, options.visits = [ENVS[0]], 1
    from hiprl.cli.machine import prepare

    prepare()
    report = Report("First paint, and a pair of clips on the wire")
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        store = str(Path(folder) / "runs.db")
        for env in options.envs:
            progress(env)
            run_id = filled(store, QUESTIONS, env=env)
            visits = []
            for _ in range(options.visits):
                with started("serve", "--store", store, "--port", "8700") as page:  # a token lets one in
                    home = re.match(r"http://[^/]+", page.address)[0]
                    visits.append(looked_at(browser, page.address, home, run_id))
            median = {name: statistics.median(one[name] for one in visits) for name in visits[0]}
            most = {f"most_{name}": max(one[name] for one in visits) for name in visits[0]}
            report.add(env=env, visits=options.visits, **median, **most)
    report.notes.append("first_paint, first_pair: milliseconds from the request, median of visits; bytes: of a pair.")
    report.show()
    report.write(options.json)


if __name__ == "__main__":
    main()
