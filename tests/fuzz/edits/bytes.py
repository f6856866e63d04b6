"""Changes to bytes, to lines of text, and to the files of a folder."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import PurePath

from hypothesis import strategies as st
from hypothesis.strategies import DrawFn, SearchStrategy

from fuzz.target import Changes, Files

Edit = Callable[[DrawFn, bytes], bytes]  # draws a change and applies it

ODD_BYTES = (
    b"", b"\x00", b"\xff", b"\xff\xff\xff\xff", b"\x00\x00\x00\x80", b"\xff\xff\xff\x7f", b"\x7f\xc0\x00\x00", b"\n",
    b"\r\n", b"\xef\xbb\xbf", b"\xed\xa0\x80", b"\x1b[31m", b"PK\x03\x04", b"\x89PNG\r\n\x1a\n",
)  # fmt: skip
ODD_WORDS = (
    "", "nan", "inf", "-inf", "null", "true", "0", "-1", "-0.0", "1e400", "5e-324", "1e308", "-1e308", "0x10",
    "1_000", "99999999999999999999", "9" * 5000, "1e", ".", "/", "..", "~", "\x00", "\x1b[2J", "\u2028", "٣", "'",
    '"', "#", "[", "{", "&a [*a]", "*a", "!!python/object:os.system", "${a}", "%", "x" * 5000, "list", "\ufeff",
    "a\tb", "-", "?", "|",
)  # fmt: skip


_OF_BYTES = st.sampled_from(("bytes",) * 6 + ("missing", "empty", "another"))
_OF_STRUCTURE = st.sampled_from(("structure",) * 14 + ("bytes",) * 3 + ("missing", "empty", "another"))
_PIECES = st.sampled_from(ODD_BYTES) | st.binary(max_size=8)
_WORDS = st.sampled_from(ODD_WORDS) | st.text(max_size=5) | st.floats().map(repr) | st.integers().map(str)


def edit_bytes(draw: DrawFn, content: bytes) -> bytes:
    """One to four times overwrites, deletes, inserts or repeats bytes, or truncates."""
    for _ in range(draw(st.integers(1, 4))):
        place = draw(st.integers(0, len(content)))
        kind = draw(st.sampled_from(("set", "drop", "insert", "repeat", "cut")))
        if kind == "cut":
            content = content[:place]
            continue
        length = draw(st.integers(0, 16))
        piece = draw(_PIECES)
        behind = {
            "set": content[place + len(piece) :],
            "drop": content[place + length :],
            "insert": content[place:],
            "repeat": content[place : place + length] * draw(st.sampled_from((1, 2, 50))) + content[place:],
        }[kind]
        content = content[:place] + (piece if kind in ("set", "insert") else b"") + behind
    return content


def edit_text(draw: DrawFn, content: bytes) -> bytes:
    """One to three times drops or repeats a line, or replaces a word."""
    lines = content.decode("utf-8", "surrogateescape").split("\n")
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, max(0, len(lines) - 1)))
        line = lines[place] if lines else ""
        kind = draw(st.sampled_from(("word", "drop", "repeat", "insert")))
        if kind == "drop":
            del lines[place : place + 1]
        elif kind == "repeat":
            lines[place:place] = [line] * draw(st.sampled_from((1, 2, 40)))
        else:
            word = draw(_WORDS)
            words = list(re.finditer(r"[^\s,:]+", line))
            if kind == "insert" or not words:
                lines.insert(place, word)
            else:
                chosen = draw(st.sampled_from(words))
                lines[place] = line[: chosen.start()] + word + line[chosen.end() :]
    return "\n".join(lines).encode("utf-8", "surrogateescape")


def changed_files(example: Files, edits: dict[str, Edit]) -> SearchStrategy[Changes]:
    """Changes one or two files of the example: missing, empty, with the content of another file, or edited.

    edits: suffix -> edit that knows the file's structure. All files can also be edited as bytes.
    """
    names = [name for name in sorted(example) for _ in range(4 if PurePath(name).suffix in edits else 1)]
    chosen = st.lists(st.sampled_from(names), min_size=1, max_size=2, unique=True)

    @st.composite
    def changes(draw: DrawFn) -> Changes:
        return {name: _one(draw, name, example, edits) for name in draw(chosen)}

    return changes()


def _one(draw: DrawFn, name: str, example: Files, edits: dict[str, Edit]) -> bytes | None:
    by_suffix = edits.get(PurePath(name).suffix)
    kind = draw(_OF_BYTES if by_suffix is None else _OF_STRUCTURE)
    if kind == "missing":
        return None
    if kind == "empty":
        return b""
    if kind == "another":
        return example[draw(st.sampled_from(sorted(example)))]
    return (edit_bytes if kind == "bytes" else by_suffix)(draw, example[name])
