"""Names of a pattern are those that bash expands it to."""

from __future__ import annotations

import subprocess

from hypothesis import given, settings
from hypothesis import strategies as st

from datasets.files.numbered_names import expanded, ranges

NAMES = st.builds(
    "{}{:0{}}{}".format,
    st.sampled_from(["", "a/r_", "cam1/f ", "../p"]),
    st.integers(0, 120),
    st.integers(1, 3),
    st.sampled_from(["", ".png", ".mp4", "_x.b"]),
)


@settings(derandomize=True, database=None)
@given(st.lists(NAMES, unique=True).map(sorted))
def test_patterns_have_every_name_once(names: list[str]) -> None:
    found = ranges(names)
    assert [name for pattern in found for name in expanded(pattern)] == names
    assert found == {pattern: expanded(pattern) for pattern in found}


def test_a_pattern_is_that_of_bash() -> None:
    names = ["a/r_008.png", "a/r_009.png", "a/r_010.png", "a/r_012.png", "b.mp4"]
    patterns = ["a/r_{008..010}.png", "a/r_012.png", "b.mp4"]
    assert list(ranges(names)) == patterns
    assert subprocess.check_output(["bash", "-c", f"echo {' '.join(patterns)}"], text=True).split() == names
