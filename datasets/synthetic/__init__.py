"""Synthetic scenes with known ground truth: ray-traced, written to disk and read back in the layouts of real data.

wheel     fast rotation and translation               tests 4D rotation
lamp      colours that depend on time and direction   tests 4DSH
burst     objects that appear, move and vanish        tests densification in time
still     static, without times                       the control: none of these is needed
counter   multi-camera video                          motion, flicker and a distant background
street    a driving log of three cameras and a LiDAR  depth, sky and what moves seen from a moving car
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from datasets.files.atomic_write import atomic_folder
from datasets.files.errors import DataError, SceneError
from datasets.manifest import OWN, Manifest, described, read_manifest, write_manifest
from datasets.synthetic.camera_path import TimedPose, arc_poses, held_out_poses, poses_beside_camera, training_poses
from datasets.synthetic.croissant import write_croissant

PHOTOGRAPHED = ("wheel", "lamp", "burst", "still")  # in the D-NeRF layout: one camera per time
FILMED = ("counter",)  # in the Plenoptic Video layout: several cameras at every time
DRIVEN = ("street",)  # in the layouts of driving logs: cameras on a car, LiDAR
SCENE_NAMES = PHOTOGRAPHED + FILMED + DRIVEN

Progress = Callable[[int, int], None]  # called after each camera of a film: cameras done, all cameras


def make_scene(name: str, cache: str | Path, *, progress: Progress | None = None, **given: Any) -> Path:
    """The folder of a synthetic scene under `cache`; traces the scene if it is not there.

    given: as of `parameters_of`. The folder's name ends with a hash of everything that determines the images: the
    sources of the tracer and of the scene, and the parameters. Raises SceneError for an unknown name or an invalid
    argument.
    """
    parameters = parameters_of(name, **given)
    folder = Path(cache) / f"{name}-{_fingerprint({'scene': name, **parameters})}"
    if not (folder / "meta.json").is_file():
        build_scene(folder, scene=name, progress=progress, **parameters)
    elif not _is_published(folder):
        _publish(folder, name)
    return folder


def _is_published(folder: Path) -> bool:
    """Not where an earlier version wrote no manifest, or one of another form."""
    try:
        read_manifest(folder / OWN)
    except DataError:
        return False
    return True


def parameters_of(
    name: str,
    *,
    seed: int = 0,
    size: int = 200,
    train_views: int = 100,
    test_views: int = 12,
    cameras: int = 12,
    frames: int = 60,
    camera_path: str = "jumps",
) -> dict[str, Any]:
    """Those of the arguments that determine the scene.

    size: image width in pixels. train_views, test_views, camera_path: of photographed scenes, "jumps" for one camera
    per time as D-NeRF, "arc" for one camera that moves, with test views beside it and validation views on its path.
    cameras, frames: of filmed scenes. frames: of drives, too.
    """
    if name not in SCENE_NAMES:
        raise SceneError("scene.name", f"synthetic/ and one of {', '.join(SCENE_NAMES)}", repr(name))
    if camera_path != "jumps" and name not in PHOTOGRAPHED:
        raise SceneError("scene.camera_path", f"jumps for {name}; arc is for {', '.join(PHOTOGRAPHED)}", camera_path)
    if name in FILMED:
        return {"seed": seed, "size": size, "cameras": cameras, "frames": frames}
    if name in DRIVEN:
        return {"seed": seed, "size": size, "frames": frames}
    views = {"train_views": train_views, "test_views": test_views}
    return {"seed": seed, "size": size, **views, "camera_path": camera_path}


def build_scene(
    folder: Path, *, scene: str, samples: int = 3, processes: int = 1, progress: Progress | None = None, **given: Any
) -> Path:
    """Traces a scene into `folder`, which must be absent or empty, and writes its manifest. The same arguments give the
    same bytes.

    given: as of `parameters_of`. samples, processes: of filmed scenes: samples × samples rays per pixel, `processes`
    cameras in parallel (spawned: the caller's main module must be importable).
    """
    parameters = parameters_of(scene, **given)
    folder = Path(folder)
    with atomic_folder(folder, "meta.json") as made:  # with its manifest: several processes may make one scene
        _trace(made, scene, parameters, samples, processes, progress)
        _publish(made, scene)
    return folder


def _publish(folder: Path, scene: str) -> None:
    """The Croissant metadata and the manifest of a scene's folder."""
    write_croissant(folder, scene)
    files = [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()]
    own = Manifest(
        f"synthetic/{scene}",
        f"Synthetic scene {scene}, traced with known motion and geometry; meta.json has its parameters",
        f"python -m datasets.synthetic {scene}",
        "Apache-2.0",
        {scene: described(folder, [name for name in files if name != OWN])},
    )
    write_manifest(folder / OWN, own)


def _trace(
    folder: Path, scene: str, parameters: dict[str, Any], samples: int, processes: int, progress: Progress | None
) -> Path:
    if scene in FILMED:
        from datasets.synthetic.write_film import FilmSettings, write_film

        settings = FilmSettings(scene=scene, samples=samples, **parameters)
        return write_film(settings, folder, processes=processes, progress=progress)

    if scene in DRIVEN:
        from datasets.synthetic.drive import write_drive

        return write_drive(folder, scene=scene, progress=progress, **parameters)

    from datasets.synthetic.write import write_scene

    train_views, test_views = parameters["train_views"], parameters["test_views"]
    if train_views < 2 or test_views < 1:
        raise SceneError("scene.train_views, scene.test_views", "at least 2 and 1", f"{train_views} and {test_views}")
    # Separate generators: the cameras of a seed do not change when a scene draws more random numbers.
    world_rng, *camera_rngs = np.random.default_rng(parameters["seed"]).spawn(4)
    world = importlib.import_module(f"datasets.synthetic.scenes.{scene}").build(world_rng)
    poses = _poses(parameters["camera_path"], train_views, test_views, camera_rngs)
    meta = {
        "scene": scene,
        **parameters,
        "flow_dt": 1 / (train_views - 1),  # to the next training time
        "flow": "pixels right and down to time + flow_dt, same camera",
        "depth": "z along the viewing axis",
    }
    return write_scene(world, poses, parameters["size"], meta, folder)


def _poses(
    camera_path: str, train_views: int, test_views: int, rngs: list[np.random.Generator]
) -> dict[str, list[TimedPose]]:
    """The cameras of each split; rngs: of training, validation and test cameras."""
    validation_views = max(1, test_views // 3)
    if camera_path == "arc":
        start = rngs[0].uniform(0, 2 * np.pi)
        return {
            "train": arc_poses(train_views, start),
            "val": poses_beside_camera(validation_views, train_views, start, aside=0.0),
            "test": poses_beside_camera(test_views, train_views, start),
        }
    return {
        "train": training_poses(train_views, rngs[0]),
        "val": held_out_poses(validation_views, train_views, rngs[1]),
        "test": held_out_poses(test_views, train_views, rngs[2]),
    }


def _fingerprint(parameters: dict) -> str:
    here = Path(__file__).parent
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    for source in [*sorted(here.glob("*.py")), here / "scenes" / f"{parameters['scene']}.py"]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]
