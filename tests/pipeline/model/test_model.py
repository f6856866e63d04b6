"""Shapes of a model's tensors by its kind, its state, and .ply files, which for static models are those of 3DGS."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from builders import generator, random_gaussians
from plyfile import PlyData
from tiny import random_model, tiny_scene

from pipeline.config.schema import AblationConfig, Config
from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model, ModelKind, kind_of
from pipeline.model.ply import load_ply, save_ply

KINDS = [
    ModelKind("full", 2, 3),
    ModelKind("full", 0, 3),
    ModelKind("separable", 1, 2),
    ModelKind("static", 0, 3),
    ModelKind("full", 2, 0),
]


@pytest.mark.parametrize("kind", KINDS)
def test_the_kind_follows_from_the_shapes(kind: ModelKind) -> None:
    model = random_model(kind)
    gaussians = model.gaussians()
    assert ModelKind(gaussians.motion, gaussians.fourier_order, gaussians.sh_degree) == kind
    assert gaussians.mean is model.parameters["mean"], "tensors are shared, not copied"
    assert Model.from_gaussians(gaussians).kind == kind


def test_a_model_of_gaussians_with_shared_trajectories_has_them() -> None:
    gaussians = random_gaussians(7, "shared", generator(0)).to(torch.float32)
    model = Model.from_gaussians(gaussians)
    assert model.kind == ModelKind("velocity", 2, 3, trajectories=5)
    assert model.gaussians().tensors().keys() == gaussians.tensors().keys()
    assert model.trajectories is gaussians.trajectories


def test_bytes_are_of_the_stored_parameters() -> None:
    # full: 4 + 4 + 4 + 4 + 1 + 144 floats; static: 3 + 3 + 4 + 1 + 48
    assert random_model(ModelKind("full", 2, 3), 10).bytes == 10 * 161 * 4
    assert random_model(ModelKind("static", 0, 3), 10).bytes == 10 * 59 * 4


@pytest.mark.parametrize(
    "static_scene, ablation, expected",
    [
        (False, AblationConfig(), ModelKind("full", 2, 3)),
        (False, AblationConfig(rotation_4d=False), ModelKind("separable", 2, 3)),
        (False, AblationConfig(fourier_order=0), ModelKind("full", 0, 3)),
        (False, AblationConfig(static=True), ModelKind("static", 0, 3)),
        (True, AblationConfig(), ModelKind("static", 0, 3)),
        (True, AblationConfig(static=False), ModelKind("full", 2, 3)),
    ],
)
def test_kind_follows_scene_and_ablation(static_scene: bool, ablation: AblationConfig, expected: ModelKind) -> None:
    assert kind_of(tiny_scene(static=static_scene), Config(ablation=ablation)) == expected


def test_a_missing_or_misshapen_field_is_named() -> None:
    parameters = random_model(KINDS[0]).parameters
    with pytest.raises(ValueError, match="quat_right"):
        Model(KINDS[0], {name: t for name, t in parameters.items() if name != "quat_right"})
    with pytest.raises(ValueError, match="opacity_logit: expected float32 .7."):
        Model(KINDS[0], parameters | {"opacity_logit": torch.zeros(7, 1)})


def test_first_non_finite_names_field_and_row() -> None:
    model = random_model(KINDS[0])
    assert model.first_non_finite() is None
    model.parameters["sh"][4, 30, 1] = float("nan")
    assert model.first_non_finite() == ("sh", 4)


@pytest.mark.parametrize("kind", KINDS)
def test_ply_round_trip_is_exact(kind: ModelKind, tmp_path) -> None:
    model = random_model(kind)
    save_ply(tmp_path / "model.ply", model)
    back = load_ply(tmp_path / "model.ply")
    assert back.kind == kind
    for name, tensor in model.parameters.items():
        assert torch.equal(back.parameters[name], tensor), name


def test_ply_stores_the_sphere_label(tmp_path) -> None:
    model = random_model(KINDS[1])
    model.sphere = torch.arange(7) >= 4
    save_ply(tmp_path / "model.ply", model)
    assert torch.equal(load_ply(tmp_path / "model.ply").sphere, model.sphere)
    columns = PlyData.read(str(tmp_path / "model.ply"))["vertex"].data.dtype
    assert {columns[name].str for name in columns.names} == {"<f4"}, "like every property of 3DGS's file"
    model.sphere = None
    save_ply(tmp_path / "model.ply", model)
    assert load_ply(tmp_path / "model.ply").sphere is None


def test_a_copy_has_the_background_model_and_shares_no_memory() -> None:
    model = random_model(KINDS[0])
    assert model.background_model == "none"
    model.sphere = torch.arange(7) >= 4
    assert model.background_model == "sphere"
    model.environment_map = EnvironmentMap.grey(3)
    assert model.background_model == "envmap"
    copy = model.copy()
    assert copy.state().keys() == model.state().keys()
    for name, tensor in copy.state().items():
        assert torch.equal(tensor, model.state()[name]) and tensor.data_ptr() != model.state()[name].data_ptr(), name


def test_a_sphere_label_of_another_shape_or_type_is_refused() -> None:
    parameters = random_model(KINDS[0]).parameters
    for sphere in (torch.zeros(6, dtype=torch.bool), torch.zeros(7)):
        with pytest.raises(ValueError, match=r"sphere: expected bool \[7\], found"):
            Model(KINDS[0], parameters, sphere)


def test_static_ply_is_3dgs_format(tmp_path) -> None:
    """Property names and order of graphdeco's save_ply, and its channel-major f_rest."""
    model = random_model(ModelKind("static", 0, 3))
    save_ply(tmp_path / "model.ply", model)
    vertices = PlyData.read(str(tmp_path / "model.ply"))["vertex"].data
    expected = (
        ["x", "y", "z", "nx", "ny", "nz"]
        + [f"f_dc_{i}" for i in range(3)]
        + [f"f_rest_{i}" for i in range(45)]
        + ["opacity"]
        + [f"scale_{i}" for i in range(3)]
        + [f"rot_{i}" for i in range(4)]
    )
    assert list(vertices.dtype.names) == expected
    sh = model.parameters["sh"].numpy()
    features_rest = np.transpose(sh[:, 1:], (0, 2, 1)).reshape(len(model), -1)  # as 3DGS: transpose, flatten
    assert np.array_equal(np.stack([vertices[f"f_rest_{i}"] for i in range(45)], 1), features_rest)


def test_an_invalid_ply_is_refused_in_one_line_with_its_name(tmp_path) -> None:
    file = tmp_path / "broken.ply"
    file.write_text("no ply")
    with pytest.raises(ValueError, match="broken.ply: expected") as error:
        load_ply(file)
    assert "\n" not in str(error.value)
