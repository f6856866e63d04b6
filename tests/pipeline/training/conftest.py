"""Fixtures of the tests of training."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tiny import small_background_models


@pytest.fixture
def small_backgrounds() -> Iterator[None]:
    with small_background_models():
        yield
