"""Images of a scene's test views by any program: which file shows which view, and their pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from datasets.files.errors import DataError, SceneError, clear, read_json
from datasets.files.image_files import image_size, read_rgba
from datasets.files.natural_order import natural_order
from datasets.ground_truth import GroundTruth
from datasets.scene import Scene
from pipeline.data.training_views import Target, camera_at
from pipeline.evaluation.evaluate import Render, Rendered

BITS = 8  # a channel
# How the files of a view may be called, without suffix, below the folder.
_NAMES: tuple[Callable[[str], str], ...] = (
    lambda view: view,
    lambda view: view.replace("/", "_"),
    lambda view: f"{view.replace('/', '_')}_render",  # as in the renders/ of a run
    lambda view: view.rpartition("/")[2],
)


def files_of_views(folder: Path, views: Sequence[str], mapping: Path | None, in_order: bool) -> dict[str, Path]:
    """Name of each test view -> its PNG in `folder`. DataError, one line, where a view has none, or not one.

    mapping: a JSON object {view: file}. in_order: the files in the order of their numbers are the views in order.
    """
    found_files = (path for path in folder.rglob("*") if path.suffix.lower() == ".png")
    files = sorted(found_files, key=lambda path: natural_order(path.relative_to(folder).as_posix()))
    if mapping is not None:
        return _mapped(folder, views, mapping)
    if in_order:
        if len(files) != len(views):
            raise DataError(folder, f"{len(views)} PNG files, one a test view", f"{len(files)}")
        return dict(zip(views, files))
    by_name = {path.relative_to(folder).with_suffix("").as_posix(): path for path in files}
    found = max(({v: by_name[n(v)] for v in views if n(v) in by_name} for n in _NAMES), key=len)
    if missing := [view for view in views if view not in found]:
        names = ", ".join(missing[:3]) + (" …" if missing[3:] else "")
        raise DataError(
            folder,
            f"a PNG named after each of the {len(views)} test views",
            f"{len(files)} PNG files and none of {names} ({len(missing)} views); --names FILE maps views to files, "
            "--in-order takes the files in order of their numbers",
        )
    if len(set(found.values())) < len(found):
        raise DataError(folder, "a PNG of its own for each test view", "one for several; --names FILE maps them")
    return found


def refuse_other_sizes(scene: Scene, scale: float, files: Mapping[str, Path], protocol: str) -> None:
    """DataError, one line, for an image that has not the size of its view at `scale`."""
    for view in scene.test:
        camera, size = camera_at(view.camera, scale), image_size(files[view.name])
        if size != (camera.width, camera.height):
            raise SceneError(
                files[view.name],
                f"{camera.width} x {camera.height} pixels, of {view.name} by {protocol}",
                f"{size[0]} x {size[1]}; images are not resized here, scene.downscale=… chooses another protocol",
            )


def given_images(scene: Scene, files: Mapping[str, Path]) -> Render:
    """Reads them as the evaluation asks for them."""

    def read(index: int, target: Target, known: GroundTruth | None, lidar: np.ndarray | None) -> Rendered:
        return Rendered(opaque_image(files[scene.test[index].name]))

    return read


def opaque_image(path: Path) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1]. SceneError, one line, for another format, and for pixels that are transparent."""
    rgba = read_rgba(path)
    if (rgba[..., 3] < 255).any():
        raise SceneError(path, "opaque pixels, composed over the protocol's background", "transparent ones")
    return in_planes(rgba[..., :3].astype(np.float32) / np.float32(255))


def in_planes(image: np.ndarray) -> np.ndarray:
    """The same (H, W, 3), its memory in planes as a render's, so that sums over it have the same last digit."""
    return np.ascontiguousarray(image.transpose(2, 0, 1)).transpose(1, 2, 0)


def _mapped(folder: Path, views: Sequence[str], mapping: Path) -> dict[str, Path]:
    if not mapping.is_file():
        raise DataError(mapping, "a JSON file {view: file}", "none")
    tree = read_json(mapping)
    if not isinstance(tree, dict) or not all(isinstance(name, str) for name in tree.values()):
        raise DataError(mapping, "a JSON object {view: file}", "something else")
    if unknown := sorted(set(tree) - set(views)):
        raise DataError(mapping, f"test views such as {views[0]}", unknown[0])
    if missing := [view for view in views if view not in tree]:
        raise DataError(mapping, f"a file of each of the {len(views)} test views", f"none of {missing[0]}")
    for view, name in tree.items():
        if not (folder / name).is_file():
            raise DataError(mapping, f"files below {folder}", f"{clear(name)} of {view}, which is none")
    return {view: folder / tree[view] for view in views}
