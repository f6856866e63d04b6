"""A validation split: every view once, on one side, and never a test view."""

from __future__ import annotations

import pytest
from tiny import tiny_scene

from datasets import SceneError
from datasets.validation import hold_out_every


@pytest.mark.parametrize("every", [2, 3, 8])
def test_training_views_are_parted(every):
    scene = tiny_scene(views=17)
    split = hold_out_every(scene, every)
    names = [view.name for view in split.train + split.test]
    assert sorted(names) == sorted(view.name for view in scene.train)
    assert len(names) == len(set(names))
    assert len(split.test) == len(range(every // 2, 17, every))


def test_too_few_views():
    with pytest.raises(SceneError, match="scene.validation_every: expected at most the 3 training views, found 8"):
        hold_out_every(tiny_scene(views=3), 8)
