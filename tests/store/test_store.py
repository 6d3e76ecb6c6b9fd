from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Barrier

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, Answer, choice, level, ranking, rating, slider
from hiprl.data.answer import number as a_number
from hiprl.data.trajectory import trajectory_from
from hiprl.errors import InputError, StoreError
from hiprl.store.rows import ClipRow, TrajectoryRow
from hiprl.store.store import Store, open_store
from tests.store.writer import checkpoint, trajectory

FIXTURE_IS_SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def with_two_trajectories(store: Store, run_id: str) -> None:
    for number in range(2):
        store.add_trajectory(run_id, number, trajectory(number), "random")


def pair(first: int, second: int) -> list[ClipRow]:
    """Two whole trajectories."""
    return [ClipRow(first), ClipRow(second)]


def answers_about(n: int) -> st.SearchStrategy[Answer]:
    """Every answer that fits a question about so many clips."""
    levels = st.integers(2, 7).flatmap(lambda levels: st.tuples(st.integers(0, levels - 1), st.just(levels)))
    centred = levels.map(lambda drawn: (drawn[0] - (drawn[1] - 1) / 2, drawn[1]))
    if n == 1:
        return centred.map(lambda drawn: rating(*drawn)) | st.just(CANNOT_TELL)
    order = st.permutations(range(n)).map(lambda drawn: ranking(tuple(drawn))) | st.just(CANNOT_TELL)
    if n > 2:
        return order
    return (
        order
        | st.floats(allow_nan=False, allow_infinity=False).map(a_number)
        | st.integers(-(2**60), 2**60).map(a_number)
        | st.booleans().map(choice)
        | st.floats(-1, 1).map(slider)
        | centred.map(lambda drawn: level(*drawn))
        | st.just(EQUALLY_GOOD)
    )


def nudged(row: TrajectoryRow, t: int) -> TrajectoryRow:
    """The same but for the last bit of one action."""
    actions = row.actions.copy()
    actions[t, 0] = np.nextafter(actions[t, 0], np.float32(2))
    rest = {"states": row.states, "rewards": row.rewards, "length": row.length, "terminated": row.terminated}
    return TrajectoryRow(number=row.number, kind=row.kind, actions=actions, **rest)


def test_importing_the_store_loads_neither_jax_nor_alembic():
    code = "import sys, hiprl.store.store; print({'jax', 'alembic', 'psycopg'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


# Runs


def test_a_run_comes_back_as_it_was_added(store: Store):
    spec = {"preset": "päper", "judge": None, "beta": 0.1, "layers": [128, 131], "deep": {"π": math.inf}}
    run_id = store.add_run("HalfCheetah-v5", 2**40, spec, {"jax": "0.10.2"})
    row = store.run(run_id)
    assert run_id.startswith("halfcheetah-")
    assert (row.env, row.seed, row.spec, row.versions) == ("HalfCheetah-v5", 2**40, spec, {"jax": "0.10.2"})
    assert abs(datetime.now(UTC) - row.created_at) < timedelta(minutes=1)
    assert store.runs() == [row]


def test_a_store_opened_again_holds_the_same(where: str):
    with open_store(where) as store:
        run_id = store.add_run("Hopper-v5", 3, {}, {})
        before = store.runs()
    with open_store(where, create=False) as store:
        assert store.runs() == before
        assert store.run(run_id).seed == 3


@pytest.mark.parametrize("env", ["ALE/Pong-v5", "mine:Über_Task", "-v3"])
def test_an_id_is_short_and_readable_whatever_the_environment(store: Store, env: str):
    run_id = store.add_run(env, 0, {}, {})
    assert run_id == run_id.lower()
    assert set(run_id) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")


def test_ids_differ_even_when_the_draw_repeats(store: Store, monkeypatch: pytest.MonkeyPatch):
    draws = iter(["aaaa", "aaaa", "bbbb"])
    monkeypatch.setattr("hiprl.store.store.secrets.token_hex", lambda _: next(draws))
    assert [store.add_run("Ant-v5", 1, {}, {}) for _ in range(2)] == ["ant-aaaa", "ant-bbbb"]


def test_an_unknown_run_is_refused_with_near_ids(store: Store, run_id: str):
    actions: list[Callable[[str], object]] = [
        store.run,
        store.find_run,
        store.lease,
        lambda run: store.add_trajectory(run, 0, trajectory(0), "random"),
        lambda run: store.ask(run, 1, pair(0, 1)),
        lambda run: store.finish_episode(run, 1, {}, b""),
        lambda run: store.finish(run, {}, b""),
    ]
    for act in actions:
        with pytest.raises(InputError, match=rf"no run 'hoper-.*is needed\. Did you mean {run_id}\? `hiprl show --s"):
            act(run_id.replace("pp", "p"))


def test_a_run_is_found_by_the_beginning_of_its_id(store: Store, run_id: str):
    other = store.add_run("Ant-v5", 1, {}, {})
    assert store.find_run(run_id[:3]).id == run_id
    assert store.find_run(run_id[:5].upper()).id == run_id
    assert store.find_run(other).id == other
    store.add_run("Ant-v5", 1, {}, {})
    with pytest.raises(InputError, match=r"2 runs begin with 'ant' \(.*\); one is needed\. Write more"):
        store.find_run("ant")
    for wild in ("%", "_", ""):
        with pytest.raises(InputError, match="there is no run"):
            store.find_run(wild)


def test_a_seed_past_64_bits_is_refused(store: Store):
    with pytest.raises(InputError, match=r"got the seed \d+; it must fit into 64 bits\. Take one such as"):
        store.add_run("Ant-v5", 2**64, {}, {})


# Trajectories


@FIXTURE_IS_SHARED
@given(data=st.data(), n=st.integers(1, 6), terminated=st.booleans(), imagined=st.booleans())
def test_a_trajectory_comes_back_bit_for_bit(
    store: Store, data: st.DataObject, n: int, terminated: bool, imagined: bool
):
    run_id = store.add_run("Reacher-v5", 1, {}, {})
    rows = [data.draw(npst.arrays(np.float32, shape)) for shape in ((n + 1, 5), (n, 3), (n,))]
    tau = TrajectoryRow(
        number=13,
        kind="policy",
        states=rows[0],
        actions=rows[1],
        rewards=rows[2],
        length=n,
        terminated=terminated,
        imagined=imagined,
    )
    store.add_trajectory(run_id, 13, tau, "policy")
    store.add_trajectory(run_id, 13, tau, "policy")
    (back,) = store.trajectories(run_id)
    assert tau.differs_from(back) is None
    assert back.states.shape == (n + 1, 5)
    assert (back.length, back.terminated, back.number, back.imagined) == (n, terminated, 13, imagined)
    assert store.film(run_id, 13) == (None, imagined)
    assert store.newest(run_id, "policy") == (None if imagined else 13) and store.executed_before(run_id, 13) == 0
    store.add_trajectory(run_id, 14, replace(tau, number=14, imagined=False), "policy")
    assert store.newest(run_id, "policy") == 14 and store.newest(run_id, "random") is None
    assert store.executed_before(run_id, 14) == (0 if imagined else 1)  # what was imagined does not count
    with pytest.raises(StoreError, match=f"its imagined is {imagined}"):
        store.add_trajectory(run_id, 13, replace(tau, imagined=not imagined), "policy")


def test_padding_is_not_stored(store: Store, run_id: str):
    row = trajectory(2)
    padded = trajectory_from(row.states, row.actions, H=17, terminated=row.terminated, rewards=row.rewards)
    assert padded.states.shape == (18, 5)
    store.add_trajectory(run_id, 2, padded, "policy")
    assert store.trajectory(run_id, 2).differs_from(row) is None


def test_two_trainers_that_add_the_same_store_it_once(store: Store):
    start = Barrier(2, timeout=60)

    def train(run_id: str) -> None:
        for number in range(5):
            start.wait()
            store.add_trajectory(run_id, number, trajectory(number), "policy")
        store.finish_episode(run_id, 1, {}, checkpoint(1))

    with ThreadPoolExecutor(2) as pool:
        run_id = store.add_run("Ant-v5", 3, {}, {})
        list(pool.map(train, [run_id] * 2))
    assert [row.number for row in store.trajectories(run_id)] == list(range(5))
    assert [k for k, _ in store.episodes(run_id)] == [1]


def test_trajectories_come_in_the_order_of_their_numbers(store: Store, run_id: str):
    for number in (3, 0, 11):
        store.add_trajectory(run_id, number, trajectory(number), "policy")
    assert [row.number for row in store.trajectories(run_id)] == [0, 3, 11]
    with pytest.raises(InputError, match=r"has no trajectory 5; .* is needed\. Count from 0"):
        store.trajectory(run_id, 5)


def test_a_trajectory_that_differs_in_one_bit_stops_the_run(store: Store, run_id: str):
    store.add_trajectory(run_id, 2, trajectory(2), "policy")
    with pytest.raises(StoreError, match=r"cannot be continued bit for bit .*actions differ from step 3 on.*Resume"):
        store.add_trajectory(run_id, 2, nudged(trajectory(2), 3), "policy")
    for other in (trajectory(2, length=5), trajectory(4)):
        with pytest.raises(StoreError, match=r"cannot be continued bit for bit"):
            store.add_trajectory(run_id, 2, other, "policy")
    with pytest.raises(StoreError, match=r"its kind is policy and random"):
        store.add_trajectory(run_id, 2, trajectory(2), "random")
    assert store.trajectory(run_id, 2).differs_from(trajectory(2)) is None


# Questions and answers


def test_asking_again_gives_the_same_question(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    first = store.open_question(run_id, 1, [trajectory(2)], pair(2, 0))
    assert store.open_question(run_id, 1, [trajectory(2)], pair(2, 0)) == first
    assert store.ask(run_id, 1, pair(2, 0)) == first
    assert store.ask(run_id, 2, pair(2, 1)) != first
    with pytest.raises(StoreError, match=r"bit for bit.*episode 1: it is about \(2, 0\) and \(0, 2\)"):
        store.ask(run_id, 1, pair(0, 2))


@pytest.mark.parametrize(
    ("other", "words"),
    [
        ([ClipRow(1, 2, 3), ClipRow(0, 4)], r"\(1\[2:5\], 0\[3:\]\) and \(1\[2:5\], 0\[4:\]\)"),
        ([ClipRow(1, 2), ClipRow(0, 3)], r"\(1\[2:5\], 0\[3:\]\) and \(1\[2:\], 0\[3:\]\)"),
        ([ClipRow(1, 2, 3)], r"\(1\[2:5\], 0\[3:\]\) and \(1\[2:5\]\)"),
    ],
)
def test_asking_about_other_steps_under_the_same_k_stops_the_run(store: Store, run_id: str, other, words: str):
    with_two_trajectories(store, run_id)
    asked = store.ask(run_id, 1, [ClipRow(1, 2, 3), ClipRow(0, 3)])
    assert store.ask(run_id, 1, [ClipRow(1, 2, 3), ClipRow(0, 3)]) == asked
    with pytest.raises(StoreError, match=rf"bit for bit.*episode 1: it is about {words}"):
        store.ask(run_id, 1, other)
    assert [row.clips for row in store.questions(run_id)] == [(ClipRow(1, 2, 3), ClipRow(0, 3))]


@FIXTURE_IS_SHARED
@given(data=st.data(), n=st.integers(1, 8))
def test_a_question_comes_back_with_its_clips_and_every_answer(store: Store, data: st.DataObject, n: int):
    run_id = store.add_run("Ant-v5", 3, {}, {})
    with_two_trajectories(store, run_id)
    length = trajectory(0).length
    some = st.builds(ClipRow, st.integers(0, 1), st.integers(0, length - 1), st.none() | st.integers(1, 99))
    clips = tuple(data.draw(st.lists(some, min_size=n, max_size=n)))
    given_answers = data.draw(st.lists(answers_about(n), max_size=3))
    question_id = store.ask(run_id, 5, clips)
    new = [store.answer(run_id, 5, answer, "Ada") for answer in given_answers]
    given_answers = [answer for answer, is_new in zip(given_answers, new, strict=True) if is_new]  # twice is once
    (row,) = store.questions(run_id)
    assert (row.id, row.run_id, row.k, row.clips) == (question_id, run_id, 5, clips)
    assert (row.first, row.second) == (clips[0].of, clips[1 if n > 1 else 0].of)
    assert [row.answer for row in store.answers(run_id)] == given_answers
    assert row.answer == store.answer_of(run_id, 5) == (given_answers[-1] if given_answers else None)
    for row, answer in zip(store.answers(run_id), given_answers, strict=True):
        assert row.g == (answer.value if answer.form == "number" else None)


def test_numbers_of_numpy_and_jax_make_the_same_clip(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    asked = store.ask(run_id, 1, [ClipRow(1, 3, 2), ClipRow(0)])
    odd = ClipRow(1)
    for name, value in {"of": np.int64(1), "start": np.int32(3), "length": jnp.array(2)}.items():
        object.__setattr__(odd, name, value)  # past the type check of the tests, which users do not have
    assert store.ask(run_id, 1, [odd, ClipRow(0)]) == asked
    assert store.ask(run_id, 2, [odd]) != asked
    assert store.questions(run_id)[1].clips == (ClipRow(1, 3, 2),)


@pytest.mark.parametrize(
    ("clips", "message"),
    [
        ([], r"got 0 clips .*; a question is about 1 to 8\. Name one or two"),
        ([ClipRow(0)] * 9, r"got 9 clips .*; a question is about 1 to 8\. .* spread many"),
        (
            [ClipRow(0), ClipRow(5)],
            r"got a clip of trajectory 5, .*; only what is stored can be asked about\. Count from 0",
        ),
        ([ClipRow(-1)], r"got a clip of trajectory -1, .* asked about\. Count from 0"),
        ([ClipRow(1, 7)], r"starts at step 7 of trajectory 1, which has 7; a step from 0 to 6 is needed\. Start it"),
        ([ClipRow(1), ClipRow(0, -1)], r"starts at step -1 of trajectory 0, which has 7; .* is needed\. Start it"),
        ([ClipRow(1, 2, 0)], r"got a clip of 0 steps of trajectory 1; at least 1 is needed\. Take more, or None"),
        ([ClipRow(1, 2, -3)], r"got a clip of -3 steps .* is needed\. Take more, or None"),
    ],
)
def test_clips_that_cannot_be_shown_are_refused_and_nothing_is_kept(store: Store, run_id: str, clips, message: str):
    with_two_trajectories(store, run_id)
    another = store.add_run("Ant-v5", 3, {}, {})
    store.add_trajectory(another, 5, trajectory(5), "policy")  # of another run: it does not count
    with pytest.raises(InputError, match=message):
        store.ask(run_id, 1, clips)
    with pytest.raises(InputError, match=message):
        store.open_question(run_id, 1, [trajectory(2)], clips)
    assert store.questions(run_id) == []
    assert [row.number for row in store.trajectories(run_id)] == [0, 1]
    store.ask(run_id, 1, pair(0, 1))
    with pytest.raises(InputError, match=message):
        store.ask(run_id, 1, clips)


def test_an_episode_comes_with_its_trajectory_or_not_at_all(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.finish_episode(run_id, 1, {}, b"1", taus=[(trajectory(2), b"film")])
    assert store.trajectory(run_id, 2).differs_from(trajectory(2)) is None and store.film(run_id, 2) == (b"film", False)
    with pytest.raises(StoreError, match="bit for bit"):
        store.finish_episode(run_id, 1, {}, b"another", taus=[(trajectory(3), None)])
    assert [row.number for row in store.trajectories(run_id)] == [0, 1, 2]


def test_a_question_comes_with_its_trajectory_or_not_at_all(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, pair(0, 1))
    with pytest.raises(StoreError, match="bit for bit"):
        store.open_question(run_id, 1, [trajectory(2)], pair(2, 0))
    assert [row.number for row in store.trajectories(run_id)] == [0, 1]


def test_the_newest_answer_counts_and_the_others_stay(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, pair(0, 1))
    store.ask(run_id, 2, pair(1, 0))
    assert store.answer_of(run_id, 1) is None
    assert [row.k for row in store.questions(run_id, unanswered=True)] == [1, 2]
    for g in (0.1, -1e300, float(jnp.float32(1) / 3)):
        store.answer(run_id, 1, a_number(g), "Ada", swapped=g < 0)
    assert store.answer_of(run_id, 1) == a_number(float(np.float32(1) / np.float32(3)))
    assert [(row.k, row.g, row.judge, row.swapped) for row in store.answers(run_id)][:2] == [
        (1, 0.1, "Ada", False),
        (1, -1e300, "Ada", True),
    ]
    assert [row.answer for row in store.questions(run_id)] == [store.answer_of(run_id, 1), None]
    assert [row.g for row in store.questions(run_id)] == [float(np.float32(1) / np.float32(3)), None]
    assert [row.k for row in store.questions(unanswered=True)] == [2]
    store.answer(run_id, 1, CANNOT_TELL, "Ada")  # takes the number back
    assert [(row.answer, row.g) for row in store.questions(run_id)] == [(CANNOT_TELL, None), (None, None)]
    assert [row.k for row in store.questions(unanswered=True)] == [2]


def test_questions_of_all_runs_are_seen_together(store: Store):
    ids = [store.add_run("Ant-v5", seed, {}, {}) for seed in range(3)]
    for run_id in ids:
        with_two_trajectories(store, run_id)
        store.ask(run_id, 1, pair(0, 1))
    store.answer(ids[1], 1, EQUALLY_GOOD, "Ada")
    assert [row.run_id for row in store.questions(unanswered=True)] == [ids[0], ids[2]]
    assert len(store.questions()) == 3


@FIXTURE_IS_SHARED
@given(g=st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_comes_back_bit_for_bit_but_minus_zero_as_zero(store: Store, g: float):
    run_id = store.add_run("Ant-v5", 3, {}, {})
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, pair(0, 1))
    store.answer(run_id, 1, a_number(g), "Ada")
    with store._database.reading() as connection:
        of_run = "JOIN questions ON questions.id = question_id WHERE run_id"
        column = connection.exec_driver_sql(f"SELECT g FROM answers {of_run} = '{run_id}'").scalar_one()
    answer = store.answer_of(run_id, 1)
    assert answer is not None
    for back in (answer.value, store.questions(run_id)[0].g, store.answers(run_id)[0].g, column):
        assert isinstance(back, float)
        assert back == g
        assert math.copysign(1, back) == (math.copysign(1, g) if g else 1)


@pytest.mark.parametrize("clips", [1, 2, 3, 8])
def test_an_answer_about_more_or_fewer_clips_than_were_asked_about_is_refused(store: Store, run_id: str, clips: int):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 4, [ClipRow(i % 2, i % 5) for i in range(clips)])
    about = {
        1: [rating(0.5, 2)],
        2: [a_number(0.3), choice(True), level(-1, 3), slider(0.7), EQUALLY_GOOD, ranking((1, 0))],
        3: [ranking((1, 2, 0))],
    }
    for n, given_answers in about.items():
        for answer in given_answers if n != clips else []:
            form = rf"got an answer of the form '{answer.form}', which is about {n} clips?, .* asks in episode 4"
            with pytest.raises(InputError, match=form + rf" about {clips} clips?; .* as many\. Give .*cannot tell"):
                store.answer(run_id, 4, answer, "Ada")
    assert store.answers(run_id) == []
    for answer in [*about.get(clips, []), CANNOT_TELL]:
        store.answer(run_id, 4, answer, "Ada")
        assert store.answer_of(run_id, 4) == answer


def test_an_answer_to_nothing_is_refused(store: Store, run_id: str):
    for run in (run_id, "nobody-0000"):
        with pytest.raises(InputError, match=rf"run {run} asks nothing in episode 3; .* question\. Wait"):
            store.answer(run, 3, a_number(1.0), "Ada")


def test_what_nobody_looks_at_is_counted(store: Store, run_id: str):
    other = store.add_run("Hopper-v5", 8, {}, {})
    for one in (run_id, other):
        with_two_trajectories(store, one)
        for k in (1, 2, 3):
            store.ask(one, k, pair(0, 1))
    assert store.unseen(run_id) == 3
    store.claim(run_id, "ada")
    assert (store.unseen(run_id), store.unseen(other)) == (2, 3)
    store.claim(run_id, "bo", seconds=-1.0)  # who has gone away
    assert store.unseen(run_id) == 2
    store.answer(run_id, 3, choice(True), "cy")
    assert store.unseen(run_id) == 1


def test_answers_from_many_threads_are_all_kept(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, pair(0, 1))
    with ThreadPoolExecutor(5) as pool:
        list(pool.map(lambda g: store.answer(run_id, 1, a_number(g), "crowd"), range(23)))
    assert sorted(row.g for row in store.answers(run_id)) == list(range(23))


def test_what_many_say_at_once_for_one_is_said_once(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    for k in range(1, 8):
        store.ask(run_id, k, pair(0, 1))
        start = Barrier(4, timeout=60)

        def say(_: int, k: int = k, start: Barrier = start) -> bool:
            start.wait()
            return store.answer(run_id, k, choice(True), "ann")

        with ThreadPoolExecutor(4) as pool:
            assert sum(pool.map(say, range(4))) == 1
        assert len(store.answers(run_id)) == k


def test_the_papers_network_is_told_numbers_alone(store: Store):
    run_id = store.add_run("Hopper-v5", 3, {"config": {"reward": {"part": "NetworkConfig"}}}, {})
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, pair(0, 1))
    with pytest.raises(InputError, match="numbers alone"):
        store.answer(run_id, 1, choice(True), "ann")
    assert store.answer(run_id, 1, a_number(0.5), "ann")


# Episodes and the end


def test_episodes_come_back_and_the_newest_two_checkpoints_stay(store: Store, run_id: str):
    assert store.checkpoint(run_id) is None
    facts = {"return": np.float32(0.5), "sigma": [1.5, -math.inf], "who": None, "steps": jnp.array(7)}
    for k in range(1, 6):
        store.finish_episode(run_id, k, facts, checkpoint(k))
        store.finish_episode(run_id, k, {"done": "again"}, checkpoint(k))
    plain = {"return": 0.5, "sigma": [1.5, -math.inf], "who": None, "steps": 7}
    assert store.episodes(run_id) == [(k, plain) for k in range(1, 6)]
    assert store.checkpoint(run_id) == (5, checkpoint(5))
    with store._database.reading() as connection:
        assert connection.exec_driver_sql("SELECT k FROM checkpoints ORDER BY k").scalars().all() == [4, 5]


def test_another_state_after_an_episode_stops_the_run(store: Store, run_id: str):
    store.finish_episode(run_id, 1, {}, checkpoint(1))
    with pytest.raises(StoreError, match=r"bit for bit .*\(the state after episode 1\); .* Resume it there"):
        store.finish_episode(run_id, 1, {}, checkpoint(2))


def test_an_episode_that_cannot_be_written_leaves_nothing(where: str):
    with open_store(where) as store:
        run_id = store.add_run("Ant-v5", 3, {}, {})
        store.finish_episode(run_id, 1, {}, checkpoint(1))
        with store._database.writing() as connection:
            connection.exec_driver_sql("DROP TABLE checkpoints")
        with pytest.raises(StoreError, match="refused what was asked"):
            store.finish_episode(run_id, 2, {}, checkpoint(2))
        assert [k for k, _ in store.episodes(run_id)] == [1]


def test_enough_is_said_once_and_of_one_run(store: Store, run_id: str):
    other = store.add_run("Ant-v5", 0, {}, {})
    assert not store.enough(run_id)
    for judge in ("ada", "bo"):
        store.say_enough(run_id, judge)
    assert store.enough(run_id) and not store.enough(other)
    with pytest.raises(InputError, match="there is no run"):
        store.say_enough("hopper-0000", "ada")


def test_a_finished_run_keeps_its_summary_and_policy(store: Store, run_id: str):
    assert store.final(run_id) is None
    assert store.policy(run_id) is None
    store.finish(run_id, {"return_mean": 4321.5}, b"\x00policy\xff")
    store.finish(run_id, {"return_mean": 4321.5, "wall_seconds": 9}, b"\x00policy\xff")
    assert store.final(run_id) == {"return_mean": 4321.5}
    assert store.policy(run_id) == b"\x00policy\xff"
    with pytest.raises(StoreError, match=r"bit for bit .*\(the policy at its end\)"):
        store.finish(run_id, {}, b"another")


# Its pages


def test_the_secret_of_its_pages_is_made_once_and_stays(made: str, store: Store):
    start = Barrier(4, timeout=60)

    def first() -> str:
        start.wait()
        return store.secret()

    with ThreadPoolExecutor(4) as pool:
        (secret,) = {future.result() for future in [pool.submit(first) for _ in range(4)]}
    with open_store(made) as again:
        assert again.secret() == secret and len(secret) >= 32


def test_another_store_has_another_secret(tmp_path: Path):
    with open_store(tmp_path / "one.db") as one, open_store(tmp_path / "other.db") as other:
        assert one.secret() != other.secret()
