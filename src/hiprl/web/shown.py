"""What pages are told: questions with their clips, progress and facts, as plain values."""

from __future__ import annotations

import base64
import math
import secrets
import threading
import time
from functools import lru_cache
from typing import Any

import numpy as np

from hiprl.data.answer import Answer
from hiprl.data.facts import enough, foreseen
from hiprl.data.film import Film
from hiprl.store.rows import PEOPLE, AnswerRow, ClipRow, QuestionRow, RunRow
from hiprl.store.store import Store

Plain = dict[str, Any]

RECENT = 10  # answers by which it is told how many are foreseen
EARLY = 3  # answers after which it is told how many are foreseen
NOW = 100  # steps of the clip that shows what it does now
TOLD = ("k", "comparisons", "true_return", "return_by_reward", "worth", "foreseen", "coverage", "length", "searched")


class Shown:
    """Reads the store for pages."""

    def __init__(self, store: Store):
        self.store = store
        self._film = lru_cache(maxsize=128)(self._read_film)
        self._lock = threading.Lock()
        self._told: dict[str, tuple[float, Plain]] = {}

    def _read_film(self, run_id: str, number: int) -> tuple[Film | np.ndarray, bool]:
        film, imagined = self.store.film(run_id, number)
        seen = self.store.trajectory(run_id, number).states if film is None else Film.from_bytes(film)
        return seen, imagined

    def clip(self, run_id: str, clip: ClipRow) -> Plain:
        """What is seen of a clip."""
        film, imagined = self._film(run_id, clip.of)
        told: Plain = {"trajectory": clip.of, "start": clip.start, "imagined": imagined}
        if isinstance(film, np.ndarray):
            end = None if clip.length is None else clip.start + clip.length + 1
            states = film[clip.start : end]
            return told | {"steps": len(states) - 1, "states": as_text(states)}
        cut = film.cut(clip.start, clip.length)
        if cut.poses is not None:
            return told | {"steps": len(cut.poses) - 1, "poses": as_text(cut.poses)}
        pictures = ["data:image/jpeg;base64," + base64.b64encode(one).decode() for one in cut.pictures or ()]
        return told | {"steps": len(pictures) - 1, "frames": pictures}

    def question(self, row: QuestionRow, *, swapped: bool | None = None, answer: Answer | None = None) -> Plain:
        """A question as it is shown; sides are drawn where nobody says."""
        if swapped is None:
            swapped = len(row.clips) == 2 and secrets.randbelow(2) == 1
        clips = [self.clip(row.run_id, clip) for clip in row.clips]
        said = None if answer is None else turned(answer, swapped).plain()
        return {"k": row.k, "swapped": swapped, "clips": clips[::-1] if swapped else clips, "answer": said}

    def now(self, run_id: str) -> Plain:
        """What the reported policy did first, or while there is none, the newest thing that its policy did."""
        reported = (self.store.final(run_id) or {}).get("trajectory")  # which old stores do not tell
        number = self.store.newest(run_id, "policy") if reported is None else reported
        if number is None:
            return {"clip": None, "episode": None}
        episode = self.store.executed_before(run_id, number)
        return {"clip": self.clip(run_id, ClipRow(number, 0, NOW)), "episode": episode}

    def progress(self, run_id: str) -> Plain:
        """How far a run is."""
        row, facts = self.store.run(run_id), [facts for _, facts in self.store.episodes(run_id)]
        asked, answers = self.store.asked(run_id)
        sure, told = foreseen(facts, recent=RECENT)
        worth = [one["worth"] for one in facts if one.get("worth") is not None]
        planned = planned_of(row)
        done = self.store.final(run_id) is not None
        searched = any(one.get("searched") for one in facts)
        waiting = asked - answers
        people = taught_by_people(row)
        ending = self.store.enough(run_id) or answers >= planned > 0
        asks = people and waiting > 0 and not ending
        trying = "finishing" if ending else "learning" if searched or answers else "warming up"
        trained = self.store.trained(run_id)
        alone = "waiting" if asks else trying if trained else "stopped"
        return {
            "answers": answers,
            "planned": planned,
            "people": people,
            "trained": trained,
            "open": waiting if asks else 0,
            "episodes": len(facts),
            "sure": sure if told >= EARLY else None,
            "worth": worth[-1] if worth else None,
            "enough": enough(facts),
            "state": "finished" if done else alone,
            "goal": self.store.goal(run_id),
        }

    def lately(self, run_id: str, *, seconds: float) -> Plain:
        """`progress`, or what another page was told of it less than so many seconds ago: many may be listening."""
        with self._lock:  # the others wait for one, and need not ask again
            at, told = self._told.get(run_id, (-math.inf, {}))
            if time.monotonic() - at > seconds:
                told = self.progress(run_id)
                self._told[run_id] = time.monotonic(), told
            return told

    def facts(self, run_id: str) -> Plain:
        """What the page of a run tells."""
        row, facts = self.store.run(run_id), [facts for _, facts in self.store.episodes(run_id)]
        newest = next((one for one in reversed(facts) if one.get("weights")), {})
        return {
            "run": run_id,
            "env": row.env,
            "goal": self.store.goal(run_id),
            "finished": self.store.final(run_id) is not None,
            "planned": planned_of(row),
            "episodes": [{name: one.get(name) for name in TOLD} for one in facts],
            "weights": newest.get("weights", {}),
            "judges": newest.get("judges", []),
            "agreement": newest.get("agreement"),
        }

    def answers(self, run_id: str) -> list[Plain]:
        """All that was said, with whether the learned reward is of the same opinion, where it has heard it."""
        facts = [facts for _, facts in self.store.episodes(run_id)]
        latest = next((one for one in reversed(facts) if "disagrees" in one), {})
        agrees = dict.fromkeys(latest.get("agrees", []), True) | dict.fromkeys(latest.get("disagrees", []), False)
        questions = {question.k: question for question in self.store.questions(run_id)}
        given = self.store.answers(run_id)
        heard = latest.get("heard", len(given))  # which old stores do not tell
        newest = {row.k: (row, agrees.get(row.k) if i < heard else None) for i, row in enumerate(given)}
        return [self._answer(row, questions[k], verdict) for k, (row, verdict) in sorted(newest.items())]

    def _answer(self, row: AnswerRow, question: QuestionRow, agrees: bool | None) -> Plain:
        clips = [{"trajectory": clip.of, "start": clip.start, "steps": clip.length} for clip in question.clips]
        return {
            "k": row.k,
            "judge": row.judge,
            "answer": row.answer.plain(),
            "swapped": row.swapped,
            "at": row.created_at.isoformat(timespec="seconds"),
            "sided": row.answer.side != 0,
            "agrees": agrees,
            "clips": clips,
        }

    def runs(self) -> list[Plain]:
        """All runs, newest first."""
        return [self.run(row) for row in reversed(self.store.runs())]

    def run(self, row: RunRow) -> Plain:
        """A line of the list of runs."""
        told = self.progress(row.id)
        names = ("goal", "answers", "planned", "open", "state", "people")
        return {"run": row.id, "env": row.env, "judge": row.spec.get("judge")} | {name: told[name] for name in names}


def planned_of(row: RunRow) -> int:
    """How many answers a run is to have."""
    return int(row.spec.get("config", {}).get("comparisons", 0))


def taught_by_people(row: RunRow) -> bool:
    """Whether people answer, and no script does."""
    return row.spec.get("judge", PEOPLE) == PEOPLE


def turned(answer: Answer, swapped: bool) -> Answer:
    """An answer about clips that are shown the other way round."""
    if not swapped:
        return answer
    if answer.form == "ranking":
        last = answer.items - 1
        return Answer(form="ranking", value=tuple(last - i for i in answer.value))
    if answer.form in ("number", "choice", "level", "slider"):
        return Answer(form=answer.form, value=-answer.value, levels=answer.levels)
    return answer


def as_text(array: np.ndarray) -> str:
    """Numbers as a page reads them: base64 of little-endian float32."""
    return base64.b64encode(np.ascontiguousarray(array, "<f4").tobytes()).decode()
