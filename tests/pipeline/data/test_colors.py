"""Colour correction of cameras: known gains and offsets are found again, and cameras that agree are left alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plenoptic_folder import write_video

from datasets.cameras.color import ColorCorrection
from datasets.settings import SceneConfig
from datasets.source import Photograph
from datasets.synthetic.film import film
from datasets.synthetic.write_film import FilmSettings
from pipeline.config.schema import Config, InitConfig
from pipeline.data.colors.choose import color_corrections, recolored
from pipeline.data.prepare import prepare
from pipeline.data.sfm.reconstruction import Reconstruction
from pipeline.data.sfm.run import reconstruct

FILM = FilmSettings(scene="counter", seed=1, size=240, cameras=6, frames=1, samples=3)
LEVELS = np.repeat(np.arange(30.0, 200.0)[:, None], 3, axis=1)  # of 255: where the pictures have their colours
HELD_OUT = ["c00"]
FILMED = {  # what a camera made of the colours: gain, offset
    "c00": ColorCorrection((0.9, 0.9, 0.9), (6, 6, 6)),  # held out
    "c03": ColorCorrection((0.72, 0.78, 0.84), (0, 4, 8)),
}


@pytest.fixture(scope="module")
def photographs() -> list[Photograph]:
    world, cameras = FILM.set_up()
    return [
        Photograph(
            f"c{i:02d}", next(film(world, camera, FILM.times, samples=FILM.samples)), held_out=f"c{i:02d}" in HELD_OUT
        )
        for i, camera in enumerate(cameras)
    ]


@pytest.fixture(scope="module")
def found(photographs: list[Photograph]) -> Reconstruction:
    return reconstruct(changed(photographs), InitConfig(min_points=50), 1.0, Path("x"), observations=True)


def changed(photographs: list[Photograph]) -> list[Photograph]:
    """As FILMED."""
    return [replace(p, image=FILMED.get(p.name, ColorCorrection()).apply(p.image)) for p in photographs]


def test_known_changes_are_found_again(photographs: list[Photograph], found: Reconstruction) -> None:
    """Within two levels of 255; the cameras that were not changed are the reference and stay as they are."""
    lines: list[str] = []
    corrections = color_corrections(changed(photographs), found, HELD_OUT, False, lines.append)
    assert set(corrections) == {"c00", "c03"}
    for name, made in FILMED.items():
        np.testing.assert_allclose(corrections[name].of(made.of(LEVELS)), LEVELS, atol=2.0)
    assert lines[0].startswith("colours are corrected") and "c03" in lines[0] and lines[1].endswith("no correction")


def test_cameras_that_agree_are_left_alone(photographs: list[Photograph], found: Reconstruction) -> None:
    lines: list[str] = []
    assert color_corrections(photographs, found, HELD_OUT, False, lines.append) == {}
    assert len(lines) == 1 and lines[0].endswith("of 255: no correction")


def test_where_all_are_corrected_the_mean_is_the_identity(photographs: list[Photograph], found: Reconstruction) -> None:
    corrections = color_corrections(changed(photographs), found, HELD_OUT, True, lambda line: None)
    assert set(corrections) == {p.name for p in photographs}
    training = [corrections[p.name] for p in photographs if not p.held_out]
    np.testing.assert_allclose(np.mean([c.gain for c in training], axis=0), 1.0, atol=1e-9)
    np.testing.assert_allclose(np.mean([c.offset for c in training], axis=0), 0.0, atol=1e-7)
    one, other = corrections["c01"], corrections["c03"]
    np.testing.assert_allclose(other.of(FILMED["c03"].of(LEVELS)), one.of(LEVELS), atol=2.0)


def test_training_does_not_depend_on_the_held_out_camera(photographs: list[Photograph], found: Reconstruction) -> None:
    other = [replace(p, image=255 - p.image) if p.held_out else p for p in changed(photographs)]
    first, second = (
        color_corrections(p, found, HELD_OUT, False, lambda line: None) for p in (changed(photographs), other)
    )
    assert first["c03"] == second["c03"]


def test_points_get_corrected_colours(photographs: list[Photograph], found: Reconstruction) -> None:
    corrections = color_corrections(changed(photographs), found, HELD_OUT, False, lambda line: None)
    colors = recolored(changed(photographs), found, HELD_OUT, corrections).colors.astype(float)
    assert recolored(changed(photographs), found, HELD_OUT, {}) is found
    # One camera of the three to five that see a point was darker by 20 levels and more.
    assert 2 < (colors - found.colors).mean() < 10


def test_too_few_matches_leave_a_camera_alone(photographs: list[Photograph], found: Reconstruction) -> None:
    assert found.observations is not None
    place = list(found.cameras).index("c03")
    own = np.flatnonzero(found.observations[:, 1] == place)
    fewer = replace(found, observations=np.delete(found.observations, own[20:], axis=0))
    lines: list[str] = []
    assert "c03" not in color_corrections(changed(photographs), fewer, HELD_OUT, False, lines.append)
    assert lines[0].startswith("colours of c03 are left alone: it has fewer than 50 matches")


def test_matches_with_a_camera_that_has_too_few_do_not_count() -> None:
    """A and B have enough with each other; B and C too few, and C with D only together with those of B."""
    names, points = ["a", "b", "c", "d"], 200
    pairs = [("a", "b", 0, 100), ("b", "c", 100, 130), ("c", "d", 130, 160)]
    seen = [(p, names.index(name)) for *pair, first, last in pairs for name in pair for p in range(first, last)]
    observations = np.array([(p, place, 5 + 10 * (p % 20), 5 + 10 * (p // 20)) for p, place in seen], float)
    image = np.full((240, 240, 3), 128, np.uint8)
    cameras = dict.fromkeys(names, None)
    made = Reconstruction(
        np.zeros((points, 3)), np.zeros((points, 3), np.uint8), np.zeros(points), np.zeros(points, int), cameras,
        "known", 4, 0.0, observations,
    )  # fmt: skip
    lines: list[str] = []
    assert color_corrections([Photograph(name, image) for name in names], made, [], False, lines.append) == {}
    assert [line.split()[2] for line in lines if "left alone" in line] == ["c", "d"]


def test_scenes_without_poses_are_corrected(photographs: list[Photograph], tmp_path: Path) -> None:
    """Films of two frames; what training and evaluation see of the changed cameras is as the scene is."""
    videos = tmp_path / "videos"
    videos.mkdir()
    for photograph in changed(photographs):
        write_video(videos / f"{photograph.name}.mp4", [photograph.image] * 2)
    scenes, lines = {}, []
    for setting in ("auto", False):
        scene = SceneConfig(
            "video", "video", str(videos), color_correction=setting, downscale=1, cache=str(tmp_path / "cache")
        )
        scenes[setting] = prepare(Config(scene=scene, init=InitConfig(min_points=50), threads=1), lines.append).scene
    for split in ("train", "test"):
        for view, plain in zip(getattr(scenes["auto"], split), getattr(scenes[False], split), strict=True):
            name = view.name.split("/")[1][:3]
            if name in FILMED:
                true = next(p.image for p in photographs if p.name == name).astype(float)
                assert np.abs(np.median(np.asarray(view.image) - true, axis=(0, 1))).max() < 2.5
                assert np.abs(np.median(np.asarray(plain.image) - true, axis=(0, 1))).max() > 4
            else:
                np.testing.assert_array_equal(np.asarray(view.image), np.asarray(plain.image))
    assert sum("colours are corrected" in line for line in lines) == 1


@pytest.mark.parametrize("value", ["yes", 2, None])
def test_other_settings_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match="scene.color_correction: expected auto, true or false, found"):
        SceneConfig(color_correction=value)
