"""Reader of the Plenoptic Video layout.

    DIR/cam00.mp4, cam01.mp4, …     synchronised videos, one per camera (plenoptic/videos.py)
    DIR/poses_bounds.npy            their poses (plenoptic/poses.py)

or the output of the released program's converter, DIR/images and DIR/transforms_*.json (plenoptic/images.py). If a
folder has both, the videos are read. Every frame is decoded once, into a store in the cache folder.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from datasets.cameras.lens import Lens
from datasets.canonical import canonical_space
from datasets.composition import BLACK, background_color
from datasets.files.errors import SceneError
from datasets.files.fingerprint import fingerprint
from datasets.files.named_files import say_renamed
from datasets.plenoptic.filmed import FilmedSource, footage_of, read_videos, videos_config
from datasets.plenoptic.footage import Footage
from datasets.plenoptic.images import (
    camera_number,
    held_out_cameras,
    image_sequences,
    in_use,
    read_camera,
    read_cameras,
)
from datasets.plenoptic.poses import read_poses
from datasets.plenoptic.sync import select_cameras
from datasets.plenoptic.videos import PLENOPTIC_NAME, find_cameras, video_paths
from datasets.readers.llff import image_folder
from datasets.scene import Box, Scene
from datasets.settings import SceneConfig
from datasets.source import Calibration, Log, Photograph, data_folder
from rasterizer.camera import Camera

TITLE, PRECEDENCE = "Plenoptic Video", 30
DOWNSCALE = 2  # where scene=auto leaves it open
# Bytes hashed at both ends of an image: there are thousands, and a PNG ends with checksums of its pixels.
IMAGE_PART = 1 << 12


def matches(path: Path) -> str | None:
    numbered = any(PLENOPTIC_NAME.fullmatch(p.name) for p in path.iterdir())
    posed = (path / "poses_bounds.npy").is_file()
    if numbered and posed or _has_images(path):
        return None
    if posed and video_paths(path) and image_folder(path) is None:
        return "poses_bounds.npy is there and not used: the videos are not called cam00.mp4, cam01.mp4, …"
    return "no cam00.mp4 with poses_bounds.npy, no images/cam00_0000 in transforms_train.json"


def _has_images(path: Path) -> bool:
    """Whether the transforms files name several frames of cameras that stand still, each in one of the files. Files
    without that, or that plenoptic/images.py cannot read, are left to other readers."""
    try:
        cameras = read_cameras(path).values()
    except SceneError:
        return False
    kinds = [{(frame.entry.file, frame.entry.cam_to_world.tobytes()) for frame in frames} for frames in cameras]
    # Of a camera in both files times are held out.
    return len(cameras) > 1 and all(len(frames) > 1 and len(kind) == 1 for frames, kind in zip(cameras, kinds))


@dataclass(frozen=True)
class PosedFootage(FilmedSource):
    """Footage with camera poses; no frame is decoded yet."""

    cfg: SceneConfig
    footage: Footage
    cameras: Mapping[str, Camera]  # by name; of the full-size images
    undistortion: Mapping[str, Lens] | None = None  # by name; None: no distortion
    unit: float = 1.0  # world units per normalised unit
    init_box: Box | None = None  # None: a cube around the cameras

    @property
    def guessed_box(self) -> bool:
        return self.init_box is None

    def photographs(self) -> list[Photograph]:
        """The first frames of the training cameras, undistorted, full size."""
        return [
            Photograph(name, image, self.cameras[name])
            for name, image in self.footage.first_images(self.undistortion).items()
            if name not in self.held_out
        ]

    def scene(self, found: Calibration | None = None) -> Scene:
        """With the poses that structure from motion has refined, if it has."""
        cameras = {**self.cameras, **(found.cameras if found else {})}
        if found and self.cfg.color_correction:
            for name in self.held_out:
                self.footage.log(
                    f"colours of {name} are left alone: a held-out camera takes no part in structure from motion here"
                )
        return self.footage.to_scene(
            cameras, self.undistortion, self.unit, self.init_box, found.colors if found else None
        )


def as_found(cfg: SceneConfig, log: Log) -> SceneConfig:
    """Colours are corrected on request only: by default of what is known to need it, videos without poses."""
    downscale, color = cfg.downscale or DOWNSCALE, cfg.color_correction is True
    return replace(cfg, reader="plenoptic", downscale=downscale, color_correction=color)


def open_source(cfg: SceneConfig, threads: int, log: Log) -> PosedFootage:
    if cfg.sync == "given":
        raise SceneError("scene.sync", "none, as the cameras of this layout are synchronised", "given")
    return open_folder(data_folder(cfg), videos_config(cfg), threads, log)


def open_folder(root: Path, cfg: SceneConfig, threads: int, log: Log) -> PosedFootage:
    """The folder, in either form of the layout. Raises SceneError for invalid data."""
    files, poses, transforms = find_cameras(root), root / "poses_bounds.npy", root / "transforms_train.json"
    if files and (poses.exists() or not transforms.exists()):
        # Given poses are of the pixels as stored.
        videos = read_videos(root, files, cfg, threads, square=False)
        footage = footage_of(root, files, videos, None, cfg, threads, log)
        found = read_poses(poses, [file.name for file in files], footage.names, footage.size)
        return PosedFootage(cfg, footage, found.cameras, unit=found.unit, init_box=found.init_box)
    if transforms.exists():
        return _open_images(root, cfg, threads, log)
    raise SceneError(root, "cam00.mp4 … and poses_bounds.npy, or images and transforms_train.json", "neither")


def _open_images(root: Path, cfg: SceneConfig, threads: int, log: Log) -> PosedFootage:
    entries = read_cameras(root)
    stated_paths = [root / frame.entry.file_path for frames in entries.values() for frame in frames]
    files = [frame.entry.image_path for frames in entries.values() for frame in frames]
    say_renamed(root / "transforms_train.json", stated_paths, files, log)
    stated = held_out_cameras(entries)
    if list(cfg.test_cameras) == [0] and stated not in ((), (0,)):
        cfg = replace(cfg, test_cameras=list(stated))
        log(f"held out: {', '.join(map(str, stated))}, the cameras of transforms_test.json")
    keep = select_cameras([camera_number(name) for name in entries], root, cfg.test_cameras, cfg.drop_cameras)
    background = background_color(cfg.background) or BLACK
    sequences = in_use(image_sequences(entries, keep, background), cfg.first_frame, cfg.frames, cfg.drop_cameras)
    content = f"{fingerprint(files, IMAGE_PART)} over {background}"
    footage = Footage(root, sequences, sequences[0].count, content, cfg, threads, log)
    posed = {name: read_camera(entries[name], footage.size) for name in footage.names}
    cameras = {name: camera for name, (camera, _) in posed.items()}
    undistortion = {name: lens for name, (_, lens) in posed.items()}
    train_cameras = [camera for name, camera in cameras.items() if name not in footage.held_out]
    # This form of the layout has no bounds: one normalised unit is one canonical unit.
    return PosedFootage(cfg, footage, cameras, undistortion, unit=canonical_space(train_cameras).unit)
