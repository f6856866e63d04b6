"""The unit and the origin of a data set's world and clock make no difference to what is trained: files to PSNR."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tiny import SIZE, TinyRun, tiny_config, tiny_scene
from tiny_film import tiny_film

from datasets.scene import View
from pipeline.config.compose import Command
from pipeline.config.schema import Config, EvaluateConfig
from pipeline.config.train_schema import DensifyConfig, LearningRates
from pipeline.data.prepare import prepare
from pipeline.evaluation.quick_evaluate import quick_evaluate
from pipeline.model.initialise import initialise
from pipeline.stages.inputs import data_hash
from pipeline.stages.run import run
from pipeline.stages.stages import NAMES
from pipeline.training.loop import train
from rasterizer import Rasterizer

ITERATIONS = 110  # training amplifies rounding: 1e-5 dB after 110 iterations, 0.2 to 1 dB after 200
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # COLMAP's camera axes <-> Blender's


@dataclass(frozen=True)
class Units:
    """Of a data set whose world and clock are others than those its scene was made in."""

    scale: float = 1.0
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    clock: Callable[[float], float] = lambda seconds: seconds

    def pose(self, view: View) -> list[list[float]]:
        """Camera-to-world, Blender axes."""
        pose = np.linalg.inv(view.camera.world_to_cam) @ FLIP
        pose[:3, 3] = self.scale * pose[:3, 3] + self.shift
        return pose.tolist()


WORLDS = {
    "kilometres": Units(scale=1e-3),
    "millimetres": Units(scale=1e3),
    "far": Units(shift=(1e4, -2e4, 5e3)),
    "far, in millimetres": Units(scale=1e3, shift=(1e7, 2e7, 0.0)),
}
CLOCKS = {
    "ticks": Units(clock=lambda s: round(70 * s)),
    "epoch, far, in kilometres": Units(1e-3, (1e4, 0.0, 0.0), lambda s: 1.7e9 + s),
}
ALL = {**WORLDS, **CLOCKS}
# Each kind of change at least once.
TRAINED = ("kilometres", "far, in millimetres", "ticks", "epoch, far, in kilometres")


def write_photographs(root: Path, units: Units) -> Path:
    """tiny_scene in the D-NeRF layout."""
    scene = tiny_scene()
    for split, views in (("train", scene.train), ("test", scene.test)):
        (root / split).mkdir(parents=True)
        frames = []
        for index, view in enumerate(views):
            Image.fromarray(view.image).save(root / split / f"r_{index}.png")
            frames.append(
                {
                    "file_path": f"./{split}/r_{index}",
                    "time": units.clock(view.time),
                    "transform_matrix": units.pose(view),
                }
            )
        angle = 2 * np.arctan(0.5 * SIZE / scene.train[0].camera.fx)
        (root / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    return root


def write_film(root: Path, units: Units) -> Path:
    """tiny_film in the Plenoptic Video layout's form of images."""
    film = tiny_film(held_out=("cam00",))
    (root / "images").mkdir(parents=True)
    for split, views in (("train", film.train), ("test", film.test)):
        frames = []
        for view in views:
            name = f"images/{view.name.split('/')[1]}"
            Image.fromarray(view.image).save(root / f"{name}.png")
            frames.append({"file_path": name, "time": units.clock(view.time), "transform_matrix": units.pose(view)})
        focal = film.train[0].camera.fx
        content = {"w": SIZE, "h": SIZE, "fl_x": focal, "fl_y": focal, "cx": SIZE / 2, "cy": SIZE / 2}
        (root / f"transforms_{split}.json").write_text(json.dumps({**content, "frames": frames}))
    return root


def config(folder: Path, reader: str, seed: int = 0) -> Config:
    densify = DensifyConfig(start=20, stop=100, every=20, space_gradient=1e-4, opacity_reset_every=0, max_gaussians=400)
    cfg = tiny_config(
        ITERATIONS, densify=densify, eval_every=ITERATIONS, orders_at=[30, 60, 90, 60, 90], lr=LearningRates(factor=8)
    )
    scene = replace(cfg.scene, name="tiny", reader=reader, path=str(folder), downscale=1, cache=str(folder / "cache"))
    scene = replace(scene, init_box=[-1.2, 1.2])  # so few points are too far apart in all that the film's cameras see
    return replace(cfg, scene=scene, init=replace(cfg.init, source="random"), seed=seed)


@dataclass(frozen=True)
class Given(Command):
    """A command whose configuration is this one, on every kind of scene."""

    cfg: Config

    def config(self, capture: str | None = None) -> Config:
        return self.cfg

    preset = config


WRITERS = {"dnerf": write_photographs, "plenoptic": write_film}


def trained_psnr(folder: Path, reader: str, seed: int = 0) -> float:
    """Of the test views, after the whole way from files; the run's own evaluation."""
    cfg = config(folder, reader, seed)
    data = prepare(cfg, lambda line: None)
    model = initialise(data.scene, cfg, np.random.default_rng([cfg.seed, 0]))
    frame = Rasterizer(threads=1)
    done = train(
        model,
        data.scene,
        cfg,
        TinyRun(folder / f"run{seed}"),
        lambda model, progress: quick_evaluate(model, data.scene, cfg, frame),
    )
    return quick_evaluate(done.model, data.scene, cfg, frame)["psnr"]


@pytest.fixture(scope="module", params=list(WRITERS))
def usual(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[float]]:
    """The reader, and the PSNR in the units the scene was made in, for three seeds."""
    folder = WRITERS[request.param](tmp_path_factory.mktemp("usual") / "scene", Units())
    return request.param, [trained_psnr(folder, request.param, seed) for seed in (0, 1, 2)]


@pytest.mark.parametrize("units", TRAINED)
def test_training_gives_the_same_psnr_in_any_units(usual: tuple[str, list[float]], tmp_path: Path, units: str) -> None:
    reader, psnr = usual
    found = trained_psnr(WRITERS[reader](tmp_path / "scene", ALL[units]), reader)
    assert min(psnr) > 20  # it has learnt: 15 dB without a Gaussian
    # What remains is rounding: 1e-5 dB at most where this was written, with seeds 2 dB apart.
    assert abs(found - psnr[0]) < 5e-3 * np.ptp(psnr)


def test_a_run_in_other_units_says_so_and_is_not_taken_for_another(tmp_path: Path) -> None:
    """A line of text, canonical.json, and a run folder that refuses the same scene in other units."""
    data, lines = tmp_path / "data", []
    cfg = config(write_photographs(data, ALL["millimetres"]), "dnerf")
    cfg = replace(cfg, out=str(tmp_path / "run"), evaluate=EvaluateConfig(lpips=False, renders=1, best_on_test=False))
    run(Given((), cfg), lines.append)
    assert lines[0].startswith("normalised: x → (x - (") and lines[0].endswith(")) × 0.001")
    frame = json.loads((tmp_path / "run" / "canonical.json").read_text())
    assert frame["scale"] == pytest.approx(1e-3) and np.abs(frame["centre"]).max() < 1e-6 and frame["time_scale"] == 1.0
    lines.clear()
    run(Given((), cfg), lines.append)
    assert lines[1].startswith("3 of 3 test views are training views")  # as tiny_scene has them
    assert [line.split(": already done")[0] for line in lines[2:]] == list(NAMES)
    shutil.rmtree(data)
    write_photographs(data, ALL["far"])
    with pytest.raises(ValueError, match="made from other data than .*, or normalised otherwise") as caught:
        run(Given((), cfg), lines.append)
    assert "\n" not in str(caught.value)


def test_the_frame_is_part_of_what_a_run_is_made_from(tmp_path: Path) -> None:
    """Also where two frames lead to one and the same canonical scene."""
    cfg = config(write_photographs(tmp_path / "scene", ALL["far"]), "dnerf")
    data = prepare(cfg, lambda line: None)
    other = replace(data, canonical=replace(data.canonical, scale=2.0))
    usual = replace(data, canonical=type(data.canonical)())
    assert len({data_hash(one) for one in (data, other, usual)}) == 3


def test_random_points_of_a_film_without_depths_start_before_its_cameras(tmp_path: Path) -> None:
    """Not in a cube around the cameras, which look out of it."""
    cfg = config(write_film(tmp_path / "scene", Units()), "plenoptic")
    scene = prepare(replace(cfg, scene=replace(cfg.scene, init_box=None)), lambda line: None).scene
    low, high = (np.asarray(corner) for corner in scene.init_box)
    places = np.stack([view.camera.position for view in scene.train])
    assert not ((places > low) & (places < high)).all(axis=1).any()
    middle = (low + high) / 2
    assert all((view.camera.world_to_cam[:3] @ [*middle, 1.0])[2] > 0 for view in scene.train)
