from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from hiprl.errors import StoreError
from hiprl.store.arrays import array_from_bytes, array_to_bytes, pack, unpack

DTYPES = ["?", "i1", "i4", "i8", "u1", "u4", "f2", "f4", "f8", "c8", ">f4"]


class Layer(eqx.Module):
    w: jax.Array
    activation: Callable
    depth: int


def arrays(dtypes: list[str] = DTYPES) -> st.SearchStrategy[np.ndarray]:
    shapes = npst.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4)
    return st.sampled_from(dtypes).flatmap(lambda dtype: npst.arrays(dtype, shapes))


def trees(leaves: st.SearchStrategy) -> st.SearchStrategy:
    return st.recursive(
        leaves,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.tuples(inner, inner)
            | st.dictionaries(st.text(max_size=3), inner, max_size=3)
        ),
        max_leaves=5,
    )


def bits(tree: Any) -> Any:
    """What two trees must share to be the same: structure, and type, dtype, shape and bits of each leaf."""
    leaves, structure = jax.tree.flatten(tree)
    return structure, [(x.dtype, x.shape, np.asarray(x).tobytes()) for x in leaves]


def zeros(tree: Any) -> Any:
    return jax.tree.map(np.zeros_like, tree)


@given(arrays())
def test_an_array_comes_back_bit_for_bit(array: np.ndarray):
    back = array_from_bytes(array_to_bytes(array))
    assert bits(back) == bits(array)


@given(trees(arrays()))
def test_a_tree_of_numpy_arrays_comes_back_bit_for_bit(tree: Any):
    back = unpack(pack(tree), zeros(tree))
    assert bits(back) == bits(tree)
    assert all(type(leaf) is np.ndarray for leaf in jax.tree.leaves(back))


@settings(max_examples=15)
@given(trees(arrays(["?", "i4", "f4"])))
def test_a_tree_of_jax_arrays_comes_back_from_its_shapes_alone(tree: Any):
    tree = jax.tree.map(jnp.asarray, tree)
    back = unpack(pack(tree), jax.eval_shape(lambda: tree))
    assert bits(back) == bits(tree)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(back))


def test_nan_with_its_payload_and_minus_zero_survive():
    odd = np.array([0x7FC00123, 0xFFC00001, 0x80000000, 0x00000001], np.uint32).view(np.float32)
    assert bits(unpack(pack({"x": odd}), {"x": zeros(odd)})) == bits({"x": odd})
    through_jax = unpack(pack({"x": odd}), {"x": jax.ShapeDtypeStruct((4,), np.float32)})
    assert bits(through_jax) == bits({"x": odd})


def test_bfloat16_survives():
    tree = [jnp.array([[1.5, -0.0, jnp.nan]], jnp.bfloat16), jnp.array(3, jnp.bfloat16)]
    back = unpack(pack(tree), jax.tree.map(jnp.zeros_like, tree))
    assert bits(back) == bits(tree)


def test_numpy_scalars_stay_scalars():
    back = unpack(pack({"n": np.int32(5)}), {"n": np.int32(0)})
    assert type(back["n"]) is np.int32
    assert back["n"] == 5


def test_a_module_keeps_the_functions_and_numbers_of_its_like():
    written = Layer(jnp.arange(6.0).reshape(2, 3), jnp.tanh, 7)
    like = Layer(jnp.zeros((2, 3)), jnp.sin, 8)
    back = unpack(pack(written), like)
    assert bits(back.w) == bits(written.w)
    assert (back.activation, back.depth) == (jnp.sin, 8)


@given(trees(arrays()))
def test_equal_trees_give_equal_bytes(tree: Any):
    assert pack(tree) == pack(jax.tree.map(lambda array: array.copy(order="F"), tree))


@given(st.data())
def test_a_damaged_byte_is_found_or_harmless(data: st.DataObject):
    tree = {"w": np.arange(6, dtype=np.float32).reshape(2, 3), "n": np.array(3)}
    blob = bytearray(pack(tree))
    blob[data.draw(st.integers(0, len(blob) - 1))] ^= data.draw(st.integers(1, 255))
    with suppress(StoreError):
        assert bits(unpack(bytes(blob), zeros(tree))) == bits(tree)


def test_bytes_that_are_no_arrays_are_refused():
    for broken in (b"", b"no archive", pack({"x": np.zeros(9)})[:-30]):
        with pytest.raises(StoreError, match=r"found \d+ bytes .*is needed\. The store is damaged"):
            unpack(broken, {"x": np.zeros(9)})
    with pytest.raises(StoreError, match=r"found \d+ bytes .*are needed\. The store is damaged"):
        array_from_bytes(array_to_bytes(np.zeros(9))[:-1])


@pytest.mark.parametrize(
    ("like", "message"),
    [
        ({"w": np.zeros((2, 5), "f4")}, r"found float32\[2, 3\] stored at \['w'\], where float32\[2, 5\]"),
        ({"w": np.zeros((2, 3), "f8")}, r"found float32\[2, 3\] stored at \['w'\], where float64\[2, 3\]"),
        (
            {"w": np.zeros((2, 3), "f4"), "b": np.zeros(3)},
            r"found nothing stored at \['b'\], where float64\[3\]",
        ),
        ({}, r"found float32\[2, 3\] stored at \['w'\], where nothing is expected"),
        ({"w": 1.0}, r"found float32\[2, 3\] stored at \['w'\], where nothing is expected"),
    ],
)
def test_another_structure_is_refused_with_the_leaf_and_both_shapes(like: Any, message: str):
    with pytest.raises(StoreError, match=message + r".* Use the configuration"):
        unpack(pack({"w": np.ones((2, 3), np.float32)}), like)


def test_a_typed_key_is_refused():
    with pytest.raises(StoreError, match=r"typed random key at \['key'\]; .* Make the key anew"):
        pack({"key": jr.key(3)})


@pytest.mark.parametrize("array", [np.array(["a"]), np.array([object()]), np.array([1], "M8[s]")])
def test_what_is_no_number_is_refused(array: np.ndarray):
    with pytest.raises(StoreError, match=r"got an array of dtype .* only booleans and numbers .* Turn it into"):
        pack([array])


def test_float64_is_not_narrowed_by_jax():
    with pytest.raises(StoreError, match=r"float64 that JAX turns into float32; .* Set jax_enable_x64"):
        unpack(pack([np.zeros(3)]), [jax.ShapeDtypeStruct((3,), np.float64)])
