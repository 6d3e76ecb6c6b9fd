"""A trainer and its judges, who meet in the store."""

from __future__ import annotations

import threading
import time
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from hiprl import teaching
from hiprl.algorithm import lived
from hiprl.config import Config, teachable
from hiprl.control.policy import Uniform
from hiprl.data.answer import choice, level
from hiprl.data.film import Film
from hiprl.errors import InputError
from hiprl.models.estimate import estimate_reward
from hiprl.report.evidence import evidence_of, opinions
from hiprl.session import RunSpec, latest, spec_of, start
from hiprl.store.rows import PEOPLE
from hiprl.store.store import Store, open_store
from hiprl.teaching import AGAIN, FIRST, OPEN, SEEN, Asking, Known, improved, taught
from hiprl.world.build import world_from
from tests.whole.tasks import TINY

pytestmark = pytest.mark.slow
CONFIG = teachable(replace(TINY, comparisons=6, question=replace(TINY.question, clip=7, candidates=50)))


class Judge(threading.Thread):
    """Answers what is open, by the states of the clips, until it is told to stop."""

    def __init__(self, path: str, run_id: str, name: str = "ada", *, most: int = 99):
        super().__init__(daemon=True)
        self.path, self.run_id, self.judge, self.most = path, run_id, name, most
        self.stop, self.given = threading.Event(), 0

    def run(self) -> None:
        with open_store(self.path) as store:
            while not self.stop.is_set() and self.given < self.most:
                question = store.claim(self.run_id, self.judge)
                if question is None:
                    time.sleep(0.02)
                    continue
                first, second = (self.likes(store, clip) for clip in question.clips)
                store.answer(self.run_id, question.k, level(2 * int(np.sign(first - second)), 5), self.judge)
                self.given += 1

    def likes(self, store: Store, clip) -> float:
        states = store.trajectory(self.run_id, clip.of).states[clip.start :][: (clip.length or 99) + 1]
        return -float(np.abs(states).mean())


def begun(path: str, config: Config = CONFIG) -> str:
    with open_store(path) as store:
        return start(store, world_from("linear"), RunSpec(seed=3, config=config, judge=PEOPLE))


def teach(path: str, run_id: str, **more) -> dict:
    with open_store(path) as store:
        return taught(store, run_id, world_from("linear"), **more)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """A run that two judges taught."""
    path = str(tmp_path_factory.mktemp("taught") / "runs.db")
    run_id = begun(path)
    judges = [Judge(path, run_id, name) for name in ("ada", "bo")]
    for judge in judges:
        judge.start()
    facts, waits = [], []
    summary = teach(path, run_id, watch=facts.append, wait=waits.append)
    for judge in judges:
        judge.stop.set()
        judge.join()
    return path, run_id, summary, facts, judges


def test_it_learns_from_all_answers_and_ends(done):
    path, run_id, summary, _, judges = done
    assert summary["comparisons"] == CONFIG.comparisons and summary["run"] == run_id
    with open_store(path) as store:
        questions = store.questions(run_id)
        assert len(questions) == CONFIG.comparisons and all(question.answer is not None for question in questions)
        assert store.final(run_id) == summary
        new = [frozenset(question.clips) for question in questions if question.k % AGAIN]
        assert len(set(new)) == len(new)  # never the same again, but where another judge is asked it too
    assert sum(judge.given for judge in judges) == CONFIG.comparisons


def test_it_practises_between_answers(done):
    path, run_id, _, facts, _ = done
    assert [one["k"] for one in facts] == list(range(1, len(facts) + 1))
    assert sum(one["searched"] for one in facts) >= 2 and facts[-1]["comparisons"] == CONFIG.comparisons
    with open_store(path) as store:
        taus = store.trajectories(run_id)
        T, P = evidence_of(store, store.run(run_id))
    assert len(taus) == len(facts) + 1 and int(T.count) == len(taus)
    assert int(P.count) == CONFIG.comparisons and (np.asarray(P.at_hand)[: CONFIG.comparisons] <= len(taus)).all()


def test_judges_are_held_against_each_other(done):
    path, run_id, _, facts, judges = done
    assert {"judges", "agreement"} <= set(facts[-1])
    with open_store(path) as store:
        row = store.run(run_id)
        T, P = evidence_of(store, row)
        found = opinions(store, row, P, estimate_reward(P, T, None, CONFIG.reward))
    gave = {judge.judge: judge.given for judge in judges if judge.given}
    told = {one["judge"]: one["answers"] for one in found["judges"]}
    assert told == (gave if len(gave) > 1 else {})  # one alone has nobody to agree with


def test_what_is_told_of_an_episode_says_how_well_answers_are_foreseen(done):
    facts = done[3]
    told = [one for one in facts if one["searched"]]
    assert {"weights", "disagrees", "foreseen", "worth"} <= set(told[-1])
    assert set(told[-1]["disagrees"]) <= set(range(1, CONFIG.comparisons + 1))


def test_a_scene_without_bodies_has_the_names_of_its_states(done):
    path, run_id, *_ = done
    with open_store(path) as store:
        assert store.scene(run_id) == {"kind": "states", "dt": 0.05, "names": ["s[0]", "s[1]", "s[2]"]}


class Stopped(Exception):
    pass


def test_a_trainer_that_was_stopped_goes_on_with_every_answer(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path)
    judge = Judge(path, run_id, most=4)
    judge.start()

    def stop(facts):
        if facts["searched"]:
            raise Stopped

    with pytest.raises(Stopped):
        teach(path, run_id, watch=stop)
    judge.join(60)
    with open_store(path) as store:
        before, episodes = store.answers(run_id), len(store.episodes(run_id))
        store.answer(run_id, before[0].k, choice(True), "ada")  # changed while no trainer is there
    judge = Judge(path, run_id)
    judge.start()
    facts: list = []
    summary = teach(path, run_id, watch=facts.append)
    judge.stop.set()
    judge.join()
    assert facts[0]["k"] == episodes + 1 and summary is not None
    with open_store(path) as store:
        after = store.answers(run_id)
        assert after[: len(before)] == before and len({row.k for row in after}) == CONFIG.comparisons
    with pytest.raises(InputError, match="is finished"):
        teach(path, run_id)


def asking_of(store: Store, run_id: str) -> Asking:
    """Asking of a run that has random episodes only; its threads are not started."""
    world, row, spec = world_from("linear"), store.run(run_id), spec_of(store, run_id)
    run, key = latest(store, run_id, world, spec), jr.key(7)
    for number in range(1, 4):
        tau = world.roll_out(Uniform(jnp.ones(()), world.q), key=jr.fold_in(key, number))
        store.add_trajectory(run_id, number, tau, "random")
        run = eqx.tree_at(lambda run: run.T, run, run.T.add(tau))
    return Asking(store, row, spec.config, Known(run), key=key)


def test_the_next_pair_waits_for_no_fit_and_the_last_pairs_for_something_new(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path)
    with open_store(path) as store:
        asking = asking_of(store, run_id)
        for k in range(1, 5):  # nothing of it is taken in meanwhile
            asking.ask()
            assert store.claim(run_id, "ada").k == k
            asking.ask()
            assert len(store.questions(run_id)) == min(k + OPEN, 4)  # half of them are kept, but for the first four
            store.answer(run_id, k, level(2, 5), "ada")
        asking.ask()
        assert store.claim(run_id, "ada") is None and asking.known.answers == 0
        asking.listen()
        assert asking.known.answers == 4 and asking.most() == 4
        asking.trainer_waits = True  # nothing new comes before the next answer
        asking.ask()
        assert asking.most() == 6 and store.claim(run_id, "ada").k == 5


def test_where_all_pairs_are_answered_something_new_is_tried_first(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path, replace(CONFIG, question=replace(CONFIG.question, clip=None)))
    with open_store(path) as store:
        asking = asking_of(store, run_id)
        taus = asking.known.run.T
        asking.known = Known(eqx.tree_at(lambda run: run.T.count, asking.known.run, 2))
        asking.ask()
        assert len(store.questions(run_id)) == 1 and not asking.exhausted  # two trajectories, one pair: it is open
        store.answer(run_id, 1, level(2, 5), "ada")
        asking.ask()
        assert len(store.questions(run_id)) == 1 and asking.exhausted
        asking.known = Known(eqx.tree_at(lambda run: run.T, asking.known.run, taus))
        asking.ask()
        assert len(store.questions(run_id)) > 1


def test_two_answers_are_enough_to_end(tmp_path):
    path = str(tmp_path / "runs.db")
    question = replace(CONFIG.question, clip=None)
    run_id = begun(path, replace(CONFIG, comparisons=2, warm_up=2, question=question))
    judge = Judge(path, run_id)
    judge.start()
    summary = teach(path, run_id)
    judge.stop.set()
    judge.join()
    assert summary["comparisons"] == 2


def test_there_is_a_pair_for_each_who_looks(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path)
    with open_store(path) as store:
        asking = asking_of(store, run_id)
        for name in ("ada", "bo"):
            asking.ask()
            assert store.claim(run_id, name) is not None
        asking.ask()
        assert store.unseen(run_id) == OPEN and len(store.questions(run_id)) == 2 + OPEN


def test_the_first_pair_is_there_before_the_warm_up_is_over(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path, replace(CONFIG, warm_up=SEEN + 2))

    def look(facts):
        if facts["k"] == SEEN:
            until = time.monotonic() + 120
            with open_store(path) as store:
                while not store.questions(run_id) and time.monotonic() < until:
                    time.sleep(0.05)
                assert store.questions(run_id)
            raise Stopped

    with pytest.raises(Stopped):
        teach(path, run_id, watch=look)


def test_a_trainer_that_is_killed_while_it_learns_leaves_no_half_of_an_episode(tmp_path, monkeypatch):
    path = str(tmp_path / "runs.db")
    run_id = begun(path)
    judge = Judge(path, run_id, most=4)
    judge.start()

    def cut_off(run, new, *more, **named):
        if new.searched:
            raise Stopped
        return lived(run, new, *more, **named)

    monkeypatch.setattr(teaching, "lived", cut_off)
    with pytest.raises(Stopped):
        teach(path, run_id)
    monkeypatch.undo()
    judge.join(60)
    with open_store(path) as store:
        episodes = len(store.episodes(run_id))
        assert len(store.trajectories(run_id)) == episodes + 1
    judge = Judge(path, run_id)
    judge.start()
    facts: list = []
    teach(path, run_id, watch=facts.append)  # by another r̂ than the search that was cut off
    judge.stop.set()
    judge.join()
    assert facts[0]["k"] == episodes + 1 and facts[0]["searched"]


def test_an_episode_is_kept_for_each_answer_that_is_to_come(tmp_path):
    path, config, seen = str(tmp_path / "runs.db"), replace(CONFIG, comparisons=8, warm_up=4), []
    run_id = begun(path, config)

    def answer(what):
        for _ in range({"": 0, "the first answers": FIRST, "an answer": 1}[what]):
            with open_store(path) as store:
                while (question := store.claim(run_id, "ada")) is None:
                    time.sleep(0.02)
                store.answer(run_id, question.k, level(2, 5), "ada")

    teach(path, run_id, watch=lambda facts: seen.append((facts["k"], facts["comparisons"])), wait=answer)
    assert all(k + 1 <= max(config.warm_up, config.trajectories - (8 - answers)) for k, answers in seen)
    assert seen[-1][1] == 8 and seen[-1][0] + 1 == config.trajectories


def test_it_ends_when_a_judge_has_had_enough(tmp_path):
    path, waits = str(tmp_path / "runs.db"), []
    run_id = begun(path)

    def answer(what):
        waits.append(what)
        if what == "the first answers":
            with open_store(path) as store:
                for _ in range(2):
                    while (question := store.claim(run_id, "ada")) is None:
                        time.sleep(0.02)
                    store.answer(run_id, question.k, level(2, 5), "ada")
                store.say_enough(run_id, "ada")

    summary = teach(path, run_id, wait=answer)
    assert summary["comparisons"] == 2 < FIRST and "an answer" not in waits
    with open_store(path) as store:
        assert store.final(run_id) == summary and len(store.questions(run_id)) <= 2 + OPEN
        assert any(facts["searched"] for _, facts in store.episodes(run_id))


def test_a_corrected_answer_is_practised_as_a_new_one_is(tmp_path):
    path, resting = str(tmp_path / "runs.db"), []
    run_id = begun(path, replace(CONFIG, comparisons=12))

    def enough():
        with open_store(path) as store:
            store.say_enough(run_id, "ada")

    end = threading.Timer(120, enough)  # where it goes on resting

    def answer(what):
        with open_store(path) as store:
            for _ in range(FIRST if what == "the first answers" else 0):
                while (question := store.claim(run_id, "ada")) is None:
                    time.sleep(0.02)
                store.answer(run_id, question.k, level(2, 5), "ada")
            if what == "an answer":
                resting.append(len(store.episodes(run_id)))
                if len(resting) == 1:
                    store.answer(run_id, 1, level(-2, 5), "ada")
                    end.start()
                else:
                    enough()

    summary = teach(path, run_id, wait=answer)
    end.cancel()
    assert summary["comparisons"] == FIRST and len(resting) == 2 and resting[0] < resting[1]


def test_the_last_answer_before_enough_is_learned_from(tmp_path, monkeypatch):
    path, waits = str(tmp_path / "runs.db"), []
    run_id = begun(path)

    def slowly(*args):
        time.sleep(5 * teaching.LOOK)
        return estimate_reward(*args)

    monkeypatch.setattr(teaching, "estimate_reward", slowly)

    def answer(what):
        waits.append(what)
        with open_store(path) as store:
            for _ in range({"": 0, "the first answers": FIRST, "an answer": 1}[what]):
                while (question := store.claim(run_id, "ada")) is None:
                    time.sleep(0.02)
                store.answer(run_id, question.k, level(2, 5), "ada")
            if what == "an answer":
                store.say_enough(run_id, "ada")

    summary = teach(path, run_id, wait=answer)
    assert "an answer" in waits and summary["comparisons"] == FIRST + 1
    with open_store(path) as store:
        facts = [facts["comparisons"] for _, facts in store.episodes(run_id)]
    assert facts[-1] == FIRST + 1  # and practised what it says


def test_after_a_resume_old_answers_are_not_told_as_foreseen(tmp_path):
    path = str(tmp_path / "runs.db")
    run_id = begun(path)
    with open_store(path) as store:
        asking = asking_of(store, run_id)
        for k in range(1, 4):
            asking.ask()
            store.claim(run_id, "ada")
            store.answer(run_id, k, level(2, 5), "ada")
        asking.listen()
        again = Asking(store, asking.row, asking.config, asking.known, key=asking.key)
        again.listen()
        assert asking.known.answers == 3 and again.foresight == [] and asking.verdicts["heard"] == 3
        again.ask()
        store.claim(run_id, "ada")
        store.answer(run_id, 4, level(2, 5), "ada")
        again.listen()
        assert len(again.foresight) == 1
        store.answer(run_id, 1, level(-2, 5), "ada")  # corrected: what was found tells nothing of it until it is heard
        assert again.verdicts["heard"] == 4
        again.listen()
        judged = again.verdicts["agrees"] + again.verdicts["disagrees"]
        assert again.verdicts["heard"] == 5 and sorted(judged) == [1, 2, 3, 4]


def test_next_to_nothing_is_no_news():
    tried = np.array([False, False, True, True])
    at = lambda last: improved(np.array([0.0, -1.0, 10.0, last]), tried)
    assert at(10.5) and not at(10.01) and not at(3.0)
    assert improved(np.array([5.0, 4.0, -3.0]), tried)  # the first policy is news in any case


def test_people_are_shown_what_was_imagined_too(tmp_path):
    path = str(tmp_path / "runs.db")
    config = replace(CONFIG, question=replace(CONFIG.question, imagined=True))
    world = world_from("InvertedPendulum-v5", horizon=20)
    with open_store(path) as store:
        run_id = start(store, world, RunSpec(seed=3, config=config, judge=PEOPLE))
        judge = Judge(path, run_id)
        judge.start()
        summary = taught(store, run_id, world)
        judge.stop.set()
        judge.join()
        rows, facts = store.trajectories(run_id), [facts for _, facts in store.episodes(run_id)]
        imagined = [row.imagined for row in rows]
        searches = sum(one["searched"] for one in facts)
        assert searches >= 2 and imagined == [False] * (len(facts) + 1 - searches) + [True, False] * searches
        films = [store.film(run_id, row.number) for row in rows]
        for row, (film, marked) in zip(rows, films, strict=True):
            poses = Film.from_bytes(film).poses
            assert marked == row.imagined and poses is not None and len(poses) == row.length + 1
        more = replace(config, comparisons=40)  # of six questions none need show it
        run = latest(store, run_id, world, spec_of(store, run_id))
        asking = Asking(store, store.run(run_id), more, Known(run), key=jr.key(0))
        asking.trainer_waits = True
        while len(store.questions(run_id)) < more.comparisons:
            asking.ask()
            store.answer(run_id, store.claim(run_id, "ada").k, level(2, 5), "ada")
        shown = [clip.of for question in store.questions(run_id) for clip in question.clips]
        assert {imagined[of] for of in shown} == {True, False}
        assert summary["comparisons"] == config.comparisons and len(rows) <= config.trajectories
