"""Points from given poses, for folders of images without points: traced rigs, whose surfaces and cameras are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from datasets.files.errors import SceneError
from datasets.settings import SceneConfig
from datasets.synthetic.film import depth_of, film
from datasets.synthetic.write_film import FilmSettings
from pipeline.config.schema import Config, InitConfig
from pipeline.data.prepare import Prepared, prepare
from pipeline.data.triangulated import RANKS, nearest_pairs
from pipeline.model.initialise import initialise
from rasterizer import Camera

RIG = FilmSettings(scene="counter", seed=1, size=320, cameras=9, frames=1, samples=3)
BLENDER = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Camera]]:
    """A folder transforms.json of one instant, whose cameras are numbered like frames, and the cameras."""
    folder = tmp_path_factory.mktemp("rig")
    world, cameras = RIG.set_up()
    frames = []
    for number, camera in enumerate(cameras):
        image = next(film(world, camera, RIG.times, samples=RIG.samples))
        Image.fromarray(image).save(folder / f"{number:04d}.png")
        frames.append(frame_of(number, np.linalg.inv(camera.world_to_cam) @ BLENDER, camera))
    (folder / "transforms.json").write_text(json.dumps({"frames": frames}))
    return folder, cameras


def frame_of(number: int, cam_to_world: np.ndarray, camera: Camera) -> dict:
    lens = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    size = {"w": camera.width, "h": camera.height}
    return {"file_path": f"{number:04d}.png", "transform_matrix": cam_to_world.tolist(), **lens, **size}


def read(folder: Path, lines: list[str] | None = None, source: str = "auto", **scene: object) -> Prepared:
    where = {"path": str(folder), "cache": str(folder / "cache")}
    settings = SceneConfig(name="rig", reader="nerfstudio", downscale=2, **where, **scene)
    log = print if lines is None else lines.append
    return prepare(Config(scene=settings, init=InitConfig(source=source, min_points=30, max_features=500)), log)


def test_points_lie_on_the_surfaces_that_images_show(rig: tuple[Path, list[Camera]]) -> None:
    """Matched at full size, though views have half of it; features' errors of 0.3 pixels are 1 % of the depth."""
    folder, cameras = rig
    lines: list[str] = []
    data = read(folder, lines)
    assert data.points == "sfm" and data.cloud is not None and data.scene.capture == "static"
    assert any("triangulated from 8 of 8 images at 320 x" in line for line in lines)  # of 9 one is held out
    world = data.canonical.inverse.points(data.cloud.points)
    seen = data.scene.points.seen_by
    assert seen is not None and set(seen) <= {view.name for view in data.scene.train}
    traced = RIG.set_up()[0]
    errors = []
    for name, rows in seen.items():
        camera = cameras[int(name.rpartition("/")[2])]
        depth = depth_of(traced, camera, 0.0)
        x, y, z = camera.world_to_cam[:3, :3] @ world[rows].T + camera.world_to_cam[:3, 3:]
        column, row = (camera.fx * x / z + camera.cx).astype(int), (camera.fy * y / z + camera.cy).astype(int)
        errors += (np.abs(z / depth[row, column] - 1)).tolist()
    assert np.median(errors) < 0.01


def test_few_points_start_with_random_ones_beside_them(rig: tuple[Path, list[Camera]]) -> None:
    data = read(rig[0])
    cfg = Config(init=InitConfig(source="sfm"))
    cfg.train.init_points = 2000
    model = initialise(data.scene, cfg, np.random.default_rng(0), data.cloud)
    assert data.scene.points is not None and data.scene.points.sparse
    assert len(model) == 2000 and data.cloud is not None and len(data.cloud.points) < 1000


@pytest.mark.parametrize("source", ["auto", "sfm"])
def test_poses_the_wrong_way_round_are_refused_with_both_readings(
    rig: tuple[Path, list[Camera]], tmp_path: Path, source: str
) -> None:
    """World-to-camera matrices, of OpenCV's axes, in the place of camera-to-world ones; the rig is off the origin."""
    folder, cameras = rig
    wrong = tmp_path / "wrong"
    wrong.mkdir()
    for number in range(len(cameras)):
        (wrong / f"{number:04d}.png").symlink_to(folder / f"{number:04d}.png")
    shift = np.eye(4)
    shift[:3, 3] = 0.3, -0.2, 0.5
    frames = [frame_of(number, camera.world_to_cam @ shift, camera) for number, camera in enumerate(cameras)]
    (wrong / "transforms.json").write_text(json.dumps({"frames": frames}))
    with pytest.raises(SceneError, match="as they are read, [0-9]+ with .*exchanged"):
        read(wrong, source=source)


def test_init_box_holds_in_this_layout_too(rig: tuple[Path, list[Camera]]) -> None:
    assert read(rig[0], init_box=[-3.0, 2.0]).scene.init_box == (-3.0, 2.0)


def test_pairs_of_many_photographs_are_of_near_ones() -> None:
    from datasets.source import Photograph

    image = np.zeros((4, 4, 3), np.uint8)
    photographs = []
    for i in range(40):
        pose = np.eye(4)
        pose[0, 3] = -float(i)
        photographs.append(Photograph(f"{i:02d}", image, Camera(4, 4, 4.0, 4.0, 2.0, 2.0, pose)))
    pairs = nearest_pairs(photographs)
    assert pairs is not None and all(0 < abs(int(a) - int(b)) <= max(RANKS) + 1 for a, b in pairs)
    assert {("00", "01"), ("20", "21")} <= set(pairs) and len(pairs) < 40 * len(RANKS)
    assert nearest_pairs(photographs[:25]) is None
