import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from scipy import stats

from hiprl.data.answer import CANNOT_TELL, EQUALLY_GOOD, Answer, choice, level, number, ranking, rating, slider
from hiprl.data.preference import Clip
from hiprl.data.trajectory_set import Trajectories
from hiprl.errors import InputError, JudgeError
from hiprl.feedback.judges import SCRIPTED, exact, judge_from, nearest_level, noisy, plackett_luce_order, spread
from hiprl.feedback.judging import Judging, checked
from tests.data.samples import H, p, q, seeds, set_of, trajectory

PAIRWISE = ["exact", "choice", "graded:levels=4", "graded", "slider"]
RELATIVE = [
    "choice:beta=0.7,mistake=0.1,skip=0.3,equal=0.2,myopic=0.8",
    "graded:noise=0.5,mistake=0.2",
    "slider:noise=0.3",
    "ranking:k=3,beta=1.3",
    "rating:levels=7,noise=0.4",
]


def paid(*rewards):
    """A trajectory that was paid this; NaN past its end."""
    tau = trajectory(np.random.default_rng(3), length=len(rewards))
    return eqx.tree_at(lambda t: t.rewards, tau, jnp.asarray([*rewards, *[math.nan] * (H - len(rewards))]))


def hand_of(*returns):
    """T of trajectories of one step; the returns of those at hand are these."""
    return set_of([paid(x) for x in returns])


def true_return(tau):
    return np.asarray(tau.rewards, float)[: int(tau.length)].sum()


def asked(judge, clips, hand, *, seed=0):
    return checked(judge_from(judge), tuple(clips), hand, key=jr.key(seed))


def often(judge, clips, hand, *, n=211, seed=7):
    """What the judge says when it is asked again and again."""
    judging = judge_from(judge)
    return [checked(judging, tuple(clips), hand, key=key) for key in jr.split(jr.key(seed), n)]


def fits(count, n, probability):
    """Whether so many of n are what the probability lets expect: two-sided."""
    return stats.binomtest(int(count), n, probability).pvalue > 1e-4


def rescaled(tree, factor):
    """The same with every reward times this."""
    scale = lambda tau: eqx.tree_at(lambda t: t.rewards, tau, tau.rewards * factor)
    return eqx.tree_at(lambda T: T.rows, tree, scale(tree.rows)) if hasattr(tree, "rows") else scale(tree)


@pytest.fixture
def pair():
    rng = np.random.default_rng(17)
    return trajectory(rng, length=5), trajectory(rng, length=3)


@pytest.fixture
def hand(pair):
    return set_of([*pair, trajectory(np.random.default_rng(18), length=H)])


def difference(pair):
    tau, other = map(true_return, pair)
    return tau - other


def random_hand(rng, *, least=1):
    """Five trajectories of different lengths, and a row that is not filled. By way of NumPy, for speed."""
    taus = [jax.tree.map(np.asarray, trajectory(rng, length=int(n))) for n in rng.integers(least, H + 1, 5)]
    rows = jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *taus, rescaled(taus[0], math.nan))
    return taus, Trajectories(rows, jnp.asarray(5))


def clips_and_hand(seed, *, k=2):
    """Clips of two to four steps, with all that is at hand."""
    rng = np.random.default_rng(seed)
    taus, T = random_hand(rng, least=4)
    shown = [part(taus[i], *rng.integers((0, 2), (3, 5))) for i in rng.integers(0, 5, k)]
    return tuple(shown), T


def part(tau, start, steps):
    """At most so many steps of a trajectory; NaN past their end."""
    n = min(steps, int(tau.length) - start)
    rewards = np.full(H, np.nan, np.float32)
    rewards[:n] = tau.rewards[start : start + n]
    return eqx.tree_at(lambda t: (t.rewards, t.length), tau, (jnp.asarray(rewards), jnp.asarray(n)))


# Numbers


def test_the_exact_judge_says_the_difference_of_the_true_returns(pair, hand):
    assert judge_from("exact") is exact
    answer = checked(exact, pair, hand, key=jr.key(0))
    assert answer.form == exact.form == "number" and answer.value == pytest.approx(difference(pair), abs=1e-5)


@pytest.mark.parametrize("name", ["noisy:2.5", "noisy:std=2.5"])
def test_the_noisy_judge_errs_by_a_gaussian_of_its_spread(pair, hand, name):
    errors = np.array([answer.value for answer in often(name, pair, hand, seed=5)]) - difference(pair)
    assert 1e-4 < stats.kstest(errors / 2.5, "norm").pvalue < 1 - 1e-4


def test_a_judge_without_error_is_exact(pair, hand):
    assert checked(noisy(0.0), pair, hand, key=jr.key(1)) == checked(exact, pair, hand, key=jr.key(1))


# What scripted judges have in common


@settings(max_examples=7)
@given(seeds)
def test_what_is_said_changes_sign_when_the_pair_is_swapped(seed):
    (first, second), T = clips_and_hand(seed)
    for name in PAIRWISE:
        one, other = asked(name, (first, second), T), asked(name, (second, first), T)
        assert one.form == other.form
        assert one.form == "equal" or one.value == pytest.approx(-other.value, abs=1e-6)


@settings(max_examples=7)
@given(seeds)
def test_the_scale_of_the_reward_changes_no_answer(seed):
    clips, T = clips_and_hand(seed, k=3)
    for name in RELATIVE:
        shown = clips[: judge_from(name).items]
        answer = asked(name, shown, T, seed=seed)
        assert all(
            asked(name, [rescaled(clip, c) for clip in shown], rescaled(T, c), seed=seed) == answer
            for c in (2.0**-13, 2.0**9)
        )


@settings(max_examples=7)
@given(seeds)
def test_clips_without_padding_are_judged_alike(seed):
    clips, T = clips_and_hand(seed, k=3)
    for name in [*RELATIVE, "exact"]:
        shown = clips[: judge_from(name).items]
        assert asked(name, [clip.seen() for clip in shown], T, seed=3) == asked(name, shown, T, seed=3)


@pytest.mark.parametrize(
    ("name", "form", "items", "levels"),
    [
        ("exact", "number", 2, None),
        ("noisy:3", "number", 2, None),
        ("choice", "choice", 2, None),
        ("choice:", "choice", 2, None),
        ("graded", "level", 2, 5),
        ("graded:levels=4", "level", 2, 4),
        ("slider: noise = 0.1", "slider", 2, None),
        ("ranking", "ranking", 4, None),
        ("ranking:k=7", "ranking", 7, None),
        ("rating", "rating", 1, 5),
        ("rating:levels=3", "rating", 1, 3),
    ],
)
def test_a_judge_says_what_it_needs_to_see_and_how_it_answers(name, form, items, levels):
    judging = judge_from(name)
    assert (judging.form, judging.items, judging.levels) == (form, items, levels)
    clips, T = clips_and_hand(5, k=items)
    assert checked(judging, clips, T, key=jr.key(1)).form == form


@pytest.mark.parametrize("name", SCRIPTED)
def test_where_nothing_is_paid_no_scripted_judge_has_an_answer(pair, name):
    clips = [rescaled(tau, math.nan) for tau in (*pair, *pair)]
    judging = judge_from("noisy:2" if name == "noisy" else name)
    with pytest.raises(JudgeError, match="An environment that pays no reward needs a judge of your own"):
        checked(judging, tuple(clips[: judging.items]), set_of(clips), key=jr.key(0))


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["choice", "rating"])
def test_a_reward_at_hand_that_is_no_number_is_no_scale(name, bad):
    with pytest.raises(JudgeError, match="judge of your own"):
        asked(name, [paid(3.0)] * judge_from(name).items, set_of([paid(2.0), paid(bad, bad), paid(1.0)]))


@pytest.mark.parametrize("name", SCRIPTED)
def test_where_all_are_the_same_every_judge_still_answers(name):
    judging = judge_from("noisy:0" if name == "noisy" else name)
    clips = (paid(2.5, 0.5),) * judging.items
    answer = checked(judging, clips, set_of(list(clips)), key=jr.key(3))
    assert answer in (number(0.0), EQUALLY_GOOD, level(0, 5), slider(0.0), rating(0, 5)) or answer.form == "ranking"


# The spread


@given(seeds)
def test_the_spread_is_that_of_all_windows_side_by_side(seed):
    taus, T = random_hand(np.random.default_rng(seed))
    for steps in (1, 2, 3, H, H + 4):
        returns = []
        for tau in taus:
            n = int(tau.length)
            starts = range(0, n - steps + 1, steps) if n > steps else [0]
            returns += [float(sum(np.asarray(tau.rewards, float)[t : min(t + steps, n)])) for t in starts]
        assert spread(T, steps) == pytest.approx(np.std(returns), rel=1e-9)


def test_the_spread_by_hand():
    T = set_of([paid(1.0, 2.0, 3.0, 4.0, 50.0), paid(9.0)])  # windows of two: 3, 7; and 9, which is shorter
    assert spread(T, 2) == pytest.approx(math.sqrt(((3 - 19 / 3) ** 2 + (7 - 19 / 3) ** 2 + (9 - 19 / 3) ** 2) / 3))


def test_of_nothing_and_of_one_the_spread_is_zero():
    T = set_of([paid(1.0, 5.0)])
    assert spread(T, 2) == 0 and spread(Trajectories.empty(3, H=H, p=p, q=q), 2) == 0


# Choices


def test_a_rational_judge_takes_the_better_clip():
    T = hand_of(3.0, 5.0, 7.5)
    assert asked("choice", (paid(5.0), paid(3.0)), T) == choice(True)
    assert asked("choice", (paid(3.0), paid(3.001)), T) == choice(False)
    assert asked("choice", (paid(3.0, 2.0), paid(2.0, 3.0)), T) == EQUALLY_GOOD


@pytest.mark.parametrize("gap", [0.0, 0.6, -1.1])
def test_the_first_is_chosen_with_the_probability_of_bradley_and_terry(gap):
    T = hand_of(2.0, 6.0, 2.0, 6.0)  # spread 2
    chosen = often("choice:beta=1.7", (paid(3.0 + 2 * gap), paid(3.0)), T)
    assert all(answer.form == "choice" for answer in chosen)
    assert fits(sum(answer.value > 0 for answer in chosen), 211, 1 / (1 + math.exp(-1.7 * gap)))


def test_a_mistake_takes_the_worse_clip():
    T = hand_of(2.0, 6.0, 3.5)
    chosen = often("choice:mistake=0.3", (paid(6.0), paid(2.0)), T)
    assert fits(chosen.count(choice(False)), 211, 0.3)
    assert set(often("choice:mistake=1", (paid(6.0), paid(2.0)), T, n=13)) == {choice(False)}
    assert asked("choice:mistake=1", (paid(6.0), paid(6.0)), T) == EQUALLY_GOOD


def test_two_bad_clips_are_skipped_and_one_good_one_suffices():
    T = hand_of(-2.0, 2.0, -2.0, 2.0)  # the worst is -2, the spread 2: half a spread above the worst is -1
    judge = "choice:skip=0.5"
    assert asked(judge, (paid(-2.0), paid(-1.1)), T) == CANNOT_TELL
    assert asked(judge, (paid(-2.0), paid(-0.9)), T) == choice(False)
    assert asked(judge, (paid(1.0), paid(-2.0)), T) == choice(True)
    assert asked("choice", (paid(-2.2), paid(-2.5)), T) == choice(True)


def test_what_differs_by_little_is_equal():
    T = hand_of(-2.0, 2.0, -2.0, 2.0)
    judge = "choice:equal=0.5,beta=0,mistake=0.5"
    assert set(often(judge, (paid(0.0), paid(0.99)), T, n=13)) == {EQUALLY_GOOD}
    assert set(often(judge, (paid(0.0), paid(-1.01)), T, n=29)) == {choice(True), choice(False)}


def test_a_myopic_judge_weighs_the_end_of_a_clip():
    T = hand_of(-2.0, 2.0, 1.0)
    early, late = paid(4.0, 0.0, 0.0), paid(0.0, 0.0, 1.5)
    assert asked("choice:myopic=0.7", (early, late), T) == choice(True)  # 4 * 0.49 = 1.96
    assert asked("choice:myopic=0.6", (early, late), T) == choice(False)  # 4 * 0.36 = 1.44
    assert (
        asked("choice:myopic=0.6,equal=1.2,skip=1", (early, late), T).form == "choice"
    )  # these go by the whole return


# Levels, sliders, ratings


@pytest.mark.parametrize(
    ("gap", "levels", "said"),
    [
        (0.0, 5, 0.0),
        (0.24, 5, 0.0),
        (0.26, 5, 1.0),
        (0.76, 5, 2.0),
        (-40.0, 5, -2.0),
        (-0.3, 3, 0.0),
        (0.1, 4, 0.5),
        (-0.7, 4, -1.5),
        (0.01, 2, 0.5),
        (-3.0, 2, -0.5),
    ],
)
def test_a_level_is_the_nearest_where_one_spread_is_the_top(gap, levels, said):
    T = hand_of(2.0, 8.0, 2.0, 8.0)  # spread 3
    assert asked(f"graded:levels={levels}", (paid(4.0 + 3 * gap), paid(4.0)), T) == level(said, levels)


@settings(max_examples=7)
@given(seeds)
def test_a_level_and_a_slider_hold_what_was_perceived_within_their_bounds(seed):
    (first, second), T = clips_and_hand(seed)
    steps = max(int(first.length), int(second.length))
    perceived = (true_return(first) - true_return(second)) / spread(T, steps)
    for name in ("graded", "graded:levels=2", "graded:levels=4", "slider"):
        low, high = asked(name, (first, second), T).bounds()
        assert low - 1e-6 <= perceived <= high + 1e-6


@pytest.mark.parametrize(("levels", "x", "two"), [(5, 0.25, {0, 1}), (2, 0.0, {-0.5, 0.5}), (4, 0.0, {-0.5, 0.5})])
def test_half_way_between_two_levels_either_is_said(levels, x, two):
    said = [nearest_level(x, levels, key=key) for key in jr.split(jr.key(2), 97)]
    assert set(said) == two and fits(said.count(max(two)), 97, 0.5)


def test_a_level_errs_by_noise_in_spreads():
    T = hand_of(2.0, 8.0, 2.0, 8.0)
    said = often("graded:levels=3,noise=0.4", (paid(4.9), paid(4.0)), T)  # perceived 0.3; the top begins at 0.5
    counts = [sum(answer.value == x for answer in said) for x in (-1, 0, 1)]
    edges = stats.norm(0.3, 0.4).cdf([-math.inf, -0.5, 0.5, math.inf])
    assert stats.chisquare(counts, np.diff(edges) * 211).pvalue > 1e-4


def test_a_mistaken_level_is_meant_the_other_way_round():
    T = hand_of(2.0, 8.0, 2.0, 8.0)
    said = often("graded:mistake=0.2", (paid(5.5), paid(4.0)), T)
    assert set(said) == {level(1, 5), level(-1, 5)} and fits(said.count(level(-1, 5)), 211, 0.2)


def test_a_slider_is_the_difference_in_spreads_up_to_its_end():
    T = hand_of(2.0, 8.0, 2.0, 8.0)
    assert asked("slider", (paid(5.2), paid(4.0)), T).value == pytest.approx(0.4)
    assert asked("slider", (paid(4.0), paid(9.0)), T) == slider(-1)
    values = [answer.value for answer in often("slider:noise=0.3", (paid(5.2), paid(4.0)), T)]
    assert max(values) == 1 and fits(sum(x < 0.4 for x in values), 211, 0.5)
    assert fits(sum(x < 0.1 for x in values), 211, stats.norm.cdf(-1))


@pytest.mark.parametrize(("g", "said"), [(5.0, 0), (6.5, 1), (2.0, -2), (4.5, 0), (80.0, 2)])
def test_a_rating_is_against_the_mean_at_hand(g, said):
    T = hand_of(2.0, 8.0, 2.0, 8.0)  # mean 5, spread 3
    assert asked("rating", (paid(g),), T) == rating(said, 5)


def test_a_rating_is_against_clips_of_the_same_length():
    T = set_of([paid(1.0, 1.0, 3.0, 3.0), paid(3.0, 5.0)])  # of two steps: 2, 6, 8; of four: 8 and, shorter, 8
    assert asked("rating:levels=9", (T.clip(Clip.at(1, 0, 2)),), T) == rating(4, 9)  # 8 is 1.07 spreads above 16/3
    assert asked("rating:levels=9", (T.clip(Clip.at(0, 2, 2)),), T) == rating(1, 9)  # 6 is 0.27 above
    assert asked("rating:levels=9", (T.get(0),), T) == rating(0, 9)


def test_to_fall_early_is_rated_by_what_a_whole_clip_returns():
    T = set_of([paid(1.0, 1.0, 1.0, 1.0), paid(1.0), paid(1.0, 1.0, 1.0), paid(1.0, 1.0, 1.0, 1.0)])  # 1 a step
    said = [checked(judge_from("rating"), (T.get(i),), T, steps=4, key=jr.key(0)).value for i in range(4)]
    assert said == [2, -2, 0, 2]  # 4, 1, 3 and 4, of mean 3 and spread 1.2
    assert checked(judge_from("rating"), (T.get(1),), T, key=jr.key(0)) == rating(0, 5)  # beside other single steps


def test_a_rating_errs_by_noise_in_spreads():
    T = hand_of(2.0, 8.0, 2.0, 8.0)
    said = often("rating:levels=2,noise=0.5", (paid(6.2),), T)  # 0.4 spreads above the mean
    assert fits(sum(answer.value > 0 for answer in said), 211, stats.norm.cdf(0.4 / 0.5))


# Rankings


def test_a_rational_ranking_is_in_the_order_of_the_returns():
    clips = [paid(x) for x in (3.0, -1.0, 7.0, 2.0, 5.0)]
    assert asked("ranking:k=5", clips, set_of(clips)) == ranking((2, 4, 0, 3, 1))
    assert asked("ranking:k=5", clips[:3], set_of(clips)) == ranking((2, 0, 1))  # what is there is ranked


def test_clips_that_are_the_same_come_in_any_order():
    clips = [paid(3.0), paid(3.0), paid(4.0)]
    said = often("ranking:k=3", clips, set_of(clips), n=97)
    assert set(said) == {ranking((2, 0, 1)), ranking((2, 1, 0))} and fits(said.count(ranking((2, 0, 1))), 97, 0.5)


def plackett_luce(order, u):
    """Probability of a ranking: the best is drawn by softmax, then the best of the rest, and so on."""
    return math.prod(math.exp(u[i]) / sum(math.exp(u[j]) for j in order[n:]) for n, i in enumerate(order))


def test_rankings_come_with_the_probabilities_of_plackett_and_luce():
    u, orders = np.array([0.0, 2.0, 1.0]), list(itertools.permutations(range(3)))
    said = [tuple(plackett_luce_order(u, 1.1, key=key).tolist()) for key in jr.split(jr.key(11), 797)]
    expected = [797 * plackett_luce(order, 1.1 * u) for order in orders]
    assert stats.chisquare([said.count(order) for order in orders], expected).pvalue > 1e-4


def test_of_two_clips_a_ranking_is_a_choice():
    clips, T = [paid(4.0), paid(6.0)], hand_of(2.0, 8.0, 2.0, 8.0)  # spread 3
    said = often("ranking:k=2,beta=1.7", clips, T)
    assert fits(said.count(ranking((1, 0))), 211, 1 / (1 + math.exp(-1.7 * 2 / 3)))


def test_a_mistaken_ranking_is_any_at_all():
    clips, T = [paid(x) for x in (4.0, 7.0, 5.2)], hand_of(2.0, 8.0, 2.0, 8.0)
    said = [answer.value for answer in often("ranking:k=3,mistake=0.6", clips, T)]
    orders = list(itertools.permutations(range(3)))
    expected = [211 * (0.1 + 0.4 * (order == (1, 2, 0))) for order in orders]
    assert stats.chisquare([said.count(order) for order in orders], expected).pvalue > 1e-4


# A judge of one's own


def test_a_judge_of_ones_own_sees_arrays_without_padding(pair, hand):
    seen = []
    judging = judge_from(lambda tau, other: seen.append((tau, other)) or 1.5)
    assert judging.form is None and judging.items == 2
    assert checked(judging, pair, hand, key=jr.key(0)) == number(1.5)
    (tau, other), n, m = seen[0], 5, 3
    assert tau.states.shape == (n + 1, p) and other.states.shape == (m + 1, p)
    assert tau.actions.shape == (n, q) and isinstance(tau.states, np.ndarray)
    assert np.isfinite(tau.states).all() and np.isfinite(other.actions).all()


def test_a_judge_of_ones_own_gives_any_kind_of_answer(pair, hand):
    first = lambda *clips: max(range(len(clips)), key=lambda i: clips[i].states[-1, 0])
    assert asked(lambda tau, other: choice(first(tau, other) == 0), pair, hand).form == "choice"
    assert asked(lambda tau, other: CANNOT_TELL, pair, hand) == CANNOT_TELL
    assert asked(lambda *clips: ranking(np.argsort([-c.states[0, 0] for c in clips])), pair * 2, hand).items == 4
    assert asked(lambda tau: rating(np.sign(tau.states[-1, 0]), 3), pair[:1], hand).form == "rating"


@pytest.mark.parametrize(
    "g", [2, 2.0, np.float32(2), np.array(2.0), np.int64(2), jnp.asarray(2.0), jnp.asarray(2)], ids=lambda g: repr(g)
)
def test_a_bare_number_of_any_kind_is_an_answer(pair, hand, g):
    answer = asked(lambda tau, other: g, pair, hand)
    assert answer == number(2.0) and type(answer.value) is float


@pytest.mark.parametrize(
    "g",
    [
        None,
        float("nan"),
        float("inf"),
        1e39,
        -(10**16),
        True,
        np.bool_(True),
        "2",
        np.ones(2),
        [1.0, [2.0]],
        1j,
        np.array([2.0]),
    ],
    ids=repr,
)
def test_what_is_no_answer_is_refused_in_three_parts(pair, hand, g):
    with pytest.raises(JudgeError) as caught:
        asked(lambda tau, other: g, pair, hand)
    message = str(caught.value)
    assert repr(g) in message and "one number is needed" in message and "Mend the judge" in message


def test_a_truth_value_in_jax_is_no_number_either(pair, hand):
    with pytest.raises(JudgeError, match="one number"):
        asked(lambda tau, other: jnp.asarray(True), pair, hand)


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        (1.5, 1),
        (1.5, 3),
        (choice(True), 3),
        (EQUALLY_GOOD, 1),
        (EQUALLY_GOOD, 3),
        (rating(0, 3), 2),
        (ranking((0, 1, 2)), 2),
        (ranking((0, 1)), 3),
    ],
    ids=repr,
)
def test_an_answer_has_to_be_about_the_clips_shown(pair, hand, given, shown):
    with pytest.raises(JudgeError) as caught:
        asked(lambda *clips: given, (pair * 2)[:shown], hand)
    message = str(caught.value)
    value = given.value if isinstance(given, Answer) else given
    assert repr(value) in message and f"clips shown was {shown}" in message
    assert "a ranking names each" in message and "Mend the judge" in message and "still open" in message


@pytest.mark.parametrize("shown", [1, 2, 4])
def test_one_can_be_unsure_about_any_number_of_clips(pair, hand, shown):
    assert asked(lambda *clips: CANNOT_TELL, (pair * 2)[:shown], hand) == CANNOT_TELL


@pytest.mark.parametrize("name", ["exact", "choice", "slider"])
def test_a_judge_of_pairs_has_no_answer_for_three(pair, hand, name):
    with pytest.raises(JudgeError, match="still open"):
        asked(name, (*pair, pair[0]), hand)


def test_a_judge_that_raises_is_reported_with_what_it_said(pair, hand):
    def broken(tau, other):
        raise KeyError("no such clip")

    with pytest.raises(JudgeError) as caught:
        asked(broken, pair, hand)
    message = str(caught.value)
    assert "KeyError" in message and "no such clip" in message
    assert "one number for two trajectories" in message and "still open" in message
    assert isinstance(caught.value.__cause__, KeyError)


def test_an_answer_that_does_not_exist_is_the_judges_fault(pair, hand):
    with pytest.raises(JudgeError, match=r"from -1 to 1.*still open"):
        asked(lambda tau, other: slider(7), pair, hand)


def test_stopping_by_hand_is_not_the_judges_fault(pair, hand):
    def stopped(tau, other):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        asked(stopped, pair, hand)


def test_a_judge_gets_its_own_key_and_all_that_is_at_hand(pair, hand):
    heard = []

    def answer(clips, T, *, steps, key):
        heard.append((clips, T))
        return float(jr.uniform(key))

    one = checked(Judging(answer=answer), pair, hand, key=jr.key(4))
    assert one.value == float(jr.uniform(jr.key(4))) and heard[0][0] is pair and heard[0][1] is hand


# Names and settings


@pytest.mark.parametrize("thing", [None, 3, ["exact"], "", "exakt", "Choice", ":", "exact "], ids=repr)
def test_a_judge_that_does_not_exist_is_refused_in_three_parts(thing):
    with pytest.raises(InputError) as caught:
        judge_from(thing)
    message = str(caught.value)
    assert repr(thing) in message and "--judge noisy:50" in message
    assert "a scripted judge is `exact`, `noisy:STD`, `choice:beta=B" in message and "`rating:" in message


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("exact:1", "'1'"),
        ("exact:std=1", "'std=1'"),
        ("noisy:std=1,std=2", "'std=2'"),
        ("noisy:beta=2", "'beta=2'"),
        ("choice:5", "'5'"),
        ("choice:beta=2,", "''"),
        ("choice:noise=1", "'noise=1'"),
        ("graded:beta=2", "'beta=2'"),
        ("slider:0.1", "'0.1'"),
        ("slider:levels=5", "'levels=5'"),
        ("rating:mistake=0.1", "'mistake=0.1'"),
    ],
)
def test_a_setting_that_a_judge_does_not_have_is_refused_in_three_parts(name, found):
    with pytest.raises(InputError) as caught:
        judge_from(name)
    message, scripted = str(caught.value), SCRIPTED[name.partition(":")[0]]
    assert f"got the judge {name!r} with the setting {found}" in message
    assert f"`{scripted.usage}` has {', '.join(scripted.settings) or 'no settings'}" in message
    assert f"`--judge {scripted.example}`" in message


@pytest.mark.parametrize(
    ("name", "needed"),
    [(f"noisy{x}", "the unit of the return, 0 or more") for x in ("", ":", ":-1", ":nan", ":inf", ":x", ":std=")]
    + [(f"choice:beta={x}", "0 or more, or inf") for x in ("-0.1", "nan", "x", "")]
    + [(f"choice:mistake={x}", "a probability, 0 to 1") for x in ("-0.1", "1.1", "nan")]
    + [(f"choice:{x}", "a number of spreads, 0 or more") for x in ("skip=-1", "equal=-0.2", "skip=inf", "equal=nan")]
    + [(f"choice:myopic={x}", "more than 0 and at most 1") for x in ("0", "1.01", "-1", "nan")]
    + [(f"graded:levels={x}", "a whole number, 2 to 1001") for x in ("1", "2.5", "nan", "x", "-3", "1002")]
    + [(f"ranking:k={x}", "a whole number, 2 to 8") for x in ("1", "9", "3.5", "inf")]
    + [(x, "a number of spreads") for x in ("graded:noise=-1", "slider:noise=inf", "rating:noise=x")],
)
def test_a_setting_that_does_not_fit_is_refused_in_three_parts(name, needed):
    with pytest.raises(InputError) as caught:
        judge_from(name)
    message, scripted = str(caught.value), SCRIPTED[name.partition(":")[0]]
    assert repr(name) in message and f"`{scripted.usage}`" in message and needed in message
    assert f"Say for example `--judge {scripted.example}`." in message


@pytest.mark.parametrize("name", SCRIPTED)
def test_the_examples_in_the_messages_work(name):
    assert isinstance(judge_from(SCRIPTED[name].example), Judging)


def test_all_settings_can_be_given_at_once():
    clips, T = clips_and_hand(23)
    assert asked("choice:beta=inf,mistake=0,skip=0,equal=0,myopic=1", clips, T) == asked("choice", clips, T)


def test_the_judge_leaves_the_clips_as_they_are(pair, hand):
    before = jax.tree.map(np.array, (pair, hand))
    for name in PAIRWISE:
        asked(name, pair, hand)
    for x, y in zip(jax.tree.leaves(before), jax.tree.leaves((pair, hand)), strict=True):
        np.testing.assert_array_equal(x, y)
