"""A validation split: every view once, on one side, and never a test view."""

from __future__ import annotations

import pytest
from tiny import tiny_scene

from datasets import SceneError
from datasets.validation import hold_out_every, hold_out_outermost


@pytest.mark.parametrize("every", [2, 3, 8])
def test_training_views_are_parted(every):
    scene = tiny_scene(views=17)
    split = hold_out_every(scene, every)
    names = [view.name for view in split.train + split.test]
    assert sorted(names) == sorted(view.name for view in scene.train)
    assert len(names) == len(set(names))
    assert len(split.test) == len(range(every // 2, 17, every))


def test_the_outermost_look_from_the_ends_of_the_arc():
    scene = tiny_scene(views=16)  # four places on an arc, the outer two as far from its middle as each other
    split = hold_out_outermost(scene, 2)
    assert len(split.test) == 8 and len(split.train) == 8
    turned = [abs(view.camera.world_to_cam[2, 0]) for view in split.test + split.train]
    assert min(turned[:8]) > max(turned[8:])


def test_too_few_views():
    with pytest.raises(SceneError, match="scene.validation_every: expected at most the 3 training views, found 8"):
        hold_out_every(tiny_scene(views=3), 8)
