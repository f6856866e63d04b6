"""What a viewer's data hold: motion against the reference implementation, rounding against its bounds."""

from __future__ import annotations

import base64
import json
import math
import zlib

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from viewed import always_there, over_environment_map, viewed_model, viewed_scene

from pipeline.model.model import Model
from pipeline.view.pack import (
    ENVIRONMENT_STEP,
    LIFETIME,
    LOGIT_STEP,
    POSITION_PX,
    ROTATION_STEP,
    SCALE_STEP,
    SH_STEP,
    Packed,
    lines_of,
    pack,
    quantised,
)
from rasterizer.reference.render import slice_in_time
from rasterizer.trajectories import Trajectories


@pytest.mark.parametrize("motion", ["static", "separable", "full"])
@pytest.mark.parametrize("time", [-0.2, 0.45, 1.3])
def test_lines_are_the_gaussians_conditioned_on_time(motion, time: float) -> None:
    """slice_in_time conditions in float64 at each time; a line is computed once for all of them."""
    model = viewed_model(motion)
    found = lines_of(model)
    wanted = slice_in_time(model.gaussians().to(torch.float64), time)
    mean, marginal = found.mean, np.ones(len(found.mean))
    if found.velocity is not None and found.mean_t is not None and found.sigma_t is not None:
        mean = found.mean + found.velocity * (time - found.mean_t)[:, None]
        marginal = np.exp(-0.5 * ((time - found.mean_t) / found.sigma_t) ** 2)
    turn = Rotation.from_rotvec(found.rotation).as_matrix()
    covariance = np.einsum("nij,nj,nkj->nik", turn, found.scale**2, turn)
    # Float64 throughout; the eigenvectors of a needle lose a few digits.
    assert mean == pytest.approx(wanted.mean.numpy(), abs=1e-9)
    assert marginal == pytest.approx(wanted.marginal.numpy(), abs=1e-9)
    assert covariance == pytest.approx((wanted.factor @ wanted.factor.mT).numpy(), abs=1e-9)


def test_gaussians_that_are_never_drawn_are_left_out() -> None:
    model, scene = viewed_model("full", count=4), viewed_scene()
    parameters = {name: tensor.clone() for name, tensor in model.parameters.items()}
    parameters["quat_left"][:] = parameters["quat_right"][:] = torch.tensor([1.0, 0, 0, 0])
    parameters["opacity_logit"][:] = torch.tensor([2.0, -5.6, -5.4, 2.0])  # logit of 1/255: -5.54
    parameters["mean"][:, 3] = torch.tensor([0.5, 0.5, 0.5, 1.5])
    parameters["log_scale"][:, 3] = torch.tensor([-2.0, -2.0, -2.0, math.log(0.2)])  # 1.5 - 2.45 · 0.2 > 1
    assert pack(Model(model.kind, parameters), scene).header["count"] == 2
    parameters["log_scale"][3, 3] = math.log(0.21)
    assert pack(Model(model.kind, parameters), scene).header["count"] == 3


def unpacked(packed: Packed) -> dict[str, np.ndarray]:
    """As model.js does: column name -> (N, C) float64."""
    data, place, found = np.frombuffer(zlib.decompress(packed.data), np.uint8), 0, {}
    for column in packed.header["columns"]:
        rows = math.prod(packed.header["environment"]) if column["name"] == "environment" else packed.header["count"]
        components = []
        for low, size in zip(column["low"], column["bytes"]):
            numbers = np.full(rows, low, np.int64)
            for byte in range(size):
                numbers += data[place : place + rows].astype(np.int64) << (8 * byte)
                place += rows
            components.append(numbers * column["step"])
        found[column["name"]] = np.stack(components, axis=1)
    assert place == len(data)
    return found


def test_what_is_read_back_is_within_the_stated_errors() -> None:
    model, scene = over_environment_map(viewed_model("full", fourier_order=1)), viewed_scene()
    found = unpacked(pack(model, scene))
    t = lines_of(model)
    assert t.velocity is not None and t.mean_t is not None
    centre, sigma = found["mean_t"][:, 0], np.exp(found["log_sigma_t"][:, 0])
    first, last = np.maximum(0, centre - LIFETIME * sigma), np.minimum(1, centre + LIFETIME * sigma)
    # Rows are in another order: each belongs to the model's Gaussian of the nearest coefficients of colour.
    colours = t.sh.reshape(len(t.sh), -1)
    row = [int(np.abs(colours - one).max(axis=1).argmin()) for one in found["sh"]]
    assert len(set(row)) == len(row)
    assert np.abs(found["sh"] - colours[row]).max() <= SH_STEP / 2 + 1e-6
    assert np.abs(found["opacity_logit"][:, 0] - t.opacity_logit[row]).max() <= LOGIT_STEP / 2 + 1e-9
    assert np.abs(found["log_scale"] - np.log(t.scale[row])).max() <= SCALE_STEP / 2 + 1e-9
    step = POSITION_PX * scene.unit / max(view.camera.fy for view in scene.train)
    for share in (-1.0, 0.0, 0.6, 1.0):  # of the way from the middle to the end of what is seen
        time = 0.5 * (first + last) + share * 0.5 * (last - first)
        wanted = t.mean[row] + t.velocity[row] * (time - t.mean_t[row])[:, None]
        # Half a step of the middle, half a step of the way.
        assert np.abs(found["middle"] + share * found["reach"] - wanted).max() <= step
    image = model.environment_map.image.numpy().reshape(3, -1).T
    assert np.abs(found["environment"] - image).max() <= ENVIRONMENT_STEP / 2 + 1e-6


@pytest.mark.parametrize("still_there", [False, True])
def test_shared_motion_that_is_read_back_is_within_the_stated_errors(still_there: bool) -> None:
    """Against moved Gaussians, conditioned on time in float64, also before and after the span of the trajectories."""
    model, scene = viewed_model("shared"), viewed_scene()
    model = always_there(model) if still_there else model
    packed = pack(model, scene)
    found, stored = unpacked(packed), packed.header["trajectories"]
    points = np.frombuffer(base64.b64decode(stored["control_points"]), "<f4").reshape(-1, stored["count"], 6)
    shared = Trajectories(torch.from_numpy(points.astype(np.float64)), tuple(stored["span"]))
    gaussians = model.gaussians().to(torch.float64)
    colours = gaussians.sh.flatten(1).numpy()
    row = [int(np.abs(colours - one).max(axis=1).argmin()) for one in found["sh"]]
    assert len(set(row)) == len(row)
    centre, sigma = found["mean_t"][:, 0], np.exp(found["log_sigma_t"][:, 0])
    first, last = np.maximum(0, centre - LIFETIME * sigma), np.minimum(1, centre + LIFETIME * sigma)
    step = POSITION_PX * scene.unit / max(view.camera.fy for view in scene.train)
    for time in (0.0, 0.13, 0.5, 0.85, 0.97):
        seen = (first <= time) & (time <= last)
        assert seen.sum() > 10
        share = (time - 0.5 * (first + last)) / np.maximum(0.5 * (last - first), 1e-9)
        displacement, turn = np.split(found["weights"] @ shared.values(time).numpy(), 2, axis=1)
        place = found["middle"] + share[:, None] * found["reach"] + displacement
        wanted = slice_in_time(gaussians, time)
        # Control points of float32 lose five digits less than this.
        assert np.abs(place - wanted.mean.numpy()[row])[seen].max() <= step * (1 + 1e-5)
        # Turned as the wanted covariance is: rounding turns a Gaussian by at most half a step about an axis for each of
        # two rotation vectors, and changes its scales by half a step.
        axes = (Rotation.from_rotvec(turn) * Rotation.from_rotvec(found["rotation"])).as_matrix()
        scale = np.exp(found["log_scale"])
        covariance = np.einsum("nij,nj,nkj->nik", axes, scale**2, axes)
        factor = wanted.factor.numpy()[row]
        error = np.abs(covariance - factor @ factor.transpose(0, 2, 1)).max(axis=(1, 2))
        turned = 2 * math.sqrt(3) * ROTATION_STEP / 2
        assert np.max(error / (scale**2).max(axis=1)) <= 2 * turned + 1.01 * SCALE_STEP


def test_trajectories_that_stand_still_take_no_bytes() -> None:
    model, scene = viewed_model("shared"), viewed_scene()
    still = Trajectories.still(5, 4, (0.0, 1.0))
    packed = pack(Model(model.kind, model.parameters, trajectories=still), scene)
    assert {tuple(column["bytes"]) for column in packed.header["columns"] if column["name"] == "weights"} == {(0,) * 5}


def test_columns_take_the_bytes_they_need() -> None:
    column, planes = quantised("x", np.array([[5.0, -1.0, 0.0], [5.0, 1.0, 300.0], [5.0, 0.4, 70_000.0]]), 1.0)
    assert column.bytes == (0, 1, 3) and column.low == (5, -1, 0)
    assert [list(plane) for plane in planes] == [[0, 2, 1], [0, 44, 112], [0, 1, 17], [0, 0, 1]]


@pytest.mark.parametrize("motion, order", [("static", 0), ("full", 0), ("full", 2)])
def test_data_take_at_most_a_third_of_float32(motion, order: int) -> None:
    """Base64 and header included. Random colours are the hardest: all 8 bits of each coefficient are noise."""
    model = viewed_model(motion, order, count=3000)
    packed = pack(model, viewed_scene())
    size = len(packed.data) * 4 / 3 + len(json.dumps(packed.header))
    assert size <= len(model) * sum(p.numel() for p in model.parameters.values()) / len(model) * 4 / 3
