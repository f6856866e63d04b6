"""Coordinates of files: stated, shifted where float32 is too coarse, and found out where nothing is stated."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import generator, random_gaussians
from plyfile import PlyData
from tiny import evaluation_config, tiny_scene

from datasets.canonical import Canonical
from datasets.files.errors import DataError
from datasets.scene import Scene
from pipeline.data.prepare import Prepared
from pipeline.evaluation.renderer import Renderer
from pipeline.export.formats import write_files
from pipeline.export.source import Source, Timeline, open_source
from pipeline.model.model import Model
from pipeline.model.ply import load_ply, ply_bytes, stated_coordinates
from pipeline.model.transformed import in_canonical
from pipeline.trained.coordinates import placed
from rasterizer import Rasterizer

MAP = Canonical((412345.25, 5654321.5, 312.0), 1.25)  # of metres, as surveyors have them
ROOM = Canonical((1.0, -2.0, 0.5), 0.5)


def static_model() -> Model:
    gaussians = random_gaussians(200, "static", generator(3), sh_degree=0, log_scale=(-3, -2)).to(torch.float32)
    return Model.from_gaussians(gaussians)


def exported(folder: Path, name: str, canonical: Canonical, world: bool = True) -> tuple[Path, list[str]]:
    source, lines = Source(static_model(), Timeline(0.0, 1.0), canonical, "m", folder), []
    (path,) = write_files(name, source, [0.0], folder, world, lines.append)
    return path, lines


def test_transforms_one_after_the_other() -> None:
    """In one step as in two, up to float64; a transform and its inverse are none."""
    points, both = np.random.default_rng(0).normal(size=(9, 3)), ROOM.then(MAP)
    np.testing.assert_allclose(both.points(points), MAP.points(ROOM.points(points)), rtol=1e-12)
    timed = Canonical(time_origin=3.0, time_scale=0.2)
    assert timed.then(Canonical(time_origin=0.5, time_scale=4.0)).time(7.0) == pytest.approx(((7 - 3) * 0.2 - 0.5) * 4)
    np.testing.assert_allclose(MAP.then(MAP.inverse).points(points), points, atol=1e-8)  # float64 at 6e6


@pytest.mark.parametrize("world", [False, True])
def test_a_ply_states_its_coordinates(tmp_path: Path, world: bool) -> None:
    path, lines = exported(tmp_path, "ply", ROOM, world)
    assert stated_coordinates(path) == (Canonical() if world else ROOM) and not lines
    expected = ROOM.inverse.points(static_model().parameters["mean"].numpy())
    data = PlyData.read(str(path))["vertex"].data
    found = np.stack([data[axis] for axis in "xyz"], axis=1).astype(float)
    np.testing.assert_allclose(found if world else ROOM.inverse.points(found), expected, atol=1e-6)
    again = open_source(path, None, None, print)  # a file's own statement goes with its exports
    assert again.known and again.canonical == (Canonical() if world else ROOM)


@pytest.mark.parametrize("name", ["ply", "glb"])
def test_map_coordinates_are_shifted_and_the_file_says_so(tmp_path: Path, name: str) -> None:
    """Read apart: positions plus shift are the data's within float32 of a few metres, not of millions (0.5)."""
    path, (line,) = exported(tmp_path, name, MAP)
    assert line.startswith(f"{name}: positions are the data's minus (412345, 565432") and "steps of 0.5" in line
    expected = MAP.inverse.points(static_model().parameters["mean"].numpy())
    if name == "ply":
        content = PlyData.read(str(path))
        (comment,) = content.comments
        shift = np.array(json.loads(comment.removeprefix("data_to_file "))["centre"])
        found = np.stack([content["vertex"].data[axis] for axis in "xyz"], axis=1).astype(float) + shift
    else:
        content = path.read_bytes()
        document = json.loads(content[20 : 20 + struct.unpack("<I", content[12:16])[0]])
        view = document["bufferViews"][document["accessors"][0]["bufferView"]]
        start = content.index(b"BIN\0") + 4 + view["byteOffset"]
        found = np.frombuffer(content, "<f4", 3 * len(expected), start).reshape(-1, 3).astype(float)
        found = (found + document["nodes"][0]["translation"]) * [1, -1, -1]  # y up, z backward
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["splat", "spz", "splatv", "4dgs", "ftgs.ply", "pth"])
def test_formats_without_a_place_for_a_shift_refuse_map_coordinates(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=f"^{name}: expected smaller coordinates, found that float32 holds 5.65"):
        exported(tmp_path, name, MAP)
    assert not list(tmp_path.iterdir())
    if name == "splat":
        assert exported(tmp_path, name, ROOM)[1] == []


@pytest.mark.parametrize(
    "comment", ["{}", "[1, 2]", '{"centre": [1, 2], "scale": 1, "time_origin": 0, "time_scale": 1}']
)
def test_a_broken_statement_is_refused(tmp_path: Path, comment: str) -> None:
    content = ply_bytes(static_model(), ROOM)
    start = content.index(b"comment")
    end = content.index(b"\n", start)
    path = tmp_path / "m.ply"
    path.write_bytes(content[:start] + b"comment data_to_file " + comment.encode() + content[end:])
    with pytest.raises(DataError, match=r"m\.ply: expected a comment data_to_file with centre, scale"):
        stated_coordinates(path)
    path.write_bytes(ply_bytes(static_model()))
    assert stated_coordinates(path) is None and len(load_ply(path)) == 200


def photographed(model: Model) -> Scene:
    """A scene whose images the model renders."""
    scene = tiny_scene(static=True)
    renderer = Renderer(model, scene, evaluation_config(), Rasterizer(threads=1))
    shown = [
        replace(view, image=np.rint(255 * renderer.image(view.camera, 0.0)).astype(np.uint8)) for view in scene.train
    ]
    return replace(scene, train=tuple(shown))


@pytest.mark.parametrize("canonical", [MAP, Canonical((1e3, -4e2, 30.0), 0.02), ROOM, Canonical((0.3, 0, 0), 1.3)])
@pytest.mark.parametrize("has", ["canonical", "data"])
def test_unstated_coordinates_are_found_out(canonical: Canonical, has: str) -> None:
    """By the place of the scene where the two are far apart, by training views where they are near."""
    model = static_model()
    data, lines = Prepared(photographed(model), None, None, canonical), []
    file = model if has == "canonical" else in_canonical(model, canonical.inverse)
    positions = model.parameters["mean"].numpy().astype(np.float64)
    positions = positions if has == "canonical" else canonical.inverse.points(positions)  # a file of double precision
    found = placed(file, positions, Path("m.ply"), evaluation_config(), data, 1, lines.append)
    np.testing.assert_allclose(found.parameters["mean"], model.parameters["mean"], atol=1e-6)
    expected = "canonical coordinates" if has == "canonical" else "the coordinates of the data's files"
    assert len(lines) == 1 and lines[0].startswith(f"evaluate: m.ply is taken to have {expected}: ")
    assert ("4 training views" in lines[0]) == (canonical.centre[0] < 10)


def test_gaussians_that_are_nowhere_near_are_refused_with_the_numbers() -> None:
    model = static_model()
    data = Prepared(photographed(model), None, None, ROOM)
    lost = in_canonical(model, Canonical((500.0, 0.0, 0.0)))
    with pytest.raises(ValueError, match=r"m\.ply: expected Gaussians about the scene, .* found them at \(-500"):
        placed(lost, lost.parameters["mean"].numpy(), Path("m.ply"), evaluation_config(), data, 1, print)
    grey = replace(data, scene=tiny_scene(static=True))  # images that show the model in neither
    invisible = model.with_parameters(model.parameters | {"opacity_logit": torch.full((200,), -60.0)})
    with pytest.raises(ValueError, match="--coordinates canonical or data, as both fit alike: .* dB"):
        placed(invisible, invisible.parameters["mean"].numpy(), Path("m.ply"), evaluation_config(), grey, 1, print)
