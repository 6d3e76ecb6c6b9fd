import json
import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.config import asking, paper
from hiprl.control.imagined import SearchReport
from hiprl.data.answer import choice
from hiprl.errors import FitDiverged, InputError, JudgeError, WorldError
from hiprl.feedback.judges import exact, judge_from
from hiprl.feedback.judging import Judging
from hiprl.report.evidence import evidence_of
from hiprl.session import RunSpec, carry_on, finite_or_none, learned_actor, spec_of, start
from hiprl.store.rows import CUSTOM
from hiprl.store.store import open_store
from hiprl.world.build import world_from
from tests.whole.tasks import DREAMING, TINY, Blind

SPEC = RunSpec(seed=21, config=TINY, judge="exact", eval_episodes=3)


@pytest.fixture
def store(tmp_path):
    with open_store(tmp_path / "runs.db") as opened:
        yield opened


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A finished run: its store, its id, what was watched and its summary."""
    with open_store(tmp_path_factory.mktemp("finished") / "runs.db") as store:
        world, watched = world_from("linear"), []
        run_id = start(store, world, SPEC)
        summary = carry_on(store, run_id, world, exact, watch=watched.append)
        yield store, run_id, watched, summary


def test_a_run_can_be_done_again_from_its_row(finished):
    store, run_id, *_ = finished
    assert spec_of(store, run_id) == SPEC
    row = store.run(run_id)
    assert row.env == "linear" and row.seed == 21 and row.versions["jax"]
    assert world_from(row.spec["env"], horizon=row.spec["horizon"]).H == 31


def test_the_summary_has_what_the_command_line_promises(finished):
    _, run_id, _, summary = finished
    assert set(summary) == {
        "run",
        "env",
        "seed",
        "comparisons",
        "env_steps",
        "return_mean",
        "return_std",
        "eval_episodes",
        "trajectory",
        "wall_seconds",
        "store",
    }
    assert summary["run"] == run_id and summary["comparisons"] == TINY.comparisons and summary["eval_episodes"] == 3
    assert summary["env_steps"] == 31 * (TINY.comparisons + 1 + TINY.confirmations)


def test_the_summary_names_what_the_reported_policy_did_first(finished):
    store, run_id, _, summary = finished
    assert store.trajectory(run_id, summary["trajectory"]).kind == "policy"
    assert store.final(run_id)["trajectory"] == summary["trajectory"]


def test_each_episode_is_told_of_in_plain_numbers(finished):
    store, run_id, watched, _ = finished
    assert [facts["k"] for facts in watched] == list(range(1, TINY.comparisons + 1))
    assert json.loads(json.dumps(watched)) == watched == [facts for _, facts in store.episodes(run_id)]
    for facts in watched:
        assert facts["searched"] == (facts["k"] >= TINY.warm_up)
        assert facts["env_steps"] == 31 * (facts["k"] + 1) and facts["length"] == 31
        assert set(facts["seconds"]) == {"propose", "judge", "learn", "practise"}
    last = watched[-1]
    assert 0 <= last["coverage"] <= 1 and last["beta"] > 0 and last["deviation"] > 0
    assert last["rollout_errors"]["50"] is None  # episodes have 31 steps
    assert last["rollout_errors"]["1"] == pytest.approx(last["deviation"], rel=1e-3)


def test_the_store_has_every_trajectory_question_and_answer(finished):
    store, run_id, watched, _ = finished
    rows = store.trajectories(run_id)
    assert [row.kind for row in rows] == ["random"] * TINY.warm_up + ["policy"] * (TINY.comparisons + 1 - TINY.warm_up)
    returns = [row.rewards.sum() for row in rows]
    for question, facts in zip(store.questions(run_id), watched, strict=True):
        assert question.first == question.k == facts["k"] and question.second < question.first
        assert question.g == facts["g"] == pytest.approx(returns[question.first] - returns[question.second], abs=1e-3)
    assert {answer.judge for answer in store.answers(run_id)} == {"rule"}


def test_the_policy_comes_back_from_the_store(finished):
    store, run_id, *_ = finished
    world = world_from("linear")
    one, other = learned_actor(store, run_id, world), learned_actor(store, run_id, world)
    s = jnp.array([0.3, -0.2, 0.1])
    np.testing.assert_array_equal(one.policy.mode(s), other.policy.mode(s))


@pytest.mark.parametrize("answers", [0, 1])
def test_before_its_first_search_a_run_has_no_policy(store, answers):
    world, asked = world_from("linear"), []

    def so_often(clips, hand, *, steps, key):
        asked.append(1)
        return None if len(asked) > answers else exact.answer(clips, hand, key=key)

    run_id = start(store, world, SPEC)
    with pytest.raises(JudgeError):
        carry_on(store, run_id, world, Judging(answer=so_often))
    assert len(store.episodes(run_id)) == answers < TINY.warm_up
    with pytest.raises(InputError) as caught:
        learned_actor(store, run_id, world)
    message = str(caught.value)
    assert "has not searched for a policy yet" in message and f"hiprl resume {run_id}" in message


def test_a_run_that_is_not_finished_has_the_best_policy_so_far(store):
    world, asked = world_from("linear"), []

    def four_times(clips, hand, *, steps, key):
        asked.append(1)
        return None if len(asked) > 4 else exact.answer(clips, hand, key=key)

    run_id = start(store, world, SPEC)
    with pytest.raises(JudgeError):
        carry_on(store, run_id, world, Judging(answer=four_times))
    a = learned_actor(store, run_id, world).policy.mode(jnp.array([0.3, -0.2, 0.1]))
    assert a.shape == (2,) and np.isfinite(a).all()


def test_where_nothing_is_paid_nothing_is_reported_as_paid(store):
    world = Blind(world_from("linear"))
    run_id = start(store, world, SPEC)
    watched = []
    judge = judge_from(lambda tau, other: float(tau.states[-1, 0] - other.states[-1, 0]))
    summary = carry_on(store, run_id, world, judge, watch=watched.append)
    assert summary["return_mean"] is None and summary["return_std"] is None
    assert all(facts["true_return"] is None for facts in watched)
    json.dumps(watched, allow_nan=False)


def test_where_nothing_is_paid_the_exact_judge_leaves_the_question_open(store):
    world = Blind(world_from("linear"))
    run_id = start(store, world, SPEC)
    with pytest.raises(JudgeError, match="judge of your own"):
        carry_on(store, run_id, world, exact)
    assert len(store.questions(run_id, unanswered=True)) == 1


def test_imagined_trajectories_are_stored_as_such_and_asked_about(store):
    """A judge of one's own sees which clips were imagined; one by the built-in rewards is told what they would earn."""
    world, seen = world_from("linear"), []

    def mine(tau, other):
        seen.append((bool(tau.imagined), bool(other.imagined)))
        return float(np.sum(tau.rewards) - np.sum(other.rewards))

    run_id = start(store, world, RunSpec(seed=6, config=DREAMING, judge=CUSTOM))
    summary = carry_on(store, run_id, world, judge_from(mine))
    rows, questions = store.trajectories(run_id), store.questions(run_id)
    imagined = [row.imagined for row in rows]
    assert imagined == [False] * TINY.warm_up + [True, False] * (DREAMING.comparisons + 1 - TINY.warm_up)
    assert {row.kind for row in rows if row.imagined} == {"policy"}
    assert seen == [tuple(imagined[clip.of] for clip in question.clips) for question in questions]
    assert any(second for _, second in seen)
    assert summary["env_steps"] == 31 * (DREAMING.comparisons + 1 + TINY.confirmations)  # nothing else was executed
    T, P = evidence_of(store, store.run(run_id))
    np.testing.assert_array_equal(T.rows.imagined, imagined)
    paid = np.asarray(T.rows.rewards).sum(1)
    np.testing.assert_allclose(P.g, paid[np.asarray(P.first)] - paid[np.asarray(P.second)], rtol=1e-3, atol=1e-3)


def test_an_environment_cannot_price_what_was_only_imagined(store):
    world = Blind(world_from("linear"))
    refused = pytest.raises(InputError, match=r"reward for imagined clips in linear.*from Python, or by `hiprl teach`")
    with refused:
        start(store, world, RunSpec(seed=3, config=DREAMING, judge="exact"))
    assert not store.runs()
    run_id = start(store, world, RunSpec(seed=3, config=DREAMING, judge=CUSTOM))
    with refused:  # resumed with another judge
        carry_on(store, run_id, world, exact)
    assert not store.trajectories(run_id)


def test_a_world_that_breaks_loses_nothing_that_was_learned(store):
    class Breaking(Blind):
        def roll_out(self, actor, *, key):
            self.count = getattr(self, "count", 0) + 1
            if self.count == 5:
                raise WorldError("it broke; it must not. Mend it.")
            return self.world.roll_out(actor, key=key)

    run_id = start(store, world_from("linear"), SPEC)
    with pytest.raises(WorldError):
        carry_on(store, run_id, Breaking(world_from("linear")), exact)
    assert len(store.episodes(run_id)) == 3 and store.questions(run_id, unanswered=True) == []
    summary = carry_on(store, run_id, world_from("linear"), exact)
    assert summary["comparisons"] == TINY.comparisons


def test_a_search_that_diverges_is_said_to(store, monkeypatch):
    diverged = lambda f_tilde, reward, ends, T, state, config, **_: (state, SearchReport.nothing())
    monkeypatch.setattr("hiprl.algorithm.search", diverged)
    world = world_from("linear")
    run_id = start(store, world, SPEC)
    with pytest.raises(FitDiverged) as caught:
        carry_on(store, run_id, world, exact)
    message = str(caught.value)
    assert f"episode {TINY.warm_up}" in message and "must be finite" in message and "another seed" in message
    assert len(store.episodes(run_id)) == TINY.warm_up - 1


def test_no_evaluation_is_refused_in_three_parts():
    with pytest.raises(InputError) as caught:
        RunSpec(seed=0, config=TINY, judge="exact", eval_episodes=0)
    message = str(caught.value)
    assert "got 0 episodes" in message and "at least 1" in message and "--eval-episodes" in message


def test_what_json_has_no_word_for_is_none():
    facts = {"a": math.nan, "b": {"c": math.inf, "d": 1.5}, "e": True, "f": -math.inf, "g": 3}
    assert finite_or_none(facts) == {"a": None, "b": {"c": None, "d": 1.5}, "e": True, "f": None, "g": 3}


def test_the_papers_reward_network_is_not_begun_with_a_judge_it_cannot_learn_from(store):
    config = asking(paper("HalfCheetah-v5"), judge_from("choice"))
    with pytest.raises(InputError, match="got the judge choice for the paper's reward network"):
        start(store, world_from("linear"), RunSpec(seed=0, config=config, judge="choice"))
    wish = replace(
        paper("HalfCheetah-v5"), question=replace(config.question, levels=None, clip=None, pick="information")
    )
    with pytest.raises(InputError, match="picked uniformly"):
        start(store, world_from("linear"), RunSpec(seed=0, config=wish, judge="exact"))
    assert not store.runs()
    start(store, world_from("linear"), RunSpec(seed=0, config=paper("HalfCheetah-v5"), judge="exact"))


def test_what_the_papers_network_cannot_learn_from_is_not_taken(store):
    world = world_from("linear")
    config = replace(TINY, reward=paper("linear").reward)
    run_id = start(store, world, RunSpec(seed=3, config=config, judge=CUSTOM, eval_episodes=2))
    for said in (["choice"], ["number", "choice"]):  # the second time, from where the first one stopped
        answers = iter(said)
        judge = judge_from(lambda tau, other, answers=answers: choice(True) if next(answers) == "choice" else 1.0)
        with pytest.raises(JudgeError, match=r"form 'choice'; .* from numbers alone") as caught:
            carry_on(store, run_id, world, judge)
        assert "resume" in str(caught.value) and store.questions(run_id, unanswered=True)
        assert [row.answer.form for row in store.answers(run_id)] == said[:-1]


@pytest.mark.slow
def test_a_run_of_the_papers_network_goes_on_after_an_answer_it_cannot_learn_from(store):
    world, config = world_from("linear"), replace(TINY, reward=paper("linear").reward)
    run_id = start(store, world, RunSpec(seed=3, config=config, judge=CUSTOM, eval_episodes=2))
    with pytest.raises(JudgeError, match="from numbers alone"):
        carry_on(store, run_id, world, judge_from(lambda tau, other: choice(True)))
    assert carry_on(store, run_id, world, exact)["comparisons"] == config.comparisons
