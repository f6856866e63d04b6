"""Synthetic scenes with known truth: made by an analytic ray tracer, written and read as real data is.

wheel   turns fast while it travels           (needs 4D rotation)
lamp    colours that change with time and view (needs 4DSH)
burst   things appear, move off and vanish     (needs the split in time)
still   nothing moves, no time at all          (needs none of them)
counter filmed by a rig of cameras             (things move and flicker before a far background)
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from datasets.scene import SceneError

PHOTOGRAPHED = ("wheel", "lamp", "burst", "still")  # in the D-NeRF layout: one camera a time
FILMED = ("counter",)  # in the Plenoptic Video layout: many cameras all the time
SCENE_NAMES = PHOTOGRAPHED + FILMED

Progress = Callable[[int, int], None]  # told after each filmed camera: those done, all


def make_scene(
    name: str,
    cache: str | Path,
    *,
    seed: int = 0,
    size: int = 200,
    train_views: int = 100,
    test_views: int = 12,
    cameras: int = 12,
    frames: int = 60,
    processes: int = 1,
    progress: Progress | None = None,
) -> Path:
    """The folder of a synthetic scene under `cache`, made now unless it stands there already.

    size: width of an image in pixels. train_views and test_views are for photographed scenes, cameras and frames
    for filmed ones; so are processes and progress, see build_scene. The folder's name ends in a hash of all that
    the images follow from: the tracer's and the scene's source, and the other arguments. Raises SceneError for an
    unknown name or an argument out of range.
    """
    _check_name(name)
    parameters = {"scene": name, "seed": seed, "size": size}
    parameters |= (
        {"cameras": cameras, "frames": frames}
        if name in FILMED
        else {"train_views": train_views, "test_views": test_views}
    )
    folder = Path(cache) / f"{name}-{_fingerprint(parameters)}"
    if not (folder / "meta.json").is_file():
        build_scene(folder, **parameters, processes=processes, progress=progress)
    return folder


def build_scene(
    folder: Path,
    *,
    scene: str,
    seed: int,
    size: int,
    train_views: int = 100,
    test_views: int = 12,
    cameras: int = 12,
    frames: int = 60,
    samples: int = 3,
    processes: int = 1,
    progress: Progress | None = None,
) -> Path:
    """Traces a scene into `folder`, which must not hold anything yet. The same arguments give the same bytes.

    train_views, test_views: of a photographed scene. The rest is for filmed ones: samples × samples rays a pixel,
    `processes` cameras side by side (spawned: the caller's main module must be importable).
    """
    _check_name(scene)
    if scene in FILMED:
        from datasets.synthetic.write_film import Shooting, write_film

        shooting = Shooting(scene=scene, seed=seed, size=size, cameras=cameras, frames=frames, samples=samples)
        return write_film(shooting, Path(folder), processes=processes, progress=progress)

    from datasets.synthetic.camera_path import held_out_shots, training_shots
    from datasets.synthetic.write import write_scene

    if train_views < 2 or test_views < 1:
        raise SceneError("scene.train_views, scene.test_views", "at least 2 and 1", f"{train_views} and {test_views}")
    # One generator a purpose: the cameras of a seed stay where they are when a scene draws more numbers.
    world_rng, train_rng, val_rng, test_rng = np.random.default_rng(seed).spawn(4)
    world = importlib.import_module(f"datasets.synthetic.scenes.{scene}").build(world_rng)
    shots = {
        "train": training_shots(train_views, train_rng),
        "val": held_out_shots(max(1, test_views // 3), train_views, val_rng),
        "test": held_out_shots(test_views, train_views, test_rng),
    }
    meta = {
        "scene": scene,
        "seed": seed,
        "size": size,
        "train_views": train_views,
        "test_views": test_views,
        "flow_dt": 1 / (train_views - 1),  # to the next training time
        "flow": "pixels right and down to time + flow_dt, same camera",
        "depth": "z along the viewing axis",
    }
    return write_scene(world, shots, size, meta, Path(folder))


def _check_name(name: str) -> None:
    if name not in SCENE_NAMES:
        raise SceneError("scene.name", f"synthetic/ and one of {', '.join(SCENE_NAMES)}", repr(name))


def _fingerprint(parameters: dict) -> str:
    here = Path(__file__).parent
    digest = hashlib.sha256(json.dumps(parameters, sort_keys=True).encode())
    for source in [*sorted(here.glob("*.py")), here / "scenes" / f"{parameters['scene']}.py"]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:12]
