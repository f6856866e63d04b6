"""Changes to .npy and .npz files: values, types, shapes, memory orders, wrong headers; .safetensors headers."""

from __future__ import annotations

import io
import json
import re
import warnings

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

ODD_NUMBERS = (
    np.nan, np.inf, -np.inf, 0.0, -0.0, -1.0, 5e-324, 1e-40, 1e-12, 1e12, 1e18, 1e19, 1e38, 1e39, 1e154, 1e300,
)  # fmt: skip
ODD_TYPES = ("<f2", "<f4", ">f8", "<f8", "g", "<i1", "<i8", "<u8", "?", "<c16", "S3", "U3", "M8[s]", "O", "V4")
ODD_SHAPES = (
    "(-1, 17)", "(0, 17)", "(17,)", "()", "(99999999999, 17)", "(9223372036854775807, 17)", "(2, 3, 17)", "(1e3, 17)",
    "[3, 17]", "((3, 17), 2)", "(4, 17)",
)  # fmt: skip


def edit_npy(draw: DrawFn, content: bytes) -> bytes:
    """Changes the array, or its header alone."""
    if draw(st.integers(0, 3)) == 0:
        shape = draw(st.sampled_from(ODD_SHAPES)).encode()
        return re.sub(rb"'shape': \([^)]*\)", lambda _: b"'shape': " + shape, content, count=1)
    return _npy(edit_array(draw, np.load(io.BytesIO(content))))


def edit_npz(draw: DrawFn, content: bytes) -> bytes:
    """Changes, drops or renames one of the archive's arrays."""
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    name = draw(st.sampled_from(sorted(arrays)))
    kind = draw(st.sampled_from(("array", "array", "drop", "rename")))
    if kind == "array":
        arrays[name] = edit_array(draw, arrays[name])
    else:
        array = arrays.pop(name)
        if kind == "rename":
            arrays[draw(st.sampled_from(("a", "", "lenses", "../a", "points ")))] = array
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def edit_array(draw: DrawFn, array: np.ndarray) -> np.ndarray:
    """One to three changes."""
    for _ in range(draw(st.integers(1, 3))):
        kind = draw(st.sampled_from(("value", "value", "scale", "type", "shape", "order", "row")))
        if kind in ("value", "row") and array.size and array.dtype.kind == "f":
            array = array.copy()
            place = draw(st.integers(0, array.size - 1))
            odd = draw(st.sampled_from(ODD_NUMBERS) | st.floats())
            with np.errstate(all="ignore"):
                if kind == "value":
                    array.flat[place] = odd
                else:
                    array[place % len(array)] = odd
        elif kind == "scale" and array.dtype.kind == "f":
            with np.errstate(all="ignore"):
                array = array * draw(st.sampled_from((-1, 0, 1.001, 1e10, 1e-10)))
        elif kind == "type":
            array = _as_type(array, draw(st.sampled_from(ODD_TYPES)))
        elif kind == "shape":
            array = draw(
                st.sampled_from(
                    (
                        array[:-1],
                        array[:0],
                        array.ravel(),
                        array[None],
                        array.T,
                        np.concatenate([array, array]) if array.ndim else array,
                    )
                )
            )
        elif kind == "order":
            array = np.asfortranarray(array)
    return array


def _as_type(array: np.ndarray, kind: str) -> np.ndarray:
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            return array.astype(kind)
        except (TypeError, ValueError):
            return array


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def split_header(content: bytes) -> tuple[dict, bytes]:
    """The header of a .safetensors file, and its data."""
    end = 8 + int.from_bytes(content[:8], "little")
    return json.loads(content[8:end]), content[end:]


def join_header(header: str, behind: bytes) -> bytes:
    raw = header.encode("utf-8", "surrogatepass")
    return len(raw).to_bytes(8, "little") + raw + behind
