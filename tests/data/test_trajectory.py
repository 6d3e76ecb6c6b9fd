import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiprl.data.trajectory import trajectory_from
from hiprl.errors import InputError
from tests.data.samples import H, lengths, p, q, seeds, trajectory


@given(seeds, lengths, st.booleans())
def test_transitions_ignore_what_lies_past_the_end(seed, n, terminated):
    rows = [
        trajectory(np.random.default_rng(seed), length=n, terminated=terminated, padding=padding).transitions()
        for padding in (np.nan, 0.0, 1e30)
    ]
    for leaf, *others in zip(*map(jax.tree.leaves, rows), strict=True):
        assert np.isfinite(leaf).all()
        for other in others:
            np.testing.assert_array_equal(leaf, other)


@given(seeds, lengths)
def test_transitions_are_the_steps_one_after_the_other(seed, n):
    tau = trajectory(np.random.default_rng(seed), length=n)
    rows, tau = jax.tree.map(np.asarray, (tau.transitions(), tau))
    assert rows.mask.shape == (H,) and int(rows.mask.sum()) == n
    for t in range(n):
        np.testing.assert_array_equal(rows.s[t], tau.states[t])
        np.testing.assert_array_equal(rows.a[t], tau.actions[t])
        np.testing.assert_array_equal(rows.s_next[t], tau.states[t + 1])


@given(seeds, lengths, st.booleans())
def test_only_the_last_step_can_have_ended_the_episode(seed, n, terminated):
    rows = trajectory(np.random.default_rng(seed), length=n, terminated=terminated).transitions()
    np.testing.assert_array_equal(rows.terminated, [terminated and t == n - 1 for t in range(H)])


@given(seeds, lengths)
def test_the_true_return_leaves_out_the_padding(seed, n):
    tau = trajectory(np.random.default_rng(seed), length=n)
    np.testing.assert_allclose(float(tau.true_return), np.asarray(tau.rewards, float)[:n].sum(), atol=2e-5)


@given(seeds, lengths, st.booleans())
def test_what_a_judge_sees_can_be_recorded_again(seed, n, terminated):
    tau = trajectory(np.random.default_rng(seed), length=n, terminated=terminated, padding=0.0)
    seen = tau.seen()
    assert seen.states.shape == (n + 1, p) and seen.actions.shape == (n, q) and seen.rewards.shape == (n,)
    assert all(isinstance(x, np.ndarray) for x in (seen.states, seen.actions, seen.rewards))
    again = trajectory_from(seen.states, seen.actions, H=H, terminated=terminated, rewards=seen.rewards)
    for old, new in zip(jax.tree.leaves(tau), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(old, new)
        assert old.dtype == new.dtype


def test_without_rewards_nothing_was_paid():
    tau = trajectory_from(np.ones((4, p)), np.ones((3, q)), H=H, terminated=False)
    assert np.isnan(tau.rewards[:3]).all()
    assert jnp.isnan(tau.true_return)


def message_of(states, actions, **rest):
    with pytest.raises(InputError) as caught:
        trajectory_from(states, actions, H=H, terminated=False, **rest)
    return str(caught.value)


def test_states_that_do_not_fit_the_actions_are_refused_in_three_parts():
    message = message_of(np.ones((3, p)), np.ones((3, q)))
    assert "(3, 3)" in message and "(3, 2)" in message  # found
    assert f"(n + 1, p) and (n, q) with 1 <= n <= H = {H}" in message  # needed
    assert "the last one" in message  # how to mend it


@pytest.mark.parametrize(
    ("states", "actions"),
    [
        (np.ones((H + 2, p)), np.ones((H + 1, q))),
        (np.ones((1, p)), np.ones((0, q))),
        (np.ones(4), np.ones((3, q))),
        (np.ones((4, p)), 0.5),
    ],
    ids=["too long", "empty", "flat states", "one number"],
)
def test_shapes_without_a_meaning_are_refused(states, actions):
    assert "a trajectory needs" in message_of(states, actions)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_values_that_are_not_finite_are_refused_in_three_parts(bad):
    states, actions = np.ones((4, p)), np.ones((3, q))
    states[2, 1] = bad
    message = message_of(states, actions)
    assert "not finite" in message and "real numbers" in message and "Cut the trajectory" in message
    assert "not finite" in message_of(np.ones((4, p)), np.full((3, q), bad))


def test_rewards_that_do_not_fit_are_refused_in_three_parts():
    message = message_of(np.ones((4, p)), np.ones((3, q)), rewards=np.ones(4))
    assert "(4,)" in message and "one reward an action" in message and "Leave rewards out" in message


def test_text_in_place_of_numbers_is_refused():
    assert "a trajectory needs" in message_of(np.array([["up"], ["down"]]), np.ones((1, q)))
