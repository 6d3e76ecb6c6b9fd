from dataclasses import replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy import integrate, stats

from hiprl.data.answer import choice
from hiprl.data.preference import Clip, Preferences
from hiprl.errors import InputError
from hiprl.feedback import questions
from hiprl.feedback.questions import QuestionConfig, Questions, expected_information, pick_clips
from hiprl.models.answers import estimate_from_answers
from hiprl.models.features import Kernel
from hiprl.models.reward import AdditiveConfig, estimate_additive_reward
from tests.models.worlds import linear_set

H, N, STEPS = 31, 17, 11
drawn, information = (jax.jit(f, static_argnames="config") for f in (questions.drawn, questions.information))
TELLING = QuestionConfig(clip=STEPS, pick="information", levels=2, candidates=200, aligned=0.0)


@pytest.fixture(scope="module")
def T():
    return linear_set(5, [H] * 9 + [7], H=H, capacity=N)


@pytest.fixture(scope="module")
def reward(T):
    P = Preferences.empty(13)
    for k in range(6):
        clips = [Clip.at(k, k, STEPS), Clip.at(k + 1, 2 * k, STEPS)]
        P = P.answered(choice(k % 3 > 0), clips, at_hand=jnp.asarray(9, jnp.int32))
    return estimate_from_answers(P, T, (Kernel(0.1, 4.0),))


@pytest.fixture(scope="module")
def blank(T):
    return estimate_additive_reward(Preferences.empty(13), T, AdditiveConfig())


def made_of(clips):
    """Questions that each show two clips of their own."""
    return Questions(jax.tree.map(lambda x: x.reshape(-1), clips), jnp.arange(clips.of.size).reshape(clips.of.shape))


@pytest.mark.parametrize("seed", range(5))
def test_uniform_questions_are_about_the_newest_and_an_older_trajectory(T, blank, seed):
    clips = pick_clips(T, blank, QuestionConfig(), key=jr.key(seed))
    assert int(clips.of[0]) == 9 and 0 <= int(clips.of[1]) < 9
    assert (np.asarray(clips.start) == 0).all() and (np.asarray(clips.length) > H).all()


def test_the_older_trajectory_is_picked_uniformly(T, blank):
    of = jax.vmap(lambda key: pick_clips(T, blank, QuestionConfig(), key=key).of[1])(jr.split(jr.key(11), 3000))
    seen = np.bincount(np.asarray(of), minlength=9)
    assert len(seen) == 9  # never the newest one, or one that is not there
    left = stats.chi2.cdf(stats.chisquare(seen).statistic, 8)
    assert 1e-4 < left < 1 - 1e-4  # neither too uneven nor too even


@pytest.mark.parametrize("pick", ["uniform", "information"])
@pytest.mark.parametrize("items", [1, 2, 4])
def test_clips_lie_within_their_trajectories(T, reward, pick, items):
    config = QuestionConfig(clip=STEPS, pick=pick, items=items, levels=2, candidates=64)
    for seed in range(3):
        clips = pick_clips(T, reward, config, key=jr.key(seed))
        assert clips.of.shape == (items,)
        of, start, length = (np.asarray(x) for x in (clips.of, clips.start, clips.length))
        lengths = np.asarray(T.rows.length)[of]
        assert (of < 10).all() and (start >= 0).all() and (length == STEPS).all()
        assert (start + np.minimum(STEPS, lengths) <= lengths).all()


def test_the_question_picked_is_worth_most(T, reward):
    config = TELLING
    worth = partial(information, T, reward, config=config)
    picked = pick_clips(T, reward, config, key=jr.key(3))
    rng = np.random.default_rng(0)
    of, start = rng.integers(0, 9, (200, 2)), rng.integers(0, H - STEPS, (200, 2))
    others = made_of(Clip.at(jnp.asarray(of), jnp.asarray(start), STEPS))
    best = float(worth(made_of(jax.tree.map(lambda x: x[None], picked)))[0])
    assert best > np.quantile(np.asarray(worth(others)), 0.8)


def test_what_was_asked_is_the_last_to_be_asked_again(T, reward):
    config, asked = replace(TELLING, clip=None, candidates=1000), set()
    first = pick_clips(T, reward, config, key=jr.key(0))
    assert same_pair(first, pick_clips(T, reward, config, key=jr.key(1)))  # with few pairs one is always the best
    for k in range(45):  # ten trajectories have so many pairs
        rows = [sorted(pair, reverse=k % 2 > 0) for pair in asked] + [(-1, -1)] * (45 - len(asked))
        new = pick_clips(T, reward, config, before=Clip.whole(jnp.asarray(rows)), key=jr.key(k))
        pair = frozenset(new.of.tolist())
        assert len(pair) == 2 and pair not in asked
        asked.add(pair)
    rows = [sorted(pair) for pair in asked]
    assert len(set(pick_clips(T, reward, config, before=Clip.whole(jnp.asarray(rows)), key=jr.key(7)).of.tolist())) == 2


def same_pair(clips, others):
    return set(clips.of.tolist()) == set(others.of.tolist())


def test_what_is_known_of_a_question_is_what_the_reward_says_of_its_clips(T, reward):
    config = replace(TELLING, levels=None)  # then the worth is the log of σ_g, where the unit is known
    reward = eqx.tree_at(lambda r: r.errors.spread, reward, jnp.zeros(()))
    asked = drawn(T, config, key=jr.key(4))
    worth = np.asarray(information(T, reward, asked, config=config))
    for i in np.flatnonzero(np.isfinite(worth))[:5]:
        first, second = (T.clip(jax.tree.map(lambda x: x[k], asked.clips)) for k in asked.shown[i])  # noqa: B023
        assert worth[i] == pytest.approx(np.log(reward.gap(first, second).sigma), abs=1e-2)


def test_aligned_questions_are_about_the_newest_and_the_best(T, reward):
    best = int(np.argmax(np.asarray(reward.returns(T))[:9]))
    assert pick_clips(T, reward, replace(TELLING, aligned=1.0), key=jr.key(2)).of.tolist() == [9, best]


def test_where_two_have_too_little_to_show_others_are_asked_about(T, reward):
    config = replace(TELLING, aligned=1.0, items=4)  # the newest has 7 steps, a clip 11
    for seed in range(3):
        clips = pick_clips(T, reward, config, key=jr.key(seed))
        assert not bool(questions.twice(jax.tree.map(lambda x: x[None], clips))[0])


def test_a_ranking_shows_no_older_trajectory_twice_while_there_are_others(T, blank):
    for seed in range(5):
        of = pick_clips(T, blank, QuestionConfig(items=4), key=jr.key(seed)).of.tolist()
        assert of[0] == 9 and len(set(of)) == 4 and max(of[1:]) < 9


def test_room_for_more_trajectories_changes_nothing_a_rating_is_about(T, reward):
    Phi = questions.phi_of(T, reward.features, Clip.whole(jnp.arange(N)), QuestionConfig(items=1, pick="information"))
    there = np.asarray(Phi)[:10]
    np.testing.assert_allclose(there.mean(0), 0.0, atol=1e-3 * np.abs(there).max())


def test_a_clip_is_never_compared_with_itself(T, reward):
    clips = Clip.at(jnp.asarray([[2, 2], [2, 2], [2, 3]]), jnp.asarray([[4, 9], [1, 15], [4, 4]]), STEPS)
    worth = np.asarray(information(T, reward, made_of(clips), config=TELLING))
    assert worth[0] == -np.inf and np.isfinite(worth[1:]).all()


@pytest.mark.parametrize(("mean", "std"), [(0.0, 1.0), (0.5, 0.3), (-2.0, 0.1), (0.1, 3.0)])
def test_expected_information_of_a_choice_is_its_integral(mean, std):
    kappa = 0.4
    p = lambda u: 1 / (1 + np.exp(-u / kappa))
    h = lambda p: -(p * np.log(p) + (1 - p) * np.log(1 - p)) if 0 < p < 1 else 0.0
    density = stats.norm(mean, std).pdf
    reach = (mean - 8 * std, mean + 8 * std)
    average = integrate.quad(lambda u: p(u) * density(u), *reach, limit=200)[0]
    left = integrate.quad(lambda u: h(p(u)) * density(u), *reach, limit=200)[0]
    found = expected_information(jnp.float32(mean), jnp.float32(std), jnp.zeros(1), jnp.float32(kappa))
    assert float(found) == pytest.approx(h(average) - left, abs=0.02)


def test_what_is_known_is_not_worth_asking():
    tell = lambda mean, std: float(expected_information(*map(jnp.float32, (mean, std)), jnp.zeros(1), jnp.float32(0.1)))
    assert tell(0.0, 1.0) > tell(1.0, 1.0) > tell(1.0, 0.1) >= -1e-5
    assert tell(0.0, 1.0) < np.log(2)


def test_more_levels_tell_more():
    two, five = jnp.zeros(1), jnp.asarray([-0.75, -0.25, 0.25, 0.75])
    of = lambda cuts: float(expected_information(jnp.float32(0.1), jnp.float32(0.6), cuts, jnp.float32(0.1)))
    assert of(five) > 1.3 * of(two)


@pytest.mark.parametrize("wrong", [{"clip": 0}, {"items": 9}, {"levels": 1}, {"candidates": 0}, {"aligned": 1.5}])
def test_impossible_questions_are_refused(wrong):
    with pytest.raises(InputError) as caught:
        QuestionConfig(**wrong)
    assert str(caught.value).startswith("got ") and str(caught.value).count(". ") >= 1
