import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hiprl.data.preference import Clip
from tests.data.samples import H, N, clean, lengths, p, seeds, set_of, trajectory

several = st.lists(lengths, min_size=1, max_size=N)


def taus_of(seed, ns):
    rng = np.random.default_rng(seed)
    return [trajectory(rng, length=n, terminated=n % 2 == 0) for n in ns]


@settings(max_examples=10)
@given(seeds, several)
def test_what_was_added_comes_back(seed, ns):
    taus = taus_of(seed, ns)
    T = set_of(taus)
    assert int(T.count) == len(ns) and int(T.last) == len(ns) - 1 and T.capacity == N
    np.testing.assert_array_equal(T.filled, np.arange(N) < len(ns))
    for i, tau in enumerate(taus):
        for put, got in zip(jax.tree.leaves(tau), jax.tree.leaves(T.get(jnp.asarray(i))), strict=True):
            np.testing.assert_array_equal(put, got)


@settings(max_examples=10)
@given(seeds, several)
def test_transitions_are_those_of_each_trajectory_in_turn(seed, ns):
    taus = taus_of(seed, ns)
    rows = jax.tree.map(np.asarray, set_of(taus).transitions())
    assert rows.mask.shape == (N * H,) and int(rows.mask.sum()) == sum(ns)
    seen = np.asarray(rows.mask)
    np.testing.assert_array_equal(
        rows.s[seen], np.concatenate([np.asarray(tau.states)[:n] for tau, n in zip(taus, ns, strict=True)])
    )
    np.testing.assert_array_equal(
        rows.a[seen], np.concatenate([np.asarray(tau.actions)[:n] for tau, n in zip(taus, ns, strict=True)])
    )
    np.testing.assert_array_equal(
        rows.s_next[seen], np.concatenate([np.asarray(tau.states)[1 : n + 1] for tau, n in zip(taus, ns, strict=True)])
    )
    assert int(rows.terminated[seen].sum()) == sum(n % 2 == 0 for n in ns)


@settings(max_examples=10)
@given(seeds, several)
def test_padding_changes_nothing_that_is_read(seed, ns):
    T = set_of(taus_of(seed, ns))
    other = clean(T)
    read = lambda T: (T.transitions(), T.box(margin=0.3), T.first_states(), T.seen())
    for x, y in zip(jax.tree.leaves(read(T)), jax.tree.leaves(read(other)), strict=True):
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x, y)


@settings(max_examples=10)
@given(seeds, several, st.floats(0, 2))
def test_the_box_holds_all_states_seen_and_its_margin(seed, ns, margin):
    taus = taus_of(seed, ns)
    low, high = set_of(taus).box(margin=margin)
    seen = np.concatenate([np.asarray(tau.states)[: n + 1] for tau, n in zip(taus, ns, strict=True)])
    width = seen.max(0) - seen.min(0)
    np.testing.assert_allclose(low, seen.min(0) - margin * width, atol=1e-5)
    np.testing.assert_allclose(high, seen.max(0) + margin * width, atol=1e-5)


def test_the_box_holds_what_else_it_is_told_of():
    T = set_of(taus_of(3, [5, 2]))
    low, high = (np.asarray(end) for end in T.box(margin=0.0))
    also = jnp.stack([low - 3, (low + high) / 2])
    np.testing.assert_array_equal(T.box(margin=0.0, also=also)[0], also[0])
    np.testing.assert_array_equal(T.box(margin=0.0, also=also)[1], high)
    np.testing.assert_allclose(T.box(margin=0.5, also=also)[1], high + 0.5 * (high - also[0]), rtol=1e-5)


@settings(max_examples=10)
@given(seeds, several)
def test_first_states_are_where_episodes_began(seed, ns):
    taus = taus_of(seed, ns)
    first = np.asarray(set_of(taus).first_states())
    np.testing.assert_array_equal(first, [np.asarray(taus[i % len(ns)].states)[0] for i in range(N)])


@settings(max_examples=10)
@given(seeds, st.lists(st.tuples(lengths, st.booleans()), min_size=1, max_size=N))
def test_the_world_is_learned_from_what_was_executed(seed, kinds):
    taus = [
        eqx.tree_at(lambda tau: tau.imagined, tau, jnp.asarray(imagined))
        for tau, (_, imagined) in zip(taus_of(seed, [n for n, _ in kinds]), kinds, strict=True)
    ]
    T, imagined = set_of(taus), np.array([dream for _, dream in kinds])
    np.testing.assert_array_equal(T.real, [*~imagined, *[False] * (N - len(kinds))])
    rows = jax.tree.map(np.asarray, T.executed().transitions())
    assert int(rows.mask.sum()) == sum(n for n, dream in kinds if not dream)
    real = [np.asarray(tau.states)[:n] for tau, (n, dream) in zip(taus, kinds, strict=True) if not dream]
    np.testing.assert_array_equal(rows.s[rows.mask], np.concatenate([np.zeros((0, p)), *real]))
    assert int(T.transitions().mask.sum()) == sum(n for n, _ in kinds)  # but all may be asked about
    for i, dream in enumerate(imagined):
        assert bool(T.clip(Clip.at(i, 0, 2)).imagined) == bool(T.clip(Clip.at(i, 0, 2)).seen().imagined) == dream
