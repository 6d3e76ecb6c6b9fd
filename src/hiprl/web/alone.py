"""One file that shows a behaviour in 3-D and needs nothing else: to mail, and to open anywhere."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from pathlib import Path
from typing import Any

from hiprl.data.film import Film
from hiprl.web.shown import as_text

STATIC = Path(__file__).parent / "static"
START = """
const told = JSON.parse(document.getElementById("told").textContent);
const player = window.hiprlPlayer(document.getElementById("player"), { ...told, onPick: () => player.toggle() });
document.addEventListener("keydown", (event) => {
  if (event.key !== " " || event.repeat || event.target !== document.body) return;
  event.preventDefault();
  player.toggle();
});
"""
PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data: blob:;
 script-src {hashes}">
<title>{title}</title>
<style>
html, body {{ margin: 0; height: 100%; font: 16px/1.5 system-ui, sans-serif; background: Canvas; color: CanvasText; }}
#player {{ max-width: 72rem; margin: 0 auto; padding: 1rem; }}
</style>
</head>
<body>
<main id="player" aria-label="{title}"></main>
<script type="application/json" id="told">{told}</script>
<!-- {notice} -->
<script>{player}</script>
<script>{start}</script>
</body>
</html>
"""


def page_of(scene: dict[str, Any], films: list[tuple[str, Film]], title: str) -> str:
    """The file's text.

    Args:
        scene: what the films play in.
        films: a name for each, and what is to be seen.
        title: what it shows.
    """
    player = (STATIC / "player.js").read_text(encoding="utf-8")
    notice = (STATIC / "NOTICES.txt").read_text(encoding="utf-8").replace("--", "- -")
    told = {
        "scene": scene,
        "clips": [clip_of(film) for _, film in films],
        "titles": [name for name, _ in films],
        "title": title,
    }
    return PAGE.format(
        title=html.escape(title),
        told=json.dumps(told).replace("<", "\\u003c"),  # so that no text in it ends the script
        notice=notice,
        player=player,
        start=START,
        hashes=" ".join(f"'sha256-{digest(script)}'" for script in (player, START)),
    )


def clip_of(film: Film) -> dict[str, Any]:
    """What is to be seen of a whole film."""
    if film.poses is not None:
        return {"steps": len(film.poses) - 1, "poses": as_text(film.poses)}
    pictures = ["data:image/jpeg;base64," + base64.b64encode(one).decode() for one in film.pictures or ()]
    return {"steps": len(pictures) - 1, "frames": pictures}


def digest(script: str) -> str:
    """By which a browser knows a script that may run."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
