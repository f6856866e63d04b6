"""A validation split out of the training views: settings chosen by it have never seen the test views."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace

import numpy as np

from datasets.scene import Scene, SceneError, camera_extent


def hold_out_every(scene: Scene, every: int) -> Scene:
    """The scene with every `every`-th training view, counted from its half, in place of the test views.

    The rest of the training views stay in their order; the extent is theirs. Raises SceneError when either part would
    be empty. Meant for photographs: of several cameras that filmed at once, `scene.test_cameras` holds out another.
    """
    return _hold_out(scene, set(range(every // 2, len(scene.train), every)), every)


def hold_out_poses(scene: Scene, every: int) -> Scene:
    """Likewise every `every`-th pose that a training camera takes, with all its views.

    One moving camera has a pose a view, so that it is `hold_out_every`; of several standing ones whole cameras are held
    out. Raises SceneError as that does.
    """
    poses = dict.fromkeys(view.camera.world_to_cam.tobytes() for view in scene.train)
    chosen = set(list(poses)[every // 2 :: every])
    return _hold_out(
        scene, {index for index, view in enumerate(scene.train) if view.camera.world_to_cam.tobytes() in chosen}, every
    )


def hold_out_outermost(scene: Scene, every: int) -> Scene:
    """Likewise as many views, those that look in the directions farthest from the mean direction of all.

    Where the cameras stand on a hemisphere these are the lowest ones. What the others leave open, an underside or how
    far a thing reaches along their rays, shows in these and hardly in every `every`-th one, which has others around it.
    """
    forward = np.stack([view.camera.world_to_cam[2, :3] for view in scene.train])
    along = forward @ forward.mean(axis=0)
    count = len(range(every // 2, len(scene.train), every))
    return _hold_out(scene, set(np.argsort(along, kind="stable")[:count].tolist()), every)


def _hold_out(scene: Scene, chosen: Set[int], every: int) -> Scene:
    held_out = tuple(view for index, view in enumerate(scene.train) if index in chosen)
    kept = tuple(view for index, view in enumerate(scene.train) if index not in chosen)
    if not held_out or not kept:
        raise SceneError(
            f"{scene.source}: scene.validation_every", f"at most the {len(scene.train)} training views", f"{every}"
        )
    return replace(scene, train=kept, test=held_out, extent=camera_extent([view.camera for view in kept]))
