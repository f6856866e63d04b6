"""Figures of a run: their sentences against closed forms and loops, and which view they are drawn of."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import generator, random_gaussians
from moving_gaussian import DEPTH, DT, FOCAL, VELOCITY, moving_gaussian, scene_with_truth
from PIL import Image
from tiny import evaluation_config, random_model, tiny_scene
from tiny_film import tiny_film

from datasets.scene import Scene
from pipeline.evaluation.renderer import Renderer
from pipeline.figures.__main__ import figures_of, markdown
from pipeline.figures.motion import MEASURED, TRUE, flow_figure, most_moving
from pipeline.figures.slices import slices_figure
from pipeline.figures.time_distribution import counts_over
from pipeline.model.model import Model, ModelKind
from rasterizer import Rasterizer
from rasterizer.reference.render import slice_in_time


def renderer_of(model: Model, scene: Scene) -> Renderer:
    return Renderer(model, scene, evaluation_config(), Rasterizer(threads=1))


def of_film(frames: int = 6) -> Renderer:
    return renderer_of(moving_gaussian(VELOCITY), tiny_film(frames=frames))


@pytest.mark.parametrize("times_as_fast, off", [(1.0, 0.0), (0.5, 0.5)])
def test_flow_beside_the_truth(tmp_path: Path, times_as_fast: float, off: float) -> None:
    renderer = renderer_of(moving_gaussian(times_as_fast * VELOCITY), scene_with_truth(tmp_path))
    view = most_moving(renderer)
    assert view.source == TRUE and view.moving is not None
    length = FOCAL * VELOCITY * DT / DEPTH
    figure = flow_figure(renderer, view)
    assert f"is {length:.2f} px long on average" in figure.seen
    assert f"the rendered flow is off by {off * length:.2f} px, {off:.2f} of it" in figure.seen
    assert flow_figure(renderer, view).png == figure.png, "the same run gives the same bytes"


def test_flow_beside_opencvs_where_a_camera_stands_still() -> None:
    renderer = of_film()
    view = most_moving(renderer)
    assert view.source == MEASURED and view.known is not None and view.known.flow_dt == pytest.approx(0.1)
    assert "the flow by OpenCV is " in flow_figure(renderer, view).seen
    # The disc moves by 3 pixels a frame; its edge is all that OpenCV has to follow.
    flow = view.known.flow[0][view.known.flow_valid]
    assert flow.max() == pytest.approx(3.0, abs=1.0)


def test_a_moving_camera_has_no_flow_to_compare_with() -> None:
    renderer = renderer_of(moving_gaussian(VELOCITY), tiny_scene())
    view = most_moving(renderer)
    assert view.source is None and view.index == 1, "the middle one of three"
    assert "no camera stands still in the test views" in flow_figure(renderer, view).seen


def test_growth_is_counted_as_by_a_loop() -> None:
    model = random_model(ModelKind("full", 0, 1), 60)
    renderer, times = renderer_of(model, tiny_scene()), np.linspace(0.0, 1.0, 40)
    seen_until, alive = counts_over(renderer, times)
    ever = np.zeros(60, bool)
    for i, time in enumerate(times):
        now = slice_in_time(model.gaussians(), float(time)).marginal.numpy() >= 0.05
        ever |= now
        assert alive[i] == now.sum()
        # A Gaussian that lives between two of the times is in the count, and not in the loop's
        assert ever.sum() <= seen_until[i] <= ever.sum() + 3


def test_slices_of_a_still_camera_have_the_truth_beside_them() -> None:
    renderer = of_film()
    view = most_moving(renderer)
    figure = slices_figure(renderer, view)
    assert "its true frames are beside it (6 of them)" in figure.seen
    assert view.moving is not None
    row = int(figure.seen.split()[1])
    assert view.moving[row].sum() == view.moving.sum(axis=1).max()
    moving_camera = renderer_of(moving_gaussian(VELOCITY), tiny_scene())
    assert "beside" not in slices_figure(moving_camera, most_moving(moving_camera)).seen


def test_a_slice_of_another_run_is_beside() -> None:
    """Of a model at rest no pixel changes."""
    scene = tiny_scene()
    moving, still = renderer_of(moving_gaussian(VELOCITY), scene), renderer_of(moving_gaussian(0.0), scene)
    alone = slices_figure(moving, most_moving(moving))
    both = slices_figure(moving, most_moving(moving), ("no_4drot", still))
    assert ", of no_4drot by " in both.seen and "no_4drot" not in alone.seen
    widths = [Image.open(io.BytesIO(figure.png)).width for figure in (alone, both)]
    assert widths[1] > 1.2 * widths[0]
    of_moving, of_still = (float(word.rstrip(",.")) for word in re.findall(r"by (\S+)", both.seen))
    assert of_still < of_moving


@pytest.mark.filterwarnings("error:constrained_layout")  # what is marked lies outside of the axes
def test_all_figures_are_drawn_and_described(tmp_path: Path) -> None:
    renderer = of_film()
    figures = list(figures_of(renderer, tmp_path))
    assert [figure.name for figure in figures] == ["flow", "time_maps", "lifetimes", "slices", "growth", "film"]
    assert (tmp_path / "bullet_time.mp4").stat().st_size > 1000
    for figure in figures:
        assert figure.seen.endswith(".") and "nan" not in figure.seen
        assert min(Image.open(io.BytesIO(figure.png)).size) > 150
        assert f"![{figure.title}]({figure.file})" in markdown("tiny", figures)


def test_a_static_model_has_new_views_only(tmp_path: Path) -> None:
    model = moving_gaussian(0.0)
    static = dict(model.parameters)
    del static["quat_right"]
    static |= {name: static[name][:, :3].contiguous() for name in ("mean", "log_scale")}
    found = figures_of(renderer_of(Model(ModelKind("static", 0, 0), static), tiny_scene(static=True)), tmp_path)
    assert [figure.name for figure in found] == ["film"]


def test_gaussians_on_shared_trajectories_have_paths_instead_of_lifetimes(tmp_path: Path) -> None:
    gaussians = replace(random_gaussians(9, "shared", generator(2)), opacity_logit=torch.arange(9).double())
    renderer = renderer_of(Model.from_gaussians(gaussians.to(torch.float32)), tiny_film())
    figures = list(figures_of(renderer, tmp_path))
    assert [figure.name for figure in figures] == ["flow", "slices", "paths", "film"]
    camera = most_moving(renderer).target.camera
    lengths, times = [], np.linspace(renderer.scene.time_start, renderer.scene.time_end, 60)
    for row in range(4, 9):  # the more opaque half, by the float64 reference
        one = gaussians.rows(torch.tensor([row]))
        points = np.concatenate([slice_in_time(one, float(time)).mean.numpy() for time in times])
        x, y, z = camera.world_to_cam[:3, :3] @ points.T + camera.world_to_cam[:3, 3:]
        assert (z > 0).all()
        lengths.append(np.hypot(np.diff(camera.fx * x / z), np.diff(camera.fy * y / z)).sum())
    expected = f"half of them are longer than {np.median(lengths):.1f} px, the longest is {max(lengths):.1f} px."
    assert figures[2].seen == f"Paths of 5 Gaussians over all of the scene's time: {expected}"


def test_time_maps_are_those_of_the_gaussian_that_is_seen() -> None:
    model = moving_gaussian(0.0)
    shifted = model.parameters["mean"].clone()
    shifted[:, 3] = 0.25
    scales = model.parameters["log_scale"].clone()
    scales[:, 3] = float(np.log(0.4))
    renderer = renderer_of(Model(model.kind, model.parameters | {"mean": shifted, "log_scale": scales}), tiny_film())
    camera = replace(tiny_film().test[0].camera, world_to_cam=np.eye(4))
    mean, variance, alpha = renderer.time_maps(camera, 0.3)
    assert alpha[16, 16] > 0.5
    # Sums over one Gaussian divided by its alpha: float32
    assert mean[16, 16] == pytest.approx(0.25, abs=1e-6) and variance[16, 16] == pytest.approx(0.16, abs=1e-6)
    assert torch.isfinite(torch.from_numpy(mean)).all()
