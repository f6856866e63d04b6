"""Several cameras of which some move: who moves, the common clock, what is held out, what is refused. No poses yet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from clips import SOUND_RATE, textured_plane, write_clip

from datasets.clip.clips import Clips
from datasets.clip.survey import stands_still
from datasets.files.errors import SceneError
from datasets.readers.video import ClipSource, FootageSource, open_source
from datasets.scene import Scene
from datasets.settings import SceneConfig
from rasterizer.camera import Camera

SECONDS = 5.0
RATES = {"a": 12.0, "b": 15.0, "c": 10.0}
SIZES = {"a": (96, 64), "b": (96, 72), "c": (104, 64)}
STARTS = {"a": 0.0, "b": 0.7, "c": 0.25}  # seconds on the common clock


def disc_over_still_plane(time: float, size: tuple[int, int]) -> np.ndarray:
    """What a tripod sees: a plane that stands still, and a disc that moves over it."""
    image = textured_plane(0.0, size)
    y, x = np.mgrid[: size[1], : size[0]]
    image[(x - 12 * time - 10) ** 2 + (y - 30) ** 2 < 60] = (230, 40, 40)
    return image


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """a and b move, c stands still; all hear one track of clicks, each with noise of its own."""
    folder = tmp_path_factory.mktemp("several") / "videos"
    folder.mkdir()
    rng = np.random.default_rng(7)
    track = 0.02 * rng.standard_normal(8 * SOUND_RATE)
    for at in rng.integers(0, len(track) - 4800, 25):
        track[at : at + 4800] += rng.uniform(0.1, 0.5) * rng.standard_normal(4800) * np.exp(-np.arange(4800) / 600)
    for name, rate in RATES.items():
        times = np.arange(int(SECONDS * rate)) / rate
        size, start = SIZES[name], STARTS[name]
        if name == "c":
            frames = [disc_over_still_plane(t, size) for t in times]
        else:
            frames = [textured_plane(18 * t, size) for t in times]
        part = track[round(start * SOUND_RATE) : round((start + SECONDS) * SOUND_RATE)]
        heard = np.clip(part + 0.005 * rng.standard_normal(len(part)), -1, 1)
        write_clip(folder / f"{name}.mp4", frames, times.tolist(), heard)
    return folder


def opened(videos: Path, **settings: object) -> tuple[Clips, str]:
    """The set, and everything that was said of it."""
    lines: list[str] = []
    defaults: dict = {"sync": "auto", "moving_cameras": "auto", "downscale": 1}
    cfg = SceneConfig("set", "video", str(videos), **{**defaults, **settings})
    return open_source(cfg, 1, lines.append).clips, "\n".join(lines)


def scene_of(found: Clips) -> Scene:
    """With poses made up, each photograph to the right of the one before."""
    poses = {}
    for place, (name, camera, frame) in enumerate(found.photographs()):
        height, width = camera.photograph(frame).shape[:2]
        pose = np.eye(4)
        pose[0, 3] = -0.1 * place
        poses[name] = Camera(width, height, 90.0, 90.0, width / 2, height / 2, pose)
    return found.to_scene(poses, dict.fromkeys(poses, 0.0), 1.0)


def test_a_large_mover_close_to_a_still_camera_does_not_move_it(tmp_path: Path) -> None:
    """It covers 60 % of the picture, with as much texture as the rest."""
    size = (160, 96)
    frames = []
    for i in range(18):
        image = textured_plane(0.0, size)
        image[:, 48:144] = textured_plane(7.0 * i + 400, (96, 96))
        frames.append(image)
    write_clip(tmp_path / "cam.mp4", frames, [i / 10 for i in range(18)])
    assert stands_still(tmp_path / "cam.mp4", tmp_path)


def test_who_moves(videos: Path) -> None:
    assert [stands_still(videos / f"{name}.mp4", videos) for name in RATES] == [False, False, True]
    cfg = SceneConfig("set", "video", str(videos), moving_cameras="auto")
    source = open_source(cfg, 1, str)
    assert isinstance(source, ClipSource) and source.several_videos


def test_only_cameras_that_stand_still_are_read_as_before(videos: Path, tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_clip(tmp_path / f"{name}.mp4", [disc_over_still_plane(i / 10, (96, 64)) for i in range(20)], range(20))
    cfg = SceneConfig("set", "video", str(tmp_path), moving_cameras="auto")
    assert isinstance(open_source(cfg, 1, str), FootageSource)


def test_frames_have_times_of_the_common_clock(videos: Path) -> None:
    found, said = opened(videos)
    assert "cameras that move: a, b; that stand still: c" in said and "by the sound" in said
    views = {view.name.split("/")[1]: view.time for view in scene_of(found).train + scene_of(found).test}
    for name, rate in RATES.items():
        own = {int(view[2:]): time for view, time in views.items() if view.startswith(f"{name}_")}
        assert len(own) > 0.6 * SECONDS * rate
        expected = [STARTS[name] + frame / rate for frame in own]
        np.testing.assert_allclose(list(own.values()), expected, atol=2e-3)  # of the starts found


def test_each_camera_has_a_share_and_its_own_held_out_frames(videos: Path) -> None:
    found, _ = opened(videos, frames=60)
    scene = scene_of(found)
    for name in RATES:
        train, test = ([v for v in part if f"/{name}_" in v.name] for part in (scene.train, scene.test))
        assert 12 <= len(train) + len(test) <= 20 and len(test) in (2, 3)
    assert found.counts() == (len(scene.train), len(scene.test))
    assert scene.test_split == "every 8th frame of each camera" and scene.capture == "multi_view"


def test_whole_cameras_are_held_out_on_request(videos: Path) -> None:
    for settings, number in (({"test_cameras": [1]}, "b"), ({"test_every": 0}, "a")):
        scene = scene_of(opened(videos, **settings)[0])
        assert {view.name[:7] for view in scene.test} == {f"test/{number}_"}
        assert not any(f"/{number}_" in view.name for view in scene.train)


def test_a_camera_that_stands_still_has_one_pose_and_images_one_size(videos: Path) -> None:
    found, _ = opened(videos)
    assert found.size == (96, 64)
    assert sum(camera.name == "c" for _, camera, _ in found.photographs()) == 1
    scene = scene_of(found)
    poses = {view.camera.world_to_cam.tobytes() for view in scene.train if "/c_" in view.name}
    assert len(poses) == 1
    assert sum(camera.name == "c" for _, camera, _ in opened(videos, moving_cameras=True)[0].photographs()) > 12


def test_images_keep_their_size_where_sfm_sees_smaller_ones(videos: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("datasets.clip.footage.SFM_SIDE", 48)
    monkeypatch.setattr("datasets.clip.footage.SFM_AREA", 48 * 36)
    found, _ = opened(videos)
    assert {camera.photograph(frame).shape for _, camera, frame in found.photographs()} == {(32, 48, 3)}
    frames = {f"{c.name}_{f.name[-5:]}": f.image for c in found.cameras for f in c.frames}
    for view in scene_of(found).train:
        assert (view.camera.width, view.camera.fx, view.camera.cx) == (96, 180, 48)
        assert (np.asarray(view.image) == frames[view.name.split("/")[1]]).all() and view.image.shape == (64, 96, 3)


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        ({"sync": "given", "offsets": [0, 1]}, r"scene.offsets: expected 3 numbers"),
        ({"sync": "given", "offsets": [0, 60, 0]}, r"b.mp4: expected frames of the time that another camera filmed"),
        ({"test_cameras": [5]}, "scene.test_cameras: expected cameras among 0, 1, 2, found 5"),
        (
            {"test_every": 500},
            r"videos: scene\.test_every: expected below \d+, twice the frames of a camera, found 500",
        ),
        ({"test_cameras": [0, 1, 2]}, "expected at least one camera to train on"),
        ({"first_frame": 55}, "expected at least 12 sharp frames of one take"),
    ],
)
def test_what_cannot_be_used_is_refused(videos: Path, settings: dict, expected: str) -> None:
    with pytest.raises(SceneError, match=expected):
        opened(videos, **settings)


def test_the_picture_does_not_say_when_a_camera_that_moves_started(videos: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        frames = [textured_plane(18 * i / 12, (96, 64)) for i in range(40)]
        write_clip(tmp_path / f"{name}.mp4", frames, [i / 12 for i in range(40)])
    with pytest.raises(SceneError, match="expected sound that all cameras hear, to find out when each camera started"):
        opened(tmp_path)
    assert [camera.start for camera in opened(tmp_path, sync="none")[0].cameras] == [0.0, 0.0]


@pytest.mark.parametrize("value", ["yes", 1, None])
def test_other_settings_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match="scene.moving_cameras: expected auto, true or false, found"):
        SceneConfig(moving_cameras=value)


def test_a_damaged_video_is_named(videos: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.mp4").write_bytes(b"no video")
    (tmp_path / "a.mp4").write_bytes((videos / "a.mp4").read_bytes())
    with pytest.raises(SceneError, match=r"bad\.mp4: expected a video, found a file that cannot be opened as one"):
        opened(tmp_path, sync="none")
