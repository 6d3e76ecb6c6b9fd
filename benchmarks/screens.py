"""Pictures of the pages for the documentation: a run that people teach, as a browser shows it.

Needs Playwright (in hiprl's extra `dev`) and a Chromium of the system. Nothing is answered.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

from benchmarks.clicker import chromium, started
from hiprl.store.store import open_store

SIZES = {"": (1180, 860), "-phone": (390, 844)}
PAGES = {"teach": "/runs/{}/teach", "review": "/runs/{}/review", "progress": "/runs/{}"}
SETTLE = 4000  # milliseconds until clips play


def main() -> None:
    """Opens each page and writes what is to be seen."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument("run", help="the run's id")
    made.add_argument("--store", required=True, help="where the run is kept")
    made.add_argument("--out", type=Path, default=Path("docs"), help="folder for the pictures")
    options = made.parse_args()
    with open_store(options.store, create=False) as store:
        judge = next((answer.judge for answer in store.answers(store.find_run(options.run).id)), "me")
    with started("serve", "--store", options.store, "--port", "8700") as page, chromium() as browser:
        home = re.match(r"http://[^/]+", page.address)[0]
        context = browser.new_context()
        tab = context.new_page()
        tab.goto(page.address)
        tab.evaluate(f"localStorage.setItem('hiprl.judge', {json.dumps(judge)})")  # who may change answers
        for name, path in PAGES.items():
            for suffix, (width, height) in SIZES.items():
                if suffix and name != "teach":
                    continue
                tab.set_viewport_size({"width": width, "height": height})
                tab.emulate_media(color_scheme="dark" if suffix else "light")
                tab.goto(home + path.format(options.run))
                tab.wait_for_timeout(SETTLE)
                if name == "review" and tab.locator("#list button").count():
                    tab.locator("#list button").first.click()
                    tab.wait_for_timeout(SETTLE)
                tab.screenshot(path=options.out / f"page-{name}{suffix}.png")
        context.close()


if __name__ == "__main__":
    main()
