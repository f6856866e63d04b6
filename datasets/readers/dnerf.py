"""Reader of the D-NeRF (Blender) layout, which COLMAP-to-NeRF converters also write for photographs.

    DIR/transforms_train.json, transforms_val.json, transforms_test.json
        {"camera_angle_x": horizontal field of view in radians,
         "frames": [{"file_path": "./train/r_0", "time": 0.0 … 1.0, "transform_matrix": 4×4 camera-to-world}, …]}
    DIR/train/r_0.png …   RGB or RGBA with straight alpha, all of one size

Poses have Blender's camera axes (x right, y up, z backward). Intrinsics may be in pixels, with lens distortion
(cameras/intrinsics.py). A single transforms.json is read as transforms_train.json, unless it has nerfstudio's masks or
lists of file names. Times may be in any unit and from
any origin; if no entry has a time the scene is static. Invalid input raises SceneError, before any image is decoded
where the headers suffice.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from datasets.cameras.intrinsics import read_distortion, read_pinhole, stated_shape
from datasets.cameras.transforms import TransformsEntry, read_transforms
from datasets.canonical import canonical_space
from datasets.composition import (
    BLACK,
    HIDDEN_IMAGES,
    Color,
    background_color,
    chosen_background,
    chosen_downscale,
    compose,
    coverage,
    hidden_color,
    reduced_camera,
)
from datasets.files.errors import SceneError, read_json
from datasets.files.image_files import common_size, oriented_size
from datasets.files.named_files import say_renamed
from datasets.ground_truth import StoredTruth
from datasets.photographs.photograph import PosedFile, say_folds, say_turns
from datasets.scene import USUAL_BOX, Scene, View, camera_extent, capture_of, make_camera, validate_scene
from datasets.settings import SceneConfig
from datasets.source import Log, data_path

# Times within [0, 1] that span more than this are in D-NeRF's unit, whose range is [0, 1].
UNIT_INTERVAL_SPAN = 0.5
# A first or last time that is an outlier is refused: it would stretch the scene's duration.
STEPS_BEYOND = 4.0  # times in [0, 1]: bound of its distance, × the longest step between the other times
# Times in [0, 1]: a distance above STRETCH × their span is no part of a step, WHOLE_STEP with jitter: 0, 1, 2 but not
# 0, 1, 1.5.
STRETCH, WHOLE_STEP = 0.25, 0.75
OUTLIER_DISTANCE = 10.0  # times in another unit: bound of its distance, × the span of the other times
SPLITS = ("train", "test", "val")
FILE_LISTS = ("train_filenames", "val_filenames", "test_filenames")  # of nerfstudio
VALIDATION_EVERY = 8  # suggested in the message about a missing split
TITLE, PRECEDENCE = "D-NeRF", 40


def matches(path: Path) -> str | None:
    return None if (path / "transforms_train.json").is_file() else "no transforms_train.json"


def as_found(cfg: SceneConfig, log: Log) -> SceneConfig:
    """Where the test split is missing transforms_val.json is held out, else every eighth training view."""
    cfg, path = replace(cfg, reader="dnerf"), data_path(cfg)
    if cfg.validation_every or has_split(path, cfg.test_split):
        return cfg
    missing = f"{path}: there is no transforms_{cfg.test_split}.json"
    if has_split(path, "val"):
        log(f"{missing}; held out: transforms_val.json")
        return replace(cfg, test_split="val")
    log(f"{missing}; held out: every {VALIDATION_EVERY}th training view")
    return replace(cfg, validation_every=VALIDATION_EVERY)


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    """The scene in a folder. Raises SceneError if it does not follow the layout.

    With scene.validation_every a missing test split is left empty: the caller holds out training views.
    """
    test_split = None if cfg.validation_every and not has_split(root, cfg.test_split) else cfg.test_split
    splits = {"train": _read_split(root, "train")}
    if test_split is not None:
        splits[test_split] = _read_split(root, test_split)
    entries = [entry for split in splits.values() for entry in split]
    for split in splits.values():
        say_renamed(split[0].file, (root / e.file_path for e in split), (e.image_path for e in split), log)
    time_start, duration = _time_range(root, entries)
    size = common_size([entry.image_path for entry in entries])
    if oriented_size(entries[0].image_path, stated_shape(entries[0].intrinsics))[1]:
        size = size[::-1]
    downscale = cfg.downscale or chosen_downscale(size)
    if min(size) < downscale:
        raise SceneError(
            entries[0].image_path, f"at least {downscale} pixels a side (downscale)", "{} x {}".format(*size)
        )

    # Checked before any image is decoded.
    photographs = {split: [_photograph(entry, size) for entry in listed] for split, listed in splits.items()}
    of_all = [photograph for listed in photographs.values() for photograph in listed]
    say_folds(of_all, log)
    say_turns(of_all, log)
    background = background_color(cfg.background)
    hidden = None if background else _hidden_color(photographs["train"])
    composed_over = background or hidden or BLACK
    views = {
        split: tuple(_read_view(photograph, downscale, composed_over) for photograph in listed)
        for split, listed in photographs.items()
    }
    train_cameras = [view.camera for view in views["train"]]
    train_images = [np.asarray(view.image) for view in views["train"]]
    opaque = all(view.coverage is None for view in views["train"])
    space = canonical_space(train_cameras)
    test = views[test_split] if test_split else ()
    scene = Scene(
        name=cfg.name,
        train=views["train"],
        test=test,
        duration=duration,
        time_start=time_start,
        background=chosen_background(train_images, opaque, background, log, hidden),
        extent=camera_extent(train_cameras),
        init_box=space.inverse.box(USUAL_BOX),
        source=root,
        capture=capture_of(views["train"], test, filmed=False),
        unit=space.unit,
    )
    return validate_scene(scene) if test_split else scene


def has_split(path: Path, split: str) -> bool:
    """Whether the folder has a transforms file for `split`."""
    return (path / f"transforms_{split}.json").is_file()


def view_name(entry: TransformsEntry) -> str:
    """ "train/r_0" """
    return Path(entry.file_path).as_posix().removesuffix(".png")


def _read_split(root: Path, split: str) -> list[TransformsEntry]:
    path = root / f"transforms_{split}.json"
    if split == "train" and not path.exists() and (root / "transforms.json").is_file():
        path = root / "transforms.json"
    elif not path.exists():
        raise SceneError(path, "a file (D-NeRF layout)", _missing_split(root, split))
    _refuse_nerfstudio(path)
    return read_transforms(path, root)


def _refuse_nerfstudio(path: Path) -> None:
    """SceneError if the file says which pixels and frames to train on, which only the reader of nerfstudio obeys."""
    content = read_json(path, SceneError)
    if not isinstance(content, dict):
        return  # read_transforms says what it is instead
    listed = content.get("frames")
    frames = listed if isinstance(listed, list) else []
    found = [key for key in FILE_LISTS if key in content]
    found += ["mask_path"] if any(isinstance(frame, dict) and "mask_path" in frame for frame in frames) else []
    if found:
        raise SceneError(path, f"no {found[0]} (scene.reader=nerfstudio obeys it, in one transforms.json)", found[0])


def _missing_split(root: Path, split: str) -> str:
    """The part "found …" of the message about a missing split, with the settings that do without it."""
    if split == "train":
        return "none"
    others = [other for other in SPLITS if other not in ("train", split) and has_split(root, other)]
    taken = [f"transforms_{other}.json is there: scene.test_split={other} takes it" for other in others]
    every = f"scene.validation_every={VALIDATION_EVERY} holds out every eighth training view"
    return "; ".join(["none", *taken, every])


def _time_range(root: Path, entries: list[TransformsEntry]) -> tuple[float, float]:
    """(time_start, duration): [0, 1] for D-NeRF's own times and for none, else from the first time to the last.

    SceneError if only some entries have a time, or if the first or last time is an outlier outside [0, 1].
    """
    missing = [entry for entry in entries if entry.time is None]
    if missing and len(missing) < len(entries):
        raise SceneError(
            root / view_name(missing[0]),
            "a time in every frame or in none",
            f"none here and in {len(missing)} of {len(entries)} frames",
        )
    if missing:
        return 0.0, 1.0
    timed = [(entry.time, entry) for entry in entries if entry.time is not None]
    timed.sort(key=lambda pair: pair[0])
    times = [time for time, _ in timed]
    low, high = times[0], times[-1]
    if low >= 0 and high <= 1 and (high - low > UNIT_INTERVAL_SPAN or high == low):
        return 0.0, 1.0
    if len(timed) > 1 and (low < 0 or high > 1):
        _refuse_outlier(root, *timed[0], times[1:])
        _refuse_outlier(root, *timed[-1], times[:-1])
    duration = high - low or 1.0
    while low + duration < high:  # rounding
        duration = math.nextafter(duration, math.inf)
    return low, duration


def _refuse_outlier(root: Path, time: float, entry: TransformsEntry, others: list[float]) -> None:
    """SceneError if the `time` of `entry`, the first or the last, does not continue the `others` (ascending)."""
    distance, longest_step = min(abs(time - other) for other in others), np.diff(others).max(initial=0)
    span, in_unit_interval = others[-1] - others[0], others[0] >= 0 and others[-1] <= 1
    if in_unit_interval:
        near = distance <= STRETCH * span or distance > WHOLE_STEP * longest_step
        regular = near and distance < STEPS_BEYOND * longest_step
    else:
        regular = distance < OUTLIER_DISTANCE * span
    if distance > 0 and longest_step > 0 and not regular:
        expected = (
            "a time in [0, 1], as the other frames have"
            if in_unit_interval
            else f"a time near the other frames', {others[0]:.13g} to {others[-1]:.13g}"
        )
        raise SceneError(root / view_name(entry), expected, f"{time:.13g}")


def _photograph(entry: TransformsEntry, size: tuple[int, int]) -> PosedFile:
    camera = read_pinhole(entry.intrinsics, size, entry.cam_to_world, entry.where, entry.file)
    bent = read_distortion(entry.intrinsics, entry.where)
    lens = None
    if any(bent):
        from datasets.cameras.lens import Undistortion  # imports OpenCV, which few scenes need

        lens = Undistortion.of(camera, *bent)
    upright = oriented_size(entry.image_path, size)[1]
    return PosedFile(view_name(entry), entry.image_path, camera, lens, entry.time or 0.0, upright=upright)


def _hidden_color(photographs: Sequence[PosedFile]) -> Color | None:
    """That of some of the images; None where they have several, or are opaque."""
    return hidden_color([photograph.read() for photograph in photographs[:: -(-len(photographs) // HIDDEN_IMAGES)]])


def _read_view(photograph: PosedFile, downscale: int, background: Color) -> View:
    path, rgba = photograph.path, photograph.read()
    camera = make_camera(path, lambda: reduced_camera(photograph.camera, downscale))
    known = path.with_suffix(".npz").is_file() and not photograph.lens  # the truth is of the image as stored
    truth = StoredTruth(path.with_suffix(".npz"), downscale=downscale) if known else None
    alpha, image, mask = coverage(rgba, downscale), compose(rgba, background, downscale), photograph.imaged(camera)
    return View(camera, photograph.time or 0.0, image, photograph.name, alpha, truth, mask=mask)
