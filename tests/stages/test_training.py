"""The stage that trains: its warning where nearly nothing is left."""

from __future__ import annotations

import pytest

from pipeline.stages.training import few_left


@pytest.mark.parametrize("left, warned", [(53, True), (199, True), (200, False), (4000, False), (40_000, False)])
def test_a_model_of_which_nearly_nothing_is_left_is_warned_of(left: int, warned: bool) -> None:
    assert (
        few_left(left, 20_000) == f"{left} of 20000 initial Gaussians are left: the poses or the times may not be "
        "those of the images"
    ) == warned
    assert (few_left(left, 20_000) is None) != warned
