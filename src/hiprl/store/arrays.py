"""Arrays and pytrees of arrays as bytes, and back, bit for bit and without pickle."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any, TypeVar

import numpy as np

from hiprl.errors import StoreError

Tree = TypeVar("Tree")

_LONG_AGO = (1980, 1, 1, 0, 0, 0)  # equal trees give equal bytes, whatever the clock says


def array_to_bytes(array: Any) -> bytes:
    """An array, NumPy's or JAX's, as .npy bytes.

    Raises:
        StoreError: its dtype is neither boolean nor a number.
    """
    plain = np.asarray(array, order="C")
    if plain.dtype.kind not in "biufc":
        raise StoreError(
            f"got an array of dtype {plain.dtype}; only booleans and numbers can be stored. "
            "Turn it into numbers first, or leave it out."
        )
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, plain, allow_pickle=False)
    return buffer.getvalue()


def array_from_bytes(data: bytes) -> np.ndarray:
    """The array that `array_to_bytes` was given.

    Raises:
        StoreError: these bytes do not hold one.
    """
    try:
        return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # damaged bytes raise nearly anything
        raise StoreError(
            f"found {len(data)} bytes that cannot be read as an array ({error}); .npy bytes are needed. "
            "The store is damaged here: take it from a backup, or start a new run."
        ) from error


def pack(tree: Any) -> bytes:
    """All arrays of a pytree, NumPy's or JAX's, with their paths. Equal trees give equal bytes.

    Other leaves (functions, plain numbers) are left out: `unpack` takes them from its `like`.

    Raises:
        StoreError: a leaf is a typed random key, or holds something else than booleans or numbers.
    """
    index, parts = [], []
    for path, leaf in _array_leaves(tree):
        if _is_key(leaf):
            raise StoreError(
                f"found a typed random key at {path}; nothing random is stored but the run's seed. "
                "Make the key anew from the seed, and keep it out of the tree."
            )
        array = np.asarray(leaf)
        index.append({"path": path, "dtype": str(array.dtype), "shape": array.shape})
        # .npy has no name for the dtypes that JAX adds (bfloat16 ...): keep their bits.
        parts.append(array_to_bytes(array.view(f"u{array.itemsize}") if _is_added(array.dtype) else array))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_STORED) as archive:  # weights do not compress
        archive.writestr(zipfile.ZipInfo("index.json", _LONG_AGO), json.dumps(index))
        for i, part in enumerate(parts):
            archive.writestr(zipfile.ZipInfo(f"{i}.npy", _LONG_AGO), part)
    return buffer.getvalue()


def unpack(blob: bytes, like: Tree) -> Tree:
    """The tree that `pack` was given.

    Args:
        blob: what `pack` gave.
        like: a tree of the same structure. Its arrays say which path, dtype and shape is expected, and
            whether NumPy or JAX arrays come out; `jax.ShapeDtypeStruct` leaves do too, and give JAX arrays.
            All other leaves are in the result as they are here.

    Raises:
        StoreError: the bytes are damaged, or hold other paths, dtypes or shapes than `like`.
    """
    import jax  # here and below: it takes a second to import, and pages read no trees

    stored = _read(blob)
    expected = {path: f"{leaf.dtype}{list(leaf.shape)}" for path, leaf in _array_leaves(like)}
    found = {path: f"{dtype}{list(array.shape)}" for path, (dtype, array) in stored.items()}
    for path in [*expected, *found]:
        if expected.get(path) != found.get(path):
            raise StoreError(
                f"found {found.get(path, 'nothing')} stored at {path}, where "
                f"{expected.get(path, 'nothing')} is expected; arrays only fit the tree they came from. "
                "Use the configuration and the version of hiprl that the run began with."
            )

    def take(path: Any, leaf: Any) -> Any:
        if not _is_array(leaf):
            return leaf
        _, array = stored[jax.tree_util.keystr(path)]
        if _is_added(leaf.dtype):
            array = array.view(leaf.dtype)
        if isinstance(leaf, np.ndarray):
            return array
        return array[()] if isinstance(leaf, np.generic) else _to_jax(array)

    return jax.tree_util.tree_map_with_path(take, like)


def _read(blob: bytes) -> dict[str, tuple[str, np.ndarray]]:
    """Path of each array to its dtype and values."""
    try:
        with zipfile.ZipFile(io.BytesIO(blob)) as archive:
            index = json.loads(archive.read("index.json"))
            return {
                entry["path"]: (entry["dtype"], array_from_bytes(archive.read(f"{i}.npy")))
                for i, entry in enumerate(index)
            }
    except Exception as error:  # damaged archives raise nearly anything
        raise StoreError(
            f"found {len(blob)} bytes that cannot be read as packed arrays ({error}); what `pack` wrote is "
            "needed. The store is damaged here: take it from a backup, or start a new run."
        ) from error


def _to_jax(array: np.ndarray) -> Any:
    import jax.numpy as jnp

    result = jnp.asarray(array)
    if result.dtype != array.dtype:
        raise StoreError(
            f"found a stored array of {array.dtype} that JAX turns into {result.dtype}; to be read bit for "
            "bit it needs the setting it was written with. Set jax_enable_x64."
        )
    return result


def _array_leaves(tree: Any) -> list[tuple[str, Any]]:
    import jax

    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return [(jax.tree_util.keystr(path), leaf) for path, leaf in leaves if _is_array(leaf)]


def _is_array(leaf: Any) -> bool:
    import jax

    return isinstance(leaf, np.ndarray | np.generic | jax.Array | jax.ShapeDtypeStruct)


def _is_key(leaf: Any) -> bool:
    import jax

    return jax.numpy.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _is_added(dtype: Any) -> bool:
    """A number type that a library added to NumPy."""
    return np.dtype(dtype).isbuiltin == 2
