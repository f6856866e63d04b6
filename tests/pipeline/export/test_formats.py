"""Each format, read back by another reader, renders as the kernel does, to the format's precision."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import fourdgs
import numpy as np
import pytest
import torch
from builders import generator, make_request, random_gaussians
from export_readers import in_time, read_fourdgs, read_ftgs, read_glb, read_splat, read_splatv, read_spz, static_at

from pipeline.evaluation.image_metrics import psnr
from pipeline.export.formats import FILM, FORMATS, FRAME
from pipeline.export.source import Timeline
from pipeline.export.splats import frame_at, moving_gaussians
from pipeline.model.model import Model
from pipeline.model.ply import load_ply
from rasterizer import Camera, Rasterizer
from rasterizer.covariance import rotation_3d

START, DURATION, TIME = 0.1, 0.8, 0.45
LINE = Timeline(START, DURATION, seconds=4.0, frames=25)


@pytest.fixture(scope="module")
def model() -> Model:
    """Without time-varying colour, which no temporal format has; colours of degree 0 within [0, 1]."""
    return model_of(sh_degree=3)


def model_of(sh_degree: int) -> Model:
    gaussians = random_gaussians(150, "full", generator(5), sh_degree=sh_degree, fourier_order=0).to(torch.float32)
    gaussians.sh.mul_(0.7).clamp_(-0.9, 0.9)
    return Model.from_gaussians(gaussians)


def image(model: Model, time: float = 0.0) -> np.ndarray:
    return Rasterizer(threads=1).render(model.gaussians(), make_request(time=time)).color.numpy()


def without_directions(model: Model) -> Model:
    return Model.from_gaussians(
        type(model.gaussians()).from_tensors(model.parameters | {"sh": model.parameters["sh"][:, :1].contiguous()})
    )


def test_ply_and_gltf_are_exact(model: Model, tmp_path: Path) -> None:
    frame = frame_at(model, TIME, DURATION)
    (tmp_path / "frame.ply").write_bytes(FORMATS["ply"].content(frame))
    assert np.array_equal(image(load_ply(tmp_path / "frame.ply")), image(frame)), "the same bits"
    # activated values in float32, and rotated SH: 1e-5 is a few hundred roundings
    assert np.abs(image(read_glb(FORMATS["glb"].content(frame))) - image(frame)).max() < 1e-5
    assert np.abs(image(frame) - image(model, TIME)).max() < 1e-4


def test_gltf_is_read_by_another_library(model: Model, tmp_path: Path) -> None:
    frame = frame_at(model, TIME, DURATION)
    path = tmp_path / "frame.glb"
    path.write_bytes(FORMATS["glb"].content(frame))
    found = fourdgs.from_gltf(path).gaussians
    assert found.count == len(frame) and found.sh_degree == 3
    expected = frame.parameters["mean"].numpy() * [1, -1, -1]
    assert found.positions == pytest.approx(expected, abs=1e-6)
    assert found.colors[:, 3] == pytest.approx(torch.sigmoid(frame.parameters["opacity_logit"]).numpy(), abs=1e-6)


def test_splat_keeps_eight_bits(model: Model) -> None:
    plain = without_directions(model)
    frame = frame_at(plain, TIME, DURATION)
    read = read_splat(FORMATS["splat"].content(frame))
    size = torch.sigmoid(read.parameters["opacity_logit"]) * read.parameters["log_scale"].sum(dim=1).exp()
    assert (size.diff() <= 0.2 * size[:-1]).all(), "largest first, but for rounded opacities"
    # Opacity and colour are off by at most 1/510, rotations by 1/256 a component. Several layers of splats whose edges
    # turn by 0.01 rad: RMS 0.01 of full scale
    assert psnr(image(read), image(frame)) > 40


def test_spz_keeps_its_bits(model: Model) -> None:
    frame = frame_at(model, TIME, DURATION)
    read = read_spz(FORMATS["spz"].content(frame))
    assert (read.parameters["mean"] - frame.parameters["mean"]).abs().max() <= 0.5 / 4096 + 1e-6
    assert (read.parameters["log_scale"] - frame.parameters["log_scale"]).abs().max() <= 0.5 / 16 + 1e-6
    turn = rotation_3d(read.parameters["quat_left"]).transpose(1, 2) @ rotation_3d(frame.parameters["quat_left"])
    # Components are off by 1/1445, the fourth follows from them: angles below 2 · 4/1445 = 6e-3, cosines above 1 - 2e-5
    assert turn.diagonal(dim1=1, dim2=2).abs().min() > 1 - 2e-5
    rest = (read.parameters["sh"] - frame.parameters["sh"])[:, 1:].abs()
    assert rest.max() <= 0.5 / 128 + 1e-6
    # Scales off by up to 3 %, opacities and colours of degree 0 by 1/510 and 1/76 f_dc, SH by 0.002 RMS
    assert psnr(image(read), image(frame)) > 40


def test_spz_refuses_what_its_fixed_point_lacks(model: Model) -> None:
    frame = frame_at(model, TIME, DURATION)
    far = Model(frame.kind, frame.parameters | {"mean": frame.parameters["mean"] + 3000})
    with pytest.raises(ValueError, match="spz: expected positions within ± 2048"):
        FORMATS["spz"].content(far)


def test_ftgs_ply_is_exact(model: Model) -> None:
    moving = moving_gaussians(model, START, DURATION)
    read = in_time(read_ftgs(FORMATS["ftgs.ply"].content(moving, LINE)), LINE)
    for time in (START, TIME, START + DURATION):
        # float32 positions, velocities and times of about 1: 1e-4 as for a frame
        assert np.abs(image(static_at(read, time)) - image(model, time)).max() < 1e-4


def test_splatv_keeps_half_precision(model: Model) -> None:
    plain = without_directions(model)
    read = in_time(read_splatv(FORMATS["splatv"].content(moving_gaussians(plain, START, DURATION), LINE)), LINE)
    for time in (START, TIME, START + DURATION):
        # As .splat; times are off by 1/4096 of the duration at speeds of about 1 in a scene of size 2
        assert psnr(image(static_at(read, time)), image(plain, time)) > 40


@pytest.mark.parametrize("known", [True, False])
def test_splatv_begins_with_a_camera_that_sees_the_gaussians(model: Model, known: bool) -> None:
    """Its `rotation` is camera-to-world, its position the centre; splaTV fails without one."""
    camera = make_request().camera
    line = replace(LINE, camera=camera) if known else LINE
    content = FORMATS["splatv"].content(moving_gaussians(model, START, DURATION), line)
    length = int.from_bytes(content[4:8], "little")
    (entry,) = json.loads(content[8 : 8 + length])[0]["cameras"]
    pose = np.eye(4)
    pose[:3, :3] = np.array(entry["rotation"]).T
    pose[:3, 3] = -pose[:3, :3] @ entry["position"]
    read = Camera(
        entry["width"], entry["height"], entry["fx"], entry["fy"], entry["width"] / 2, entry["height"] / 2, pose
    )
    if known:
        np.testing.assert_allclose(pose, camera.world_to_cam, atol=1e-12)
        assert (read.width, read.fx, read.fy) == (camera.width, camera.fx, camera.fy)
    rasterizer = Rasterizer(threads=1)
    rasterizer.render(model.gaussians(), make_request(camera=read, time=TIME))
    assert rasterizer.visible > 0.8 * rasterizer.alive > 0


def test_a_frame_without_gaussians_is_no_gltf(model: Model) -> None:
    with pytest.raises(ValueError, match="glb: expected a Gaussian in the frame at least"):
        FORMATS["glb"].content(frame_at(model, 1e6, DURATION))


def test_fourdgs_keeps_its_bounds(model: Model) -> None:
    read = in_time(
        read_fourdgs(FORMATS["4dgs"].content(moving_gaussians(model, START, DURATION), LINE), LINE.seconds), LINE
    )
    for time in (START, TIME, START + DURATION):
        # SH bytes are off by 1/64, opacities and colours by 0.5/255; the format's profile "fine" bounds the rest
        assert psnr(image(static_at(read, time)), image(model, time)) > 38


def test_a_degree_without_directions_is_written(tmp_path: Path) -> None:
    model = model_of(sh_degree=0)
    frame, moving = frame_at(model, TIME, DURATION), moving_gaussians(model, START, DURATION)
    for form in FORMATS.values():
        if form.holds == FRAME:
            assert form.content(frame)
        elif form.holds == FILM:
            assert form.content(moving, LINE)
    assert fourdgs.from_gltf(written(tmp_path / "a.glb", FORMATS["glb"].content(frame))).gaussians.sh_degree == 0


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def test_times_are_given_in_seconds_of_a_run_and_as_they_are_in_a_file() -> None:
    of_run, of_file = Timeline(2.0, 3.0, clock=0.5), Timeline(2.0, 3.0)
    assert [of_run.at(seconds) for seconds in (0.0, 0.5, 1.5, 1.505)] == [2.0, 3.0, 5.0, 5.0]  # shown as 1.51
    assert of_file.at(2.5) == 2.5
    for line, outside in ((of_run, 2.0), (of_file, 0.5)):
        with pytest.raises(ValueError, match="--times: expected times in"):
            line.at(outside)
