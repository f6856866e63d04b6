"""Videos as people have them, small ones written by the test: what is used, what is said, what is refused."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import SIZE, frames, opened, write_clip
from imageio_ffmpeg import get_ffmpeg_exe

from datasets.clip import progress
from datasets.clip.clips import is_clip
from datasets.files.errors import SceneError


def evenly(count: int, rate: float = 30.0) -> list[float]:
    return [i / rate for i in range(count)]


def test_every_frame_of_a_short_clip_is_used_with_its_pixels_and_time(tmp_path: Path) -> None:
    images = frames(20)
    clip, said = opened(write_clip(tmp_path / "a.mp4", images, evenly(20)))
    assert [frame.name for frame in clip.frames] == [f"frame_{i:05d}" for i in range(20)] and said == ""
    np.testing.assert_allclose([frame.time for frame in clip.frames], evenly(20), atol=1e-4)  # ticks of the file
    # 4:2:0 at crf 12: about two levels in the mean; a frame that is off by one differs by 30.
    assert max(np.abs(f.image.astype(float) - i).mean() for f, i in zip(clip.frames, images)) < 12


def test_times_of_a_varying_rate_are_those_of_the_file(tmp_path: Path) -> None:
    times = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.07, 20)).tolist()
    clip, _ = opened(write_clip(tmp_path / "a.mp4", frames(20), times))
    found = np.array([frame.time for frame in clip.frames])
    np.testing.assert_allclose(found - found[0], np.array(times) - times[0], atol=1e-4)


def test_a_clip_that_is_stored_sideways_is_turned(tmp_path: Path) -> None:
    images = frames(16)
    stored = write_clip(tmp_path / "stored.mp4", [np.rot90(image) for image in images], evenly(16))
    turned = tmp_path / "turned.mp4"
    # A player turns it counterclockwise by the angle in the file.
    command = [get_ffmpeg_exe(), "-v", "error", "-display_rotation", "-90", "-i", stored, "-c", "copy", turned]
    subprocess.run(command, check=True)
    clip, said = opened(turned)
    assert clip.size == SIZE and "stored sideways" in said
    assert np.abs(clip.frames[3].image.astype(float) - images[3]).mean() < 12


def test_ten_bits_are_rounded_and_high_dynamic_range_is_mapped(tmp_path: Path) -> None:
    images = frames(16)
    clip, said = opened(write_clip(tmp_path / "ten.mp4", images, evenly(16), pixels="yuv420p10le"))
    assert "10 bits" in said and np.abs(clip.frames[3].image.astype(float) - images[3]).mean() < 12
    params = {"x264-params": "transfer=smpte2084:colorprim=bt2020:colormatrix=bt2020nc"}
    clip, said = opened(
        write_clip(
            tmp_path / "hdr.mp4", [image // 2 for image in images], evenly(16), pixels="yuv420p10le", options=params
        )
    )
    assert "PQ" in said
    image = clip.frames[3].image
    order = np.corrcoef(image.mean(axis=2).ravel(), images[3].mean(axis=2).ravel())[0, 1]
    assert order > 0.8 and image.std() > 20 and image.max() <= 255  # the picture is still there, in range


def test_pixels_that_are_not_square_are_made_so(tmp_path: Path) -> None:
    """Two columns of the frame are a stored one. Grey, so that colour of half the resolution does not count."""
    images = [image.reshape(64, 48, 6).mean(axis=2).astype(np.uint8) for image in frames(16)]
    stored = [np.dstack([image] * 3) for image in images]
    narrow, wide = write_clip(tmp_path / "narrow.mp4", stored, evenly(16)), tmp_path / "wide.mp4"
    aspect = "-c copy -bsf:v h264_metadata=sample_aspect_ratio=2"
    subprocess.run([get_ffmpeg_exe(), "-v", "error", "-i", narrow, *aspect.split(), wide], check=True)
    clip, said = opened(wide)
    assert clip.size == SIZE and "pixels are 2 times as wide as high: frames are scaled to 96 x 64" in said
    found = clip.frames[3].image.reshape(64, 48, 6).mean(axis=2)
    assert np.abs(found - images[3]).mean() < 3  # crf 12: about two levels


def test_an_aspect_that_is_the_rounding_of_a_scaled_size_is_square(tmp_path: Path) -> None:
    """ffmpeg writes 1.0104 for 97 × 64 scaled to 96 × 64."""
    plain, rounded = write_clip(tmp_path / "plain.mp4", frames(16), evenly(16)), tmp_path / "rounded.mp4"
    aspect = "-c copy -bsf:v h264_metadata=sample_aspect_ratio=97/96"
    subprocess.run([get_ffmpeg_exe(), "-v", "error", "-i", plain, *aspect.split(), rounded], check=True)
    clip, said = opened(rounded)
    assert clip.size == SIZE and "wide as high" not in said
    np.testing.assert_array_equal(clip.frames[3].image, opened(plain)[0].frames[3].image)


def test_a_cut_leaves_the_longest_take(tmp_path: Path) -> None:
    clip, said = opened(write_clip(tmp_path / "a.mp4", frames(15) + frames(30, seed=1), evenly(45)))
    assert [frame.name for frame in clip.frames] == [f"frame_{i:05d}" for i in range(15, 45)]
    assert "cut" in said and "0.5–1.5 s" in said


def test_fades_and_black_bars_are_left_out(tmp_path: Path) -> None:
    images = frames(24)
    for i in range(4):
        images[i] = (images[i] * (0.012 * i)).astype(np.uint8)
    barred = [np.pad(image, ((8, 8), (0, 0), (0, 0))) for image in images]
    clip, said = opened(write_clip(tmp_path / "a.mp4", barred, evenly(24)))
    assert clip.frames[0].name == "frame_00004" and "show nothing" in said
    assert clip.size[0] == SIZE[0] and abs(clip.size[1] - SIZE[1]) <= 2 and "black bars" in said


def test_blurred_and_repeated_frames_are_left_out(tmp_path: Path) -> None:
    images = frames(24)
    images[10] = cv2.GaussianBlur(images[10], (0, 0), 4)
    images[17] = images[16]
    clip, said = opened(write_clip(tmp_path / "a.mp4", images, evenly(24)))
    missing = {f"frame_{i:05d}" for i in range(24)} - {frame.name for frame in clip.frames}
    assert "frame_00010" in missing and "frame_00017" in missing and len(missing) <= 3
    assert "blurred" in said and "repeated" in said


def test_a_damaged_stretch_is_left_out(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "a.mp4", frames(60), evenly(60), options={"g": "5", "bf": "0"})
    content = bytearray(path.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 400] = bytes(400)
    path.write_bytes(content)
    clip, said = opened(path)
    assert 40 <= len(clip.frames) < 60 and ("damaged" in said or "cut" in said or "blurred" in said)


def test_a_file_that_ends_early_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "a.mkv", frames(60), evenly(60))
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
    clip, _ = opened(path)
    assert 20 <= len(clip.frames) < 60


def test_a_long_look_at_frames_says_how_far_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that goes on by four seconds a frame; a line every ten."""
    seconds, lines = iter(range(0, 1000, 4)), []
    monkeypatch.setattr(progress.time, "perf_counter", lambda: float(next(seconds)))
    assert list(progress.counted(range(8), 8, "walk.mp4", lines.append)) == list(range(8))
    assert lines == ["walk.mp4: 3 of 8 frames looked at, 20 s left", "walk.mp4: 6 of 8 frames looked at, 8 s left"]


def test_a_long_clip_is_thinned(tmp_path: Path) -> None:
    small = [cv2.resize(image, (48, 32)) for image in frames(40)]
    path = write_clip(tmp_path / "a.mp4", (small[abs(i % 78 - 39)] for i in range(4100)), evenly(4100))
    clip, said = opened(path, frames=50)
    assert 40 <= len(clip.frames) <= 50 and "are used" in said
    assert np.diff([frame.time for frame in clip.frames]).max() < 3 * (4100 / 30) / 50


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_frames_are_refused(tmp_path: Path, count: int) -> None:
    with pytest.raises(SceneError, match="at least 12 sharp frames of one take, found .*film 5 to 20 seconds"):
        opened(write_clip(tmp_path / "a.mp4", frames(count), evenly(count)))


@pytest.mark.parametrize(
    "settings, expected",
    [
        ({"first_frame": 40}, r"a\.mp4: scene\.first_frame: expected below the 20 frames of the clip, found 40"),
        ({"first_frame": 12}, r"sharp frames of one take, found 8 of 20 from scene\.first_frame=12 on; film"),
        ({"frames": 5}, r"a\.mp4: scene\.frames: expected more, to use 12 of the clip's 20 .*found 5, which uses 5"),
        ({"test_every": 40}, r"a\.mp4: scene\.test_every: expected below 40, twice the frames in use, found 40"),
    ],
)
def test_settings_that_leave_nothing_are_named(tmp_path: Path, settings: dict, expected: str) -> None:
    path = write_clip(tmp_path / "a.mp4", frames(20), evenly(20))
    with pytest.raises(SceneError, match=expected):
        opened(path, **settings)


def test_one_held_out_frame_is_enough(tmp_path: Path) -> None:
    assert len(opened(write_clip(tmp_path / "a.mp4", frames(20), evenly(20)), test_every=39)[0].frames) == 20


def test_names_and_folders(tmp_path: Path) -> None:
    folder = tmp_path / "Küche und Bad"
    folder.mkdir()
    path = write_clip(folder / "mein Film ä.mp4", frames(14), evenly(14))
    folder.chmod(0o555)
    try:
        assert is_clip(path) and is_clip(folder)
        assert len(opened(folder)[0].frames) == len(opened(path)[0].frames) == 14
    finally:
        folder.chmod(0o755)


@pytest.mark.parametrize("content, expected", [(b"no video", "cannot be opened"), (None, "nothing there")])
def test_what_is_no_clip_is_refused(tmp_path: Path, content: bytes | None, expected: str) -> None:
    path = tmp_path / "a.mp4"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SceneError, match=expected):
        opened(path)


def test_a_video_that_changes_its_size_is_refused(tmp_path: Path) -> None:
    # MPEG transport streams can be joined end to end.
    parts = []
    for i, size in enumerate(("96x64", "128x64")):
        parts.append(tmp_path / f"{i}.ts")
        source = ["-f", "lavfi", "-i", f"testsrc=size={size}:rate=30:duration=1"]
        subprocess.run([get_ffmpeg_exe(), "-loglevel", "error", *source, "-c:v", "mpeg2video", parts[i]], check=True)
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    with pytest.raises(SceneError, match=r"frames of one size, 96 x 64 pixels, found 128 x 64 pixels at frame"):
        opened(joined)


def test_a_folder_of_several_videos_is_no_clip(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "a.mp4", frames(2), evenly(2))
    shutil.copy(path, tmp_path / "b.mp4")
    assert not is_clip(tmp_path)
