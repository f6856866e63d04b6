"""Checkpoints of the released program: files of its layout, made here field by field, against its own formulas.

None of the authors' files is at hand. The order of the fields and the formulas (textbook form, float64) are those
of the program's source.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import camera_looking_at, make_request
from tiny import random_model
from torch import Tensor
from torch.nn import Parameter

from datasets.canonical import Canonical
from datasets.files.errors import DataError
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model, ModelKind
from pipeline.model.released_checkpoint import load_released, released_bytes
from pipeline.model.transformed import in_canonical, quaternions_of
from rasterizer import Rasterizer
from rasterizer.covariance import rotation_4d
from rasterizer.reference.render import slice_in_time

ROWS = 20


def stored_values(coefficients: int = 48, seed: int = 0) -> dict[str, Tensor]:
    rng = torch.Generator().manual_seed(seed)
    shapes = {
        "xyz": (3,), "features_dc": (1, 3), "features_rest": (coefficients - 1, 3), "scaling": (3,), "rotation": (4,),
        "opacity": (1,), "t": (1,), "scaling_t": (1,), "rotation_r": (4,),
    }  # fmt: skip
    return {name: torch.randn(ROWS, *shape, generator=rng) for name, shape in shapes.items()}


def write_checkpoint(path: Path, values: dict, rot_4d=True, degrees=(3, 2), env_map=None, extent=None) -> Path:
    """The 19 fields as the program's capture() lists them, with parameters as it stores them."""
    v = {name: Parameter(tensor) if isinstance(tensor, Tensor) else tensor for name, tensor in values.items()}
    zeros = torch.zeros(ROWS, 1)
    optimizer = torch.optim.Adam([{"params": [v["xyz"]], "lr": 0.1, "name": "xyz"}], eps=1e-15)
    fields = (
        degrees[0], v["xyz"], v["features_dc"], v["features_rest"], v["scaling"], v["rotation"], v["opacity"],
        torch.zeros(ROWS), zeros, zeros, zeros, optimizer.state_dict(), np.float64(4.4) if extent is None else extent,
        v["t"], v["scaling_t"], v["rotation_r"] if rot_4d else torch.empty(0), rot_4d, env_map, degrees[1],
    )  # fmt: skip
    torch.save((fields, 30_000), path)
    return path


def released_rotation(left: Tensor, right: Tensor) -> Tensor:
    """(N, 4, 4): its two isoclinic factors, with the axes of their product reversed."""
    a, b, c, d = torch.nn.functional.normalize(left).unbind(-1)
    p, q, r, s = torch.nn.functional.normalize(right).unbind(-1)
    first = torch.stack([a, -b, -c, -d, b, a, -d, c, c, d, a, -b, d, -c, b, a], -1).reshape(-1, 4, 4)
    second = torch.stack([p, q, r, s, -q, p, -s, r, -r, s, p, -q, -s, -r, q, p], -1).reshape(-1, 4, 4)
    return (first @ second).flip(1, 2)


def test_a_slice_is_the_released_programs(tmp_path: Path) -> None:
    values, time = stored_values(), 0.3
    model = load_released(write_checkpoint(tmp_path / "chkpnt.pth", values))
    assert model.kind == ModelKind("full", 2, 3) and len(model) == ROWS
    sliced = slice_in_time(model.gaussians().to(torch.float64), time)

    v = {name: tensor.double() for name, tensor in values.items()}
    factor = released_rotation(v["rotation"], v["rotation_r"]) @ torch.diag_embed(
        torch.cat([v["scaling"], v["scaling_t"]], dim=1).exp()
    )
    covariance = factor @ factor.transpose(1, 2)
    space, shared, variance = covariance[:, :3, :3], covariance[:, :3, 3:], covariance[:, 3:, 3:]
    elapsed = time - v["t"]
    mean = v["xyz"] + (shared / variance)[:, :, 0] * elapsed
    conditional = space - shared @ shared.transpose(1, 2) / variance
    # Both float64; the textbook difference cancels a few digits
    assert torch.allclose(sliced.mean, mean, rtol=1e-9, atol=1e-9)
    assert torch.allclose(sliced.factor @ sliced.factor.transpose(1, 2), conditional, rtol=1e-6, atol=1e-9)
    assert torch.allclose(sliced.marginal, torch.exp(-0.5 * elapsed**2 / variance[:, 0])[:, 0], rtol=1e-9)
    assert torch.equal(model.parameters["opacity_logit"], values["opacity"][:, 0])
    assert torch.equal(model.parameters["sh"], torch.cat([values["features_dc"], values["features_rest"]], dim=1))


def test_without_4d_rotation_it_stores_a_variance(tmp_path: Path) -> None:
    values, time = stored_values(), 0.3
    model = load_released(write_checkpoint(tmp_path / "chkpnt.pth", values, rot_4d=False))
    assert model.kind.motion == "separable"
    sliced = slice_in_time(model.gaussians().to(torch.float64), time)
    v = {name: tensor.double() for name, tensor in values.items()}
    marginal = torch.exp(-0.5 * (v["t"] - time) ** 2 / v["scaling_t"].exp())[:, 0]
    assert torch.allclose(sliced.marginal, marginal, rtol=1e-6), "half of a float32 logarithm"
    assert torch.equal(model.parameters["quat_left"], values["rotation"])


@pytest.mark.parametrize(
    "coefficients, degrees, kind",
    [
        (48, (3, 1), ("full", 1, 3)),
        (48, (2, 0), ("full", 0, 3)),
        (33, (3, 0), ("full", 0, 3)),
        (1, (0, 0), ("full", 0, 0)),
    ],
)
def test_inactive_coefficients_are_not_used(tmp_path: Path, coefficients: int, degrees: tuple, kind: tuple) -> None:
    values = stored_values(coefficients)
    model = load_released(write_checkpoint(tmp_path / "chkpnt.pth", values, degrees=degrees))
    assert model.kind == ModelKind(*kind)
    stored = torch.cat([values["features_dc"], values["features_rest"]], dim=1)
    active = (degrees[0] + 1) ** 2
    for order in range(kind[1] + 1):
        found = model.parameters["sh"].unflatten(1, (kind[1] + 1, -1))[:, order]
        assert torch.equal(found[:, :active], stored[:, 16 * order : 16 * order + active])
        assert not found[:, active:].any()


@pytest.mark.parametrize("extent", [np.float64(4.4), np.float32(4.4), 4.4])
def test_a_static_model_and_any_extent_are_read(tmp_path: Path, extent: object) -> None:
    v, zeros = stored_values(16), torch.zeros(ROWS, 1)
    fields = (
        2, v["xyz"], v["features_dc"], v["features_rest"], v["scaling"], v["rotation"], v["opacity"],
        torch.zeros(ROWS), zeros, zeros, {}, extent,
    )  # fmt: skip
    torch.save((fields, 7000), tmp_path / "chkpnt.pth")
    model = load_released(tmp_path / "chkpnt.pth")
    assert model.kind == ModelKind("static", 0, 3)
    assert torch.equal(model.parameters["mean"], v["xyz"]) and not model.parameters["sh"][:, 9:].any()


@pytest.mark.parametrize(
    "kind",
    [("full", 2, 3), ("full", 0, 3), ("full", 1, 2), ("separable", 1, 3), ("separable", 0, 2), ("static", 0, 3)],
    ids=str,
)
def test_written_and_read_again_a_model_is_the_same(tmp_path: Path, kind: tuple) -> None:
    model = random_model(ModelKind(*kind))
    (tmp_path / "chkpnt.pth").write_bytes(released_bytes(model, extent=3.3))
    read = load_released(tmp_path / "chkpnt.pth")
    assert read.kind.motion == model.kind.motion and read.kind.fourier_order == model.kind.fourier_order
    for name, tensor in model.parameters.items():
        if name != "sh":
            assert torch.equal(read.parameters[name], tensor), name
    request = make_request(time=0.4, duration=1.0)
    images = [Rasterizer(1).render(m.gaussians(), request).color for m in (model, read)]
    assert torch.equal(*images), "padding to degree 3 adds nothing"


def test_it_has_the_fields_and_groups_that_the_program_restores(tmp_path: Path) -> None:
    (tmp_path / "chkpnt.pth").write_bytes(released_bytes(random_model(ModelKind("full", 2, 3)), iteration=9))
    fields, iteration = torch.load(tmp_path / "chkpnt.pth", weights_only=True)
    assert iteration == 9 and len(fields) == 19
    assert [fields[0], fields[16], fields[17], fields[18]] == [3, True, None, 2]
    groups = [group["name"] for group in fields[11]["param_groups"]]
    assert groups == ["xyz", "f_dc", "f_rest", "opacity", "scaling", "rotation", "t", "scaling_t", "rotation_r"]
    assert [list(fields[i].shape[1:]) for i in (1, 2, 3, 6)] == [[3], [1, 3], [47, 3], [1]]


class Malicious:
    def __reduce__(self) -> tuple:
        return Path.touch, (Path("touched"),)


def test_nothing_of_the_file_is_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_checkpoint(tmp_path / "chkpnt.pth", stored_values(), extent=Malicious())
    with pytest.raises(DataError, match="expected a checkpoint of the released program, found an object .*not loaded"):
        load_released(path)
    assert not Path("touched").exists()


@pytest.mark.parametrize(
    "change, error",
    [
        ({"t": torch.zeros(ROWS, 2)}, r"t: expected \[20, 1\], found \[20, 2\]"),
        ({"rotation": torch.zeros(ROWS - 1, 4)}, r"rotation: expected \[20, 4\], found \[19, 4\]"),
        ({"opacity": "none"}, r"opacity: expected \[20, 1\], found str"),
        ({"features_rest": torch.zeros(ROWS, 20, 3)}, "expected one of .* SH coefficients, found 21"),
        ({"features_rest": torch.zeros(ROWS, 15, 3)}, "expected 48 SH coefficients of order 2, found 16"),
        ({"xyz": torch.full((ROWS, 3), torch.nan)}, "mean of Gaussian 0: expected a finite number"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, change: dict, error: str) -> None:
    values = stored_values() | change
    if "xyz" not in change:
        values["xyz"] = stored_values()["xyz"]
    with pytest.raises(DataError, match=error):
        load_released(write_checkpoint(tmp_path / "chkpnt.pth", values))


@pytest.mark.parametrize("content", [b"", b"not a checkpoint", None])
def test_another_file_is_refused(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "chkpnt.pth"
    path.write_bytes(content) if content is not None else torch.save({"model": 1}, path)
    with pytest.raises(DataError, match="chkpnt.pth: expected .* found"):
        load_released(path)


def test_an_environment_map_is_seen_as_from_the_origin(tmp_path: Path) -> None:
    """Smooth maps: both are sampled bilinearly, on other grids."""
    side = 64
    angle = (torch.arange(side) + 0.5) / side
    rows, columns = torch.meshgrid(angle * torch.pi, angle * 2 * torch.pi, indexing="ij")
    smooth = torch.stack([0.5 + 0.4 * rows.cos(), 0.5 + 0.4 * rows.sin() * columns.cos(), 0.3 + 0 * rows])
    path = write_checkpoint(tmp_path / "chkpnt.pth", stored_values(), env_map=Parameter(smooth))
    found = load_released(path).environment_map
    assert isinstance(found, EnvironmentMap)
    camera = replace(camera_looking_at((1e-6, 2e-6, -1e-6), target=(0.3, -1.0, 0.4)))
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], -1)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ camera.world_to_cam[:3, :3]
    azimuth = np.arctan2(rays[..., 1], rays[..., 0]) + np.pi  # its column / width × 2π
    expected = np.stack([0.5 + 0.4 * rays[..., 2], 0.5 + 0.4 * np.sqrt(1 - rays[..., 2] ** 2) * np.cos(azimuth)])
    # Bilinear sampling of curvature 0.4 rad⁻² at π/64 rad, twice
    assert np.abs(found.sample(found.grid(camera))[:2].numpy() - expected).max() < 2e-3


@pytest.mark.parametrize("motion", ["full", "velocity", "separable", "static"])
@pytest.mark.parametrize("time_scale", [1.0, 0.25])
def test_other_coordinates_render_the_same(motion: str, time_scale: float) -> None:
    fourier = 0 if motion == "static" else 2
    model = random_model(ModelKind(motion, fourier, 3), 40)
    model.parameters["log_scale"].mul_(0.3).sub_(1.5)
    canonical = Canonical((3.0, -2.0, 10.0), 0.25, 7.0, time_scale)
    request = make_request(time=0.4)
    moved = replace(
        request,
        camera=canonical.camera(request.camera),
        time=canonical.time(request.time),
        duration=request.duration * time_scale,
        near=request.near * canonical.scale,
    )
    there = in_canonical(model, canonical)
    images = [Rasterizer(1).render(m.gaussians(), r).color for m, r in ((model, request), (there, moved))]
    # float32 positions of 10 units, 2 ulp of 1e-6 / 0.1 of a pixel each
    assert (images[0] - images[1]).abs().max() < 1e-4
    back = in_canonical(there, canonical.inverse)
    assert torch.allclose(back.parameters["mean"], model.parameters["mean"], atol=1e-5)


def test_a_4d_rotation_is_two_quaternions() -> None:
    rng = torch.Generator().manual_seed(2)
    left, right = (torch.randn(50, 4, generator=rng, dtype=torch.float64) for _ in range(2))
    left[0], right[0] = torch.tensor([1.0, 0, 0, 0]), torch.tensor([1.0, 0, 0, 0])
    rotation = rotation_4d(left, right)
    assert torch.allclose(rotation_4d(*quaternions_of(rotation)), rotation, atol=1e-13)


def test_a_model_of_a_map_is_not_written() -> None:
    model = random_model(ModelKind("full", 0, 3))
    with_map = Model(model.kind, model.parameters, None, EnvironmentMap.grey(4))
    with pytest.raises(ValueError, match="expected a model without an environment map"):
        released_bytes(with_map)
