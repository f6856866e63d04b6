"""The page's picture against the kernel's, at cameras and times, of each kind of model."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import camera_looking_at
from playwright.sync_api import Browser
from tiny import tiny_config
from viewed import SIZE, always_there, opened, over_environment_map, picture, viewed_model, viewed_scene, write_page

from pipeline.evaluation.renderer import Renderer
from pipeline.model.model import Model
from pipeline.view.live.feed import Feed
from pipeline.view.live.server import Address, LiveServer
from pipeline.view.pack import lines_of, pack, seen_from_to
from pipeline.view.viewer import live_page
from rasterizer import Rasterizer

# 8-bit pixels alone leave 58.9 dB. Quantisation and half floats leave 52 to 57 dB of these random colours, and 46 among
# the Gaussians. A wrong rule (no dilation, another cut-off, a time off by a frame) leaves less than 35.
LEAST_DB = 44.0

KINDS = {
    "static": viewed_model("static"),
    "separable": viewed_model("separable", fourier_order=1),
    "moving": viewed_model("full"),
    "4DSH": viewed_model("full", fourier_order=2),
    "shared motion": viewed_model("shared"),
    "shared motion, always there, 4DSH": always_there(viewed_model("shared", fourier_order=2)),
    "environment map": over_environment_map(viewed_model("full")),
}


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean((one - other) ** 2)))


@pytest.mark.parametrize("kind", KINDS)
def test_picture_is_the_kernels(browser: Browser, tmp_path: Path, kind: str) -> None:
    model, scene = KINDS[kind], viewed_scene(static=kind == "static")
    renderer = Renderer(model, scene, tiny_config(), Rasterizer(threads=1))
    with opened(browser, write_page(tmp_path / "viewer.html", scene, model)) as page:
        inside = camera_looking_at(
            (0.3, -0.2, -0.6), *SIZE, focal=60, principal=(50.0, 51.0)
        )  # Gaussians behind, too near
        for camera, time in ((scene.test[1].camera, 0.41), (scene.train[1].camera, 1.0), (inside, 0.07)):
            wanted = renderer.image(camera, time)
            assert wanted.std() > 0.05  # something is to be seen
            assert psnr(picture(page, camera, time), wanted) > LEAST_DB


def test_a_page_of_a_run_in_training_shows_models_of_either_kind(browser: Browser) -> None:
    """The page replaces a model that shares trajectories by one that does not, and the reverse."""
    scene, feed = viewed_scene(), Feed()
    feed.offer(0, pack(KINDS["moving"], scene))
    camera = scene.test[1].camera
    page_text = live_page("live", scene, tiny_config())
    with LiveServer(Address("127.0.0.1", 0), page_text, feed) as server, opened(browser, server.url) as page:
        for iteration, kind in enumerate(("shared motion", "moving", "shared motion"), 1):
            feed.offer(iteration, pack(KINDS[kind], scene))
            page.wait_for_function("n => viewer.stage.panes[0].model.header.iteration === n", arg=iteration)
            renderer = Renderer(KINDS[kind], scene, tiny_config(), Rasterizer(threads=1))
            assert psnr(picture(page, camera, 0.41), renderer.image(camera, 0.41)) > LEAST_DB
        feed.end()


def test_speeds_are_those_along_trajectories_too(browser: Browser, tmp_path: Path) -> None:
    """The range that is coloured: quantiles over Gaussians of the mean speed at eight times."""
    scene, model = viewed_scene(), KINDS["shared motion"]
    lines, trajectories = lines_of(model), model.trajectories
    assert lines.velocity is not None and lines.weights is not None and trajectories is not None
    times = (np.arange(8) + 0.5) / 8
    moving = [lines.velocity + lines.weights @ trajectories.drift(time, 0.0).double().numpy() for time in times]
    speed = np.mean([np.linalg.norm(one, axis=1) for one in moving], axis=0)
    first, last = seen_from_to(lines.mean_t, lines.sigma_t, scene.time_start, scene.time_end)
    with opened(browser, write_page(tmp_path / "viewer.html", scene, model)) as page:
        found = page.evaluate("viewer.stage.panes[0].model.ranges.speed")
    # Rounding of what a Gaussian is seen for little time changes its speed.
    assert found == pytest.approx(np.quantile(speed[first <= last], [0.05, 0.95]), rel=0.02)


def test_near_plane_and_background_are_the_scenes(browser: Browser, tmp_path: Path) -> None:
    scene = replace(viewed_scene(), unit=8.0, background=(0.9, 0.5, 0.1))  # near plane at 1.6
    model, camera = viewed_model("full"), viewed_scene().test[0].camera
    near = camera_looking_at((0.0, -0.4, -1.6), *SIZE, focal=90)
    renderer = Renderer(model, scene, tiny_config(), Rasterizer(threads=1))
    with opened(browser, write_page(tmp_path / "viewer.html", scene, model)) as page:
        for found in (camera, near):
            assert psnr(picture(page, found, 0.5), renderer.image(found, 0.5)) > LEAST_DB


def test_models_side_by_side_are_each_their_own(browser: Browser, tmp_path: Path) -> None:
    scene, models = viewed_scene(), [KINDS["moving"], KINDS["separable"]]
    with opened(browser, write_page(tmp_path / "viewer.html", scene, *models)) as page:
        for index, model in enumerate(models):
            renderer = Renderer(model, scene, tiny_config(), Rasterizer(threads=1))
            camera = scene.test[0].camera
            assert psnr(picture(page, camera, 0.6, index), renderer.image(camera, 0.6)) > LEAST_DB
        assert page.locator("figcaption").all_inner_texts()[:2] == ["model 0", "model 1"]


def test_no_gaussian_in_view_is_the_background(browser: Browser, tmp_path: Path) -> None:
    scene, model = viewed_scene(), viewed_model("full", count=1)
    gone = Model(model.kind, {**model.parameters, "opacity_logit": model.parameters["opacity_logit"] - 30})
    with opened(browser, write_page(tmp_path / "viewer.html", scene, gone)) as page:
        found = picture(page, scene.test[0].camera, 0.5)
        assert np.abs(found - scene.background).max() <= 0.5 / 255 + 1e-6
