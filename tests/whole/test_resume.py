import pytest

from hiprl.data.answer import number
from hiprl.errors import InputError, JudgeError
from hiprl.feedback.judges import exact, judge_from
from hiprl.feedback.judging import Judging
from hiprl.session import RunSpec, carry_on, start
from hiprl.store.store import open_store
from hiprl.world.build import world_from
from tests.whole.tasks import TINY

SPEC = RunSpec(seed=11, config=TINY, judge="exact", eval_episodes=2)


class Recording:
    """The exact judge, which notes how often it was asked and can be made to fail."""

    def __init__(self, fail_at=None):
        self.asked, self.fail_at = 0, fail_at

    def judging(self):
        return Judging(answer=self.answer)

    def answer(self, clips, hand, *, steps, key):
        self.asked += 1
        return None if self.asked == self.fail_at else exact.answer(clips, hand, key=key)


def remains(store, run_id):
    """All that a run leaves behind, but for times and its name."""
    facts = [{**facts, "seconds": None} for _, facts in store.episodes(run_id)]
    summary = {k: v for k, v in store.final(run_id).items() if k not in ("run", "store", "wall_seconds")}
    trajectories = [row.values() for row in store.trajectories(run_id)]
    answers = [(answer.k, answer.g) for answer in store.answers(run_id)]
    return store.policy(run_id), store.checkpoint(run_id), trajectories, answers, facts, summary


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    with open_store(tmp_path_factory.mktemp("uninterrupted") / "runs.db") as store:
        world = world_from("linear")
        run_id = start(store, world, SPEC)
        carry_on(store, run_id, world, exact)
        yield remains(store, run_id)


@pytest.fixture(params=[1, 4])
def stopped(request, store):
    """A run whose judge gave no answer in this episode."""
    world = world_from("linear")
    run_id = start(store, world, SPEC)
    with pytest.raises(JudgeError) as caught:
        carry_on(store, run_id, world, Recording(fail_at=request.param).judging())
    assert f"The run is {run_id}." in str(caught.value)
    return store, run_id, request.param


def test_a_judge_that_fails_leaves_its_question_open(stopped):
    store, run_id, k = stopped
    (question,) = store.questions(run_id, unanswered=True)
    assert (question.k, question.first) == (k, k) and question.second < k
    assert len(store.episodes(run_id)) == k - 1 and len(store.answers(run_id)) == k - 1
    assert len(store.trajectories(run_id)) == k + 1  # what was executed for the question is kept


def test_a_run_that_was_resumed_equals_one_that_was_not_bit_for_bit(stopped, uninterrupted):
    store, run_id, k = stopped
    judge = Recording()
    carry_on(store, run_id, world_from("linear"), judge.judging())
    assert judge.asked == TINY.comparisons - k + 1
    assert remains(store, run_id) == uninterrupted


def test_an_answer_that_came_in_the_meantime_is_taken_up(stopped, uninterrupted):
    store, run_id, k = stopped
    g = dict(uninterrupted[3])[k]
    store.answer(run_id, k, number(g), "a person")
    judge = Recording()
    carry_on(store, run_id, world_from("linear"), judge.judging())
    assert judge.asked == TINY.comparisons - k  # nobody was asked again
    assert remains(store, run_id) == uninterrupted


def test_the_newest_of_several_answers_counts(stopped, uninterrupted):
    store, run_id, k = stopped
    g = dict(uninterrupted[3])[k]
    store.answer(run_id, k, number(g + 100), "a person")
    store.answer(run_id, k, number(g), "the same person, corrected")
    carry_on(store, run_id, world_from("linear"), Recording().judging())
    policy, checkpoint, *_ = remains(store, run_id)
    assert (policy, checkpoint) == uninterrupted[:2]


def test_stopping_by_hand_loses_nothing(store, uninterrupted):
    world = world_from("linear")
    run_id = start(store, world, SPEC)

    def stop(facts):
        if facts["k"] == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        carry_on(store, run_id, world, exact, watch=stop)
    assert len(store.episodes(run_id)) == 3
    carry_on(store, run_id, world, exact)
    assert remains(store, run_id) == uninterrupted


def test_another_seed_is_another_run(store, uninterrupted):
    world = world_from("linear")
    run_id = start(store, world, RunSpec(seed=12, config=TINY, judge="exact", eval_episodes=2))
    carry_on(store, run_id, world, judge_from("exact"))
    assert remains(store, run_id)[0] != uninterrupted[0]


def test_a_finished_run_cannot_be_resumed(store):
    world = world_from("linear")
    run_id = start(store, world, SPEC)
    carry_on(store, run_id, world, exact)
    with pytest.raises(InputError) as caught:
        carry_on(store, run_id, world, exact)
    message = str(caught.value)
    assert f"{run_id} is finished" in message and "episodes left" in message and "hiprl show" in message


def test_a_run_that_is_being_trained_cannot_be_resumed(store):
    world = world_from("linear")
    run_id = start(store, world, SPEC)
    with store.lease(run_id), pytest.raises(InputError, match="trainer"):
        carry_on(store, run_id, world, exact)
    assert store.trajectories(run_id) == []
