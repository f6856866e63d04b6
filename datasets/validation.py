"""A validation split out of the training views: settings chosen by it have never seen the test views."""

from __future__ import annotations

from dataclasses import replace

from datasets.scene import Scene, SceneError, camera_extent


def hold_out_every(scene: Scene, every: int) -> Scene:
    """The scene with every `every`-th training view, counted from its half, in place of the test views.

    The rest of the training views stay in their order; the extent is theirs. Raises SceneError when either part would
    be empty. Meant for photographs: of several cameras that filmed at once, `scene.test_cameras` holds out another.
    """
    held_out = scene.train[every // 2 :: every]
    kept = tuple(view for index, view in enumerate(scene.train) if index % every != every // 2)
    if not held_out or not kept:
        raise SceneError(f"{scene.source}: scene.validation_every", f"at most the {len(scene.train)} training views",
                         f"{every}")
    return replace(scene, train=kept, test=held_out, extent=camera_extent([view.camera for view in kept]))
