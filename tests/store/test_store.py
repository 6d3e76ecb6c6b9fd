from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from threading import Barrier

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hiprl.data.trajectory import trajectory_from
from hiprl.errors import InputError, StoreError
from hiprl.store.rows import TrajectoryRow
from hiprl.store.store import Store, open_store
from tests.store.writer import checkpoint, trajectory

FIXTURE_IS_SHARED = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


def with_two_trajectories(store: Store, run_id: str) -> None:
    for number in range(2):
        store.add_trajectory(run_id, number, trajectory(number), "random")


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
        lambda run: store.ask(run, 1, 0, 1),
        lambda run: store.finish_episode(run, 1, {}, b""),
        lambda run: store.finish(run, {}, b""),
    ]
    for act in actions:
        with pytest.raises(InputError, match=rf"no run 'hoper-.*is needed\. Did you mean {run_id}\? `hiprl show`"):
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
@given(data=st.data(), n=st.integers(1, 6), terminated=st.booleans())
def test_a_trajectory_comes_back_bit_for_bit(store: Store, data: st.DataObject, n: int, terminated: bool):
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
    )
    store.add_trajectory(run_id, 13, tau, "policy")
    store.add_trajectory(run_id, 13, tau, "policy")
    (back,) = store.trajectories(run_id)
    assert tau.differs_from(back) is None
    assert back.states.shape == (n + 1, 5)
    assert (back.length, back.terminated, back.number) == (n, terminated, 13)


def test_padding_is_not_stored(store: Store, run_id: str):
    row = trajectory(2)
    padded = trajectory_from(row.states, row.actions, H=17, terminated=row.terminated, rewards=row.rewards)
    assert padded.states.shape == (18, 5)
    store.add_trajectory(run_id, 2, padded, "policy")
    assert store.trajectory(run_id, 2).differs_from(row) is None


def test_two_trainers_that_add_the_same_store_it_once(store: Store):
    start = Barrier(2, timeout=10)

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
    first = store.open_question(run_id, 1, 2, trajectory(2), "policy", 2, 0)
    assert store.open_question(run_id, 1, 2, trajectory(2), "policy", 2, 0) == first
    assert store.ask(run_id, 1, 2, 0) == first
    assert store.ask(run_id, 2, 2, 1) != first
    with pytest.raises(StoreError, match=r"bit for bit.*episode 1: it compares \(2, 0\) and \(0, 2\)"):
        store.ask(run_id, 1, 0, 2)


def test_a_question_comes_with_its_trajectory_or_not_at_all(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, 0, 1)
    with pytest.raises(StoreError, match="bit for bit"):
        store.open_question(run_id, 1, 2, trajectory(2), "policy", 2, 0)
    assert [row.number for row in store.trajectories(run_id)] == [0, 1]


def test_a_question_about_a_trajectory_that_is_not_there_is_refused(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    with pytest.raises(StoreError, match=r"the store .* refused what was asked .* is needed\. If it is one"):
        store.ask(run_id, 1, 0, 5)
    assert store.questions(run_id) == []


def test_the_newest_answer_counts_and_the_others_stay(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, 0, 1)
    store.ask(run_id, 2, 1, 0)
    assert store.answer_of(run_id, 1) is None
    assert [row.k for row in store.questions(run_id, unanswered=True)] == [1, 2]
    for g in (0.1, -1e300, float(jnp.float32(1) / 3)):
        store.answer(run_id, 1, g, "Ada", swapped=g < 0)
    assert store.answer_of(run_id, 1) == float(np.float32(1) / np.float32(3))
    assert [(row.k, row.g, row.judge, row.swapped) for row in store.answers(run_id)][:2] == [
        (1, 0.1, "Ada", False),
        (1, -1e300, "Ada", True),
    ]
    assert [row.g for row in store.questions(run_id)] == [store.answer_of(run_id, 1), None]
    assert [row.k for row in store.questions(unanswered=True)] == [2]


def test_questions_of_all_runs_are_seen_together(store: Store):
    ids = [store.add_run("Ant-v5", seed, {}, {}) for seed in range(3)]
    for run_id in ids:
        with_two_trajectories(store, run_id)
        store.ask(run_id, 1, 0, 1)
    store.answer(ids[1], 1, 0, "Ada")
    assert [row.run_id for row in store.questions(unanswered=True)] == [ids[0], ids[2]]
    assert len(store.questions()) == 3


@FIXTURE_IS_SHARED
@given(g=st.floats(allow_nan=False, allow_infinity=False))
def test_an_answer_comes_back_bit_for_bit_but_minus_zero_as_zero(store: Store, g: float):
    run_id = store.add_run("Ant-v5", 3, {}, {})
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, 0, 1)
    store.answer(run_id, 1, g, "Ada")
    back = store.answer_of(run_id, 1)
    assert back is not None
    assert back == g
    assert math.copysign(1, back) == (math.copysign(1, g) if g else 1)


@pytest.mark.parametrize("g", [math.nan, math.inf, -math.inf])
def test_an_answer_that_is_not_finite_is_refused(store: Store, run_id: str, g: float):
    with pytest.raises(InputError, match=r"got the answer .*; a finite number is needed\. Answer 0"):
        store.answer(run_id, 1, g, "Ada")


def test_an_answer_to_nothing_is_refused(store: Store, run_id: str):
    for run in (run_id, "nobody-0000"):
        with pytest.raises(InputError, match=rf"run {run} asks nothing in episode 3; .* question\. Wait"):
            store.answer(run, 3, 1.0, "Ada")


def test_answers_from_many_threads_are_all_kept(store: Store, run_id: str):
    with_two_trajectories(store, run_id)
    store.ask(run_id, 1, 0, 1)
    with ThreadPoolExecutor(5) as pool:
        list(pool.map(lambda g: store.answer(run_id, 1, float(g), "crowd"), range(23)))
    assert sorted(row.g for row in store.answers(run_id)) == list(range(23))


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


def test_a_finished_run_keeps_its_summary_and_policy(store: Store, run_id: str):
    assert store.final(run_id) is None
    assert store.policy(run_id) is None
    store.finish(run_id, {"return_mean": 4321.5}, b"\x00policy\xff")
    store.finish(run_id, {"return_mean": 4321.5, "wall_seconds": 9}, b"\x00policy\xff")
    assert store.final(run_id) == {"return_mean": 4321.5}
    assert store.policy(run_id) == b"\x00policy\xff"
    with pytest.raises(StoreError, match=r"bit for bit .*\(the policy at its end\)"):
        store.finish(run_id, {}, b"another")
