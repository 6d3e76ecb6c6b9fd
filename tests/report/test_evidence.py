from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from hiprl.cli.commands import Relearn
from hiprl.cli.relearning import relearn
from hiprl.config import Config
from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, choice, level, number, ranking, rating
from hiprl.data.preference import Clip, Kind, Preferences
from hiprl.errors import InputError
from hiprl.models.estimate import estimate_reward
from hiprl.models.quality import cross_validated, shapes
from hiprl.models.reward import JUDGES, AdditiveConfig
from hiprl.report.beliefs import beliefs
from hiprl.report.evidence import GOING_ON, agreement, as_said, consistency, evidence_of, opinions, quality, told
from hiprl.spec import to_plain
from hiprl.store.rows import ClipRow
from hiprl.store.store import open_store
from tests.models.worlds import linear_set, steps_of

H, N, STEPS = 31, 11, 13
LINEAR = AdditiveConfig(smooth=(0.01,), noise=(1e-4,))


@pytest.fixture(scope="module")
def T():
    return linear_set(8, [H] * N, H=H)


def paid(T, clip):
    s, _ = steps_of(T, clip.of)
    return float(s[clip.start : clip.start + (clip.length or H), 1].sum())


def pairs():
    rng = np.random.default_rng(2)
    for k in range(1, N):
        places = [(k, int(rng.integers(H - STEPS))), (int(rng.integers(k)), int(rng.integers(H - STEPS)))]
        yield k, [ClipRow(of, start, STEPS) for of, start in places]


def stored(path, T, say):
    """A store with a run that has these trajectories, and what `say` answers about clips of them."""
    store = open_store(path)
    spec = {"config": to_plain(Config()), "horizon": H, "judge": "exact"}
    run = store.add_run("linear", 0, spec, {})
    for i in range(N):
        store.add_trajectory(run, i, T.get(i).seen(), "random")
    for k, clips in pairs():
        store.ask(run, k, clips)
        store.answer(run, k, say(*(paid(T, clip) for clip in clips)), "rule")
    return store, run


@pytest.fixture(scope="module")
def numbers(T, tmp_path_factory):
    store, run = stored(tmp_path_factory.mktemp("numbers") / "runs.db", T, lambda a, b: number(a - b))
    with store:
        yield store, store.run(run)


@pytest.fixture(scope="module")
def evidence(numbers):
    return evidence_of(*numbers)


def test_the_store_gives_trajectories_and_answers_back(evidence, numbers, T):
    again, P = evidence
    assert int(again.count) == N and int(P.count) == N - 1
    np.testing.assert_array_equal(again.rows.actions[:N], T.rows.actions[:N])
    for k, clips in pairs():
        np.testing.assert_array_equal(P.clips.of[k - 1], [clip.of for clip in clips])
        np.testing.assert_array_equal(P.clips.start[k - 1], [clip.start for clip in clips])
        assert float(P.g[k - 1]) == pytest.approx(paid(T, clips[0]) - paid(T, clips[1]), rel=1e-5)


def test_a_corrected_answer_is_the_one_that_counts(T, tmp_path):
    store, run = stored(tmp_path / "runs.db", T, lambda a, b: number(a - b))
    with store:
        store.answer(run, 3, number(77.0), "rule")
        _, P = evidence_of(store, store.run(run))
    assert float(P.g[2]) == 77.0 and int(P.count) == N - 1


def test_a_run_without_answers_is_refused(tmp_path):
    with open_store(tmp_path / "runs.db") as store:
        run = store.add_run("linear", 0, {"config": to_plain(Config()), "horizon": H, "judge": "exact"}, {})
        with pytest.raises(InputError, match=r"has no answers yet; .*hiprl resume"):
            evidence_of(store, store.run(run))


def test_the_reward_is_learned_again(evidence, T):
    again, P = evidence
    reward = estimate_reward(P, again, None, LINEAR)
    gap = reward.gap(again.get(4), again.get(7))
    assert float(gap.mean) == pytest.approx(paid(T, ClipRow(4)) - paid(T, ClipRow(7)), rel=0.1, abs=1.0)


def test_kept_answers_are_predicted_from_the_others(evidence):
    again, P = evidence
    found = quality(again, P, LINEAR, folds=5)
    assert found["answers"] == N - 1 and found["held_out_accuracy"] >= 0.8
    assert 0.5 <= found["coverage_90"] <= 1 and np.isfinite(found["held_out_log_likelihood"])
    assert found["consistency"] is None  # nothing was asked twice


def test_noise_is_not_predicted(evidence):
    again, P = evidence
    rng = np.random.default_rng(0)
    said = type(P.said)(P.said.kind, *[jnp.asarray(rng.normal(size=P.capacity), jnp.float32)] * 2, P.said.items)
    noise = type(P)(said, P.clips, P.judge, P.at_hand, P.count)
    held, true = (cross_validated(p, again, LINEAR, folds=5) for p in (noise, P))
    assert held.mean("log_likelihood") < true.mean("log_likelihood")


def test_numbers_can_count_as_choices(evidence):
    _again, P = evidence
    Q = as_said(P, "choices")
    n = int(P.count)
    assert (np.asarray(Q.said.kind)[:n] == Kind.LEVEL).all()
    np.testing.assert_array_equal(np.asarray(Q.said.low)[:n] == 0, np.asarray(P.g)[:n] > 0)
    assert as_said(P, "all") is P
    np.testing.assert_array_equal(as_said(Q, "choices").said.low[:n], Q.said.low[:n])


def test_ratings_count_as_good_or_bad_and_rankings_stay():
    P = Preferences.empty(3, m=3)
    hand = jnp.asarray(4, jnp.int32)
    for said, n in ((rating(-2, 5), 1), (rating(1, 5), 1), (ranking([2, 0, 1]), 3)):
        P = P.answered(said, [Clip.at(i, 0, 2) for i in range(n)], at_hand=hand)
    Q = as_said(P, "choices")
    np.testing.assert_array_equal(Q.said.kind, P.said.kind)
    np.testing.assert_array_equal(Q.said.low[:2], [-np.inf, 0])
    np.testing.assert_array_equal(Q.said.high[:2], [0, np.inf])
    np.testing.assert_array_equal(Q.said.low[2], P.said.low[2])


def test_the_view_of_a_reward_shows_what_it_goes_by(evidence):
    again, P = evidence
    found = shapes(estimate_reward(P, again, None, LINEAR), again)
    assert int(np.argmax(found.weight)) == 1  # the truth is the second entry of the state
    slope = np.gradient(np.asarray(found.mean[1]), np.asarray(found.x[1]))
    assert np.median(slope) == pytest.approx(1.0, abs=0.2)
    assert (np.asarray(found.std) >= 0).all()


def test_a_judge_who_contradicts_himself_is_told(evidence):
    _again, P = evidence
    clips = [type(P.clips)(*(x[0, i] for x in (P.clips.of, P.clips.start, P.clips.length))) for i in range(2)]
    empty = P.only(np.arange(0))
    at_hand = jnp.asarray(N, jnp.int32)
    said = lambda first, second: empty.answered(choice(first), clips, at_hand=at_hand).answered(
        choice(second), clips[::-1], at_hand=at_hand
    )
    assert consistency(said(True, False)) == 1 and consistency(said(True, True)) == 0
    assert agreement(said(True, True)) is None  # one judge alone


ABC = [Clip.at(i, 0, 2) for i in range(3)]


@pytest.mark.parametrize(
    ("first", "second", "clips", "same"),
    [
        (ranking([0, 1, 2]), ranking([0, 1, 2]), ABC, 1),
        (ranking([0, 1, 2]), ranking([2, 1, 0]), ABC, 0),
        (ranking([0, 1, 2]), ranking([0, 2, 1]), ABC, 2 / 3),
        (ranking([0, 1]), ranking([1, 0]), ABC[:2], 0),
        (ranking([1, 0]), choice(False), ABC[:2], 1),
        (choice(True), level(2, 5), ABC[:2], 1),
        (choice(True), EQUALLY_GOOD, ABC[:2], 0),
        (choice(True), CANNOT_TELL, ABC[:2], None),
        (rating(2, 5), rating(1, 5), ABC[:1], 1),
        (rating(2, 5), rating(-1, 5), ABC[:1], 0),
    ],
)
def test_the_same_is_asked_twice(first, second, clips, same):
    """In a P with room for more clips than a question shows."""
    P = Preferences.empty(3, m=4)
    hand = jnp.asarray(3, jnp.int32)
    P = P.answered(first, clips, at_hand=hand).answered(second, clips, at_hand=hand)
    assert consistency(P) == (None if same is None else pytest.approx(same)) and agreement(P) is None


def test_two_judges_are_held_against_each_other(T, evidence, tmp_path):
    store, run = stored(tmp_path / "runs.db", T, lambda a, b: choice(a > b))
    with store:
        _, clips = next(pairs())
        for k, answer in ((N, choice(paid(T, clips[0]) > paid(T, clips[1]))), (N + 1, choice(False))):
            store.ask(run, k, clips)
            store.answer(run, k, answer, "ada" if k == N else "rule")
        row = store.run(run)
        _, P = evidence_of(store, row)
        reward = estimate_reward(*reversed(evidence), None, LINEAR)
        found = opinions(store, row, P, eqx.tree_at(lambda r: r.errors.mistakes, reward, jnp.linspace(0, 0.3, JUDGES)))
        assert found["agreement"] in (0.5, 1.0) and agreement(P) == found["agreement"]
        assert [(one["judge"], one["answers"]) for one in found["judges"]] == [("rule", N), ("ada", 1)]
        assert [one["mistakes"] for one in found["judges"]] == [0, pytest.approx(0.3 / (JUDGES - 1))]


def test_one_judge_alone_has_nobody_to_agree_with(numbers, evidence):
    T, P = evidence
    assert opinions(*numbers, P, estimate_reward(P, T, None, LINEAR)) == {"judges": [], "agreement": None}


@pytest.mark.slow
@pytest.mark.parametrize(
    "say",
    [lambda a, b: choice(a > b), lambda a, b: EQUALLY_GOOD, lambda a, b: CANNOT_TELL],
    ids=["choice", "equal", "unsure"],
)
def test_the_command_takes_any_answers(T, tmp_path, capsys, say):
    store, run = stored(tmp_path / "runs.db", T, say)
    store.close()
    facts = relearn(Relearn(run=run[:4], store=str(tmp_path / "runs.db"), folds=3))
    shown = capsys.readouterr().out
    assert facts["answers"] == N - 1 and run in shown and "goes by" in shown


def test_one_fold_is_refused(tmp_path):
    with pytest.raises(InputError, match="at least 2 are needed"):
        relearn(Relearn(run="x", folds=1))


def test_a_reward_is_told_by_the_names_of_what_it_goes_by(numbers, evidence):
    again, P = evidence
    _, row = numbers
    found = told(row, again, P, LINEAR)
    assert next(iter(found.weights)) == "s[1]" and sum(found.weights.values()) == pytest.approx(1, abs=0.2)
    named = replace(row, spec=row.spec | {"names": {"state": ["place", "speed", "turn"], "action": ["push", "pull"]}})
    assert next(iter(told(named, again, P, LINEAR).weights)) == "speed"
    figure = beliefs(found.shapes, float(found.reward.unit), found.names, "a run")
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_visible()]
    assert titles[0].startswith("s[1]: ") and len(titles) == 5


def test_that_an_episode_goes_on_is_told_where_answers_tell_it(numbers, evidence):
    again, P = evidence
    _, row = numbers
    found = told(row, again, P, LINEAR)
    assert GOING_ON not in found.weights  # all episodes are as long
    long_lived = found._replace(reward=eqx.tree_at(lambda r: r.mean, found.reward, found.reward.mean.at[0].set(1e3)))
    assert next(iter(long_lived.weights)) == GOING_ON and long_lived.weights[GOING_ON] > 0.9
    figure = beliefs(found.shapes, 1.0, found.names, "a run", going_on=1e3)
    assert "% is that it goes on at all" in " ".join(figure.get_suptitle().split())
