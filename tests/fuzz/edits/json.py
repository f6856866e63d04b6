"""Changes to JSON: values replaced, keys dropped or renamed, items repeated; the result is nearly always JSON."""

from __future__ import annotations

import copy
import json
from typing import Any

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

# As text, because some of them are no Python values.
ODD_JSON = (
    "null", "true", "false", "0", "-0.0", "-1", "1", "2", "0.5", "1e-320", "5e-324", "1e-30", "1e12", "1e18", "1e38",
    "1e39", "1e154", "1e308", "-1e308", "1e999", "NaN", "Infinity", "-Infinity", "4294967296", "9223372036854775808",
    "1" + "0" * 400, "9" * 5000, '""', '"."', '"/"', '".."', '"../.."', '"\\u0000"', '"\\ud800"', '"a\\nb"',
    '"\\u001b[31m"', '"\\u2028"', '"1.5"', '"٣"', '"' + "x" * 300 + '"', '"' + "x/" * 3000 + '"', "[]", "{}", "[[]]",
    "[null]", '{"a": 1}', "[" * 3000 + "]" * 3000, "[" * 200_000,
)  # fmt: skip
_PLACE = "@@{}@@"  # placeholder for a text in the serialised JSON
_TEXTS = st.sampled_from(ODD_JSON) | (st.floats() | st.text(max_size=4)).map(json.dumps)
_KINDS = st.sampled_from(("odd", "odd", "odd", "odd", "number", "number", "drop", "repeat", "rename", "swap"))
_NUMBERS = st.floats() | st.integers()
_FACTORS = st.sampled_from((-1, 0, 1 + 1e-9, 1.001, 1.1, 2, 1e3, 1e10, 1e-10))


def edit_json(draw: DrawFn, content: bytes) -> bytes:
    """One to three changes."""
    return edit_tree(draw, json.loads(content)).encode("utf-8", "surrogatepass")


def edit_tree(draw: DrawFn, tree: Any) -> str:
    """The changed tree as JSON text."""
    holder, texts = {"": copy.deepcopy(tree)}, []
    for _ in range(draw(st.integers(1, 3))):
        parent, key = _place(draw, holder)
        kind = draw(_KINDS)
        if kind == "drop" and parent is not holder:
            del parent[key]
        elif kind == "repeat" and isinstance(parent, list):
            parent[key:key] = [copy.deepcopy(parent[key])] * draw(st.sampled_from((1, 2, 30)))
        elif kind == "rename" and isinstance(parent, dict) and parent is not holder:
            parent[draw(st.text(max_size=3))] = parent.pop(key)
        elif kind == "swap":
            other, there = _place(draw, holder)
            parent[key] = copy.deepcopy(other[there])
        elif kind == "number":
            value = parent[key]
            if isinstance(value, (int, float)) and not isinstance(value, bool):  # close to the old value
                parent[key] = value * draw(_FACTORS)
            else:
                parent[key] = draw(_NUMBERS)
        else:
            parent[key] = _PLACE.format(len(texts))
            texts.append(draw(_TEXTS))
    text = json.dumps(holder[""])
    for number, odd in enumerate(texts):
        text = text.replace(json.dumps(_PLACE.format(number)), odd)
    return text


def _place(draw: DrawFn, holder: dict) -> tuple[Any, Any]:
    """(container, key or index) of a random value in the tree."""
    container, key = holder, ""
    while isinstance(inside := container[key], (dict, list)) and inside and draw(st.integers(0, 7)) != 3:
        keys = list(inside) if isinstance(inside, dict) else range(len(inside))
        container, key = inside, keys[draw(st.integers(0, len(keys) - 1))]
    return container, key
