"""Background models small enough for runs of 60 iterations."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from pipeline.training import schedule, state


@pytest.fixture
def small_backgrounds() -> Iterator[None]:
    """Background models are trained for 20 iterations, and the environment map has 12 rows. Forked processes too."""
    with pytest.MonkeyPatch.context() as patch:  # of its own: a test may undo those of `monkeypatch`
        patch.setattr(schedule, "SPHERE_FREEZE_AFTER", 20)
        patch.setattr(schedule, "MAP_UNTIL", 20)
        patch.setattr(state, "MAP_HEIGHT", 12)
        yield
