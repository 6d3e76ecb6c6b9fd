import json
import math

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiprl.data.answer import (
    CANNOT_TELL,
    EQUAL,
    EQUALLY_GOOD,
    FORMS,
    Answer,
    choice,
    level,
    number,
    ranking,
    rating,
    slider,
)
from hiprl.errors import InputError

finite = st.floats(allow_nan=False, allow_infinity=False)
scales = st.integers(2, 11).flatmap(lambda levels: st.tuples(st.integers(0, levels - 1), st.just(levels)))
comparisons = st.one_of(
    finite.map(number),
    st.booleans().map(choice),
    scales.map(lambda x: level(x[0] - (x[1] - 1) / 2, x[1])),
    st.floats(-1, 1).map(slider),
    st.sampled_from([EQUALLY_GOOD, CANNOT_TELL]),
)
answers = st.one_of(
    comparisons,
    scales.map(lambda x: rating(x[0] - (x[1] - 1) / 2, x[1])),
    st.integers(2, 8).flatmap(lambda k: st.permutations(range(k))).map(ranking),
)


def turned(answer):
    """The same said of the two clips the other way round."""
    return answer if answer.value is None else Answer(form=answer.form, value=-answer.value, levels=answer.levels)


@given(answers)
def test_json_gives_back_what_it_took(answer):
    assert Answer.read(json.loads(json.dumps(answer.plain(), allow_nan=False))) == answer


@given(comparisons)
def test_bounds_change_places_and_signs_when_the_clips_are_swapped(answer):
    low, high = answer.bounds()
    assert turned(answer).bounds() == (-high, -low)


@given(answers)
def test_what_was_said_lies_within_its_bounds(answer):
    low, high = answer.bounds()
    assert low <= high
    if isinstance(answer.value, int | float):
        step = 2 / (answer.levels - 1) if answer.levels else 1
        assert low <= answer.value * step <= high


@pytest.mark.parametrize("levels", [2, 3, 4, 5, 7])
def test_the_levels_share_the_whole_line_without_gap_or_overlap(levels):
    half = (levels - 1) / 2
    bounds = [level(i - half, levels).bounds() for i in range(levels)]
    assert bounds[0][0] == -math.inf and bounds[-1][1] == math.inf
    assert [high for _, high in bounds[:-1]] == [low for low, _ in bounds[1:]]


def test_equal_is_the_middle_one_of_five_levels():
    assert EQUALLY_GOOD.bounds() == level(0, 5).bounds() == (-EQUAL, EQUAL)


def test_two_levels_are_a_choice():
    assert level(0.5, 2).bounds() == choice(True).bounds() == (0, math.inf)
    assert level(-0.5, 2).bounds() == choice(False).bounds() == (-math.inf, 0)


def test_the_ends_of_a_slider_mean_that_much_or_more():
    assert slider(1).bounds() == (0.9, math.inf) and slider(-1).bounds() == (-math.inf, -0.9)
    assert slider(0.5).bounds() == (0.4, 0.6)


def test_who_cannot_tell_says_nothing():
    assert CANNOT_TELL.bounds() == ranking((1, 0)).bounds() == (-math.inf, math.inf)


def test_an_answer_knows_how_many_clips_it_is_about():
    assert rating(0, 3).items == 1 and ranking((2, 0, 1)).items == 3
    assert all(answer.items == 2 for answer in (number(3.5), choice(False), level(1, 5), slider(0), EQUALLY_GOOD))


FOREIGN = {
    "a number in JAX": (lambda: number(jnp.asarray(2.5)), 2.5),
    "a whole number in NumPy": (lambda: number(np.int64(7)), 7),
    "a slider in single precision": (lambda: slider(np.float32(0.5)), 0.5),
    "a level in NumPy": (lambda: level(np.array(-1.5), 4), -1.5),
    "a rating in JAX": (lambda: rating(jnp.asarray(1), 3), 1),
    "a choice in NumPy": (lambda: choice(np.bool_(True)), 1),
    "a choice in JAX": (lambda: choice(jnp.asarray(2.0) < 1.0), -1),
    "an array as a ranking": (lambda: ranking(np.argsort([0.3, -2.0, 5.0])), (1, 0, 2)),
    "a tuple of NumPy numbers": (lambda: ranking(tuple(np.array([1, 0]))), (1, 0)),
    "a list": (lambda: ranking([2, 0, 1]), (2, 0, 1)),
}


@pytest.mark.parametrize(("made", "value"), FOREIGN.values(), ids=FOREIGN)
def test_numbers_of_numpy_and_jax_become_plain(made, value):
    answer = made()
    assert answer.value == value
    plain = answer.value if isinstance(answer.value, tuple) else (answer.value,)
    assert all(type(x) in (int, float) for x in plain)
    json.dumps(answer.plain())


WRONG = [
    ("number", None, None, "a finite number is needed"),
    ("number", math.nan, None, "a finite number is needed"),
    ("number", math.inf, None, "a finite number is needed"),
    ("number", 10**400, None, "a finite number is needed"),
    ("number", True, None, "a finite number is needed"),
    ("number", "3", None, "a finite number is needed"),
    ("number", 3.0, 5, "a finite number is needed"),
    ("choice", 0, None, "1 for the first clip or -1"),
    ("choice", 0.5, None, "1 for the first clip or -1"),
    ("choice", True, None, "1 for the first clip or -1"),
    ("slider", 1.01, None, "from -1 to 1"),
    ("slider", (0.1,), None, "from -1 to 1"),
    ("level", 1, None, "2 to 1001 levels"),
    ("level", 0, 1, "2 to 1001 levels"),
    ("level", 0, True, "2 to 1001 levels"),
    ("level", 3, 5, "from -(levels - 1)/2"),
    ("level", 0.5, 5, "in steps of 1"),
    ("level", 1, 4, "in steps of 1"),
    ("rating", None, 5, "from -(levels - 1)/2"),
    ("rating", -2.5, 5, "from -(levels - 1)/2"),
    ("equal", 0, None, "`equal` has no value"),
    ("unsure", 0.0, None, "`unsure` has no value"),
    ("unsure", None, 5, "`unsure` has no value"),
    ("ranking", (0,), None, "the numbers of all clips"),
    ("ranking", (1, 2), None, "the numbers of all clips"),
    ("ranking", (0, 0), None, "the numbers of all clips"),
    ("ranking", (0.0, 1.0), None, "the numbers of all clips"),
    ("ranking", (True, False), None, "the numbers of all clips"),
    ("ranking", ((1,), 0), None, "the numbers of all clips"),
    ("ranking", ("a", 0), None, "the numbers of all clips"),
    ("better", 1, None, "the forms are number, choice"),
]


@pytest.mark.parametrize(("form", "value", "levels", "needed"), WRONG)
def test_what_is_no_answer_is_refused_in_three_parts(form, value, levels, needed):
    with pytest.raises(InputError) as caught:
        Answer(form=form, value=value, levels=levels)
    message = str(caught.value)
    assert repr(value) in message and repr(form) in message and needed in message and "Answer again." in message
    with pytest.raises(InputError, match="got the answer"):
        Answer.read({"form": form, "value": value, "levels": levels})


@pytest.mark.parametrize("first", [-1, 2, 0.7, math.nan, np.array([True, False])], ids=repr)
def test_a_choice_is_true_or_false(first):
    with pytest.raises(InputError, match="1 for the first clip or -1"):
        choice(first)


@pytest.mark.parametrize(
    "plain",
    [{}, {"value": 1}, {"form": None}, {"form": ["a"]}, {"form": "unsure", "judge": 1}, {"form": "number", "g": 1.5}],
    ids=repr,
)
def test_strange_entries_are_refused_in_three_parts(plain):
    with pytest.raises(InputError) as caught:
        Answer.read(plain)
    message = str(caught.value)
    assert "with the entries" in message and "it needs form" in message and "hiprl export" in message


def test_every_form_has_its_error():
    for form in FORMS:
        with pytest.raises(InputError, match="Answer again") as caught:
            Answer(form=form, value="nonsense")
        assert "the forms are" not in str(caught.value)
