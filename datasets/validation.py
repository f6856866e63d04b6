"""Validation splits: training views held out in place of the test views, to select settings by validation."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np

from datasets.files.errors import SceneError
from datasets.scene import Scene, camera_extent


def hold_out_every(scene: Scene, every: int) -> Scene:
    """The scene with the training views every//2, every//2 + every, … as its test views.

    The other training views keep their order, and the extent is theirs. Raises SceneError if a split would be empty.
    For photographs only: in multi-camera videos `scene.test_cameras` holds out another camera.
    """
    return _hold_out(scene, set(range(every // 2, len(scene.train), every)), every)


def hold_out_poses(scene: Scene, every: int) -> Scene:
    """Like hold_out_every, for distinct camera poses: every `every`-th pose is held out with all its views.

    With one moving camera every view has its own pose. With several static cameras whole cameras are held out.
    """
    poses = dict.fromkeys(view.camera.world_to_cam.tobytes() for view in scene.train)
    chosen = set(list(poses)[every // 2 :: every])
    return _hold_out(
        scene, {index for index, view in enumerate(scene.train) if view.camera.world_to_cam.tobytes() in chosen}, every
    )


def hold_out_outermost(scene: Scene, every: int) -> Scene:
    """Like hold_out_every, but as many of the views whose viewing directions are farthest from the mean direction.

    For cameras on a hemisphere these are the lowest ones. They show geometry that the other views do not constrain,
    which a view between training views hides.
    """
    forward = np.stack([view.camera.world_to_cam[2, :3] for view in scene.train])
    along = forward @ forward.mean(axis=0)
    count = len(range(every // 2, len(scene.train), every))
    outermost = set(np.argsort(along, kind="stable")[:count].tolist())
    return _hold_out(scene, outermost, every, f"the {count} outermost")


def _hold_out(scene: Scene, chosen: Set[int], every: int, rule: str | None = None) -> Scene:
    """rule: what was held out, for tables; None: every `every`-th view."""
    held_out = tuple(view for index, view in enumerate(scene.train) if index in chosen)
    kept = tuple(view for index, view in enumerate(scene.train) if index not in chosen)
    if not held_out or not kept:
        raise SceneError(
            f"{scene.source}: scene.validation_every", f"at most the {len(scene.train)} training views", f"{every}"
        )
    extent = camera_extent([view.camera for view in kept])
    rule = f"{rule or f'every {ordinal(every)}'} of the training views (validation)"
    return replace(scene, train=kept, test=held_out, extent=extent, test_split=rule)


def ordinal(number: int) -> str:
    """ "2nd", "3rd", "8th"."""
    ending = {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th") if number % 100 not in (11, 12, 13) else "th"
    return f"{number}{ending}"
