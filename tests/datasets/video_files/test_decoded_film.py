"""What is shown of a video, beside what the ffmpeg program shows of it: frames, their times, and what is left out."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from clips import frames, textured_plane, write_clip
from imageio_ffmpeg import get_ffmpeg_exe

from datasets.files.errors import SceneError
from datasets.video_files.film import Film, keep_film, open_film

# Levels of 255: the program, another release, may round one conversion another way. Other frames differ by 30.
ROUNDING = 2


def ffmpeg(*arguments: object) -> bytes:
    command = [get_ffmpeg_exe(), "-v", "error", "-y", *map(str, arguments)]
    return subprocess.run(command, check=True, capture_output=True).stdout


def by_the_program(path: Path, size: tuple[int, int], *options: str) -> np.ndarray:
    """(N, H, W, 3): the frames of the first film that is no cover."""
    output = ("-map", "0:V:0", "-fps_mode", "passthrough", *options, "-pix_fmt", "rgb24", "-f", "rawvideo", "-")
    shown = ffmpeg("-i", path, *output)
    return np.frombuffer(shown, np.uint8).reshape(-1, size[1], size[0], 3)


def images(film: Film, threads: int = 1) -> list[np.ndarray | None]:
    return [frame.image for frame in film.frames(threads=threads)]


def opened(path: Path) -> Film:
    return open_film(path, path.parent / "cache", 2)


def check_frames(film: Film, expected: Sequence[np.ndarray], first: int = 0) -> None:
    found = images(film)
    assert len(found) == film.count == len(expected)
    for image, truth in zip(found[first:], expected[first:], strict=True):
        assert image is not None and image.shape == truth.shape
        assert np.abs(image.astype(int) - truth).max() <= ROUNDING


def clip(path: Path, count: int = 24, rate: float = 24.0, **options: str) -> Path:
    return write_clip(path, frames(count), [i / rate for i in range(count)], options=options)


@pytest.mark.parametrize("angle", [0, 90, 180, 270])
@pytest.mark.parametrize("flip", [(), ("-display_hflip",), ("-display_vflip",)])
def test_display_matrices_turn_and_mirror(tmp_path: Path, angle: int, flip: tuple[str, ...]) -> None:
    path = tmp_path / "turned.mp4"
    ffmpeg("-display_rotation", angle, *flip, "-i", clip(tmp_path / "a.mp4", 4), "-c", "copy", path)
    film = opened(path)
    assert film.size == ((64, 96) if angle % 180 else (96, 64))
    check_frames(film, by_the_program(path, film.size))
    assert bool(film.notes()) == (angle != 0 or bool(flip))


def test_a_cover_picture_is_no_film(tmp_path: Path) -> None:
    cover, path = tmp_path / "cover.png", tmp_path / "with_cover.mp4"
    ffmpeg("-f", "lavfi", "-i", "color=red:s=200x200", "-frames:v", 1, cover)
    film_only, sound = clip(tmp_path / "a.mp4"), ("-f", "lavfi", "-i", "sine=d=1")
    ffmpeg("-i", cover, "-i", film_only, "-map", 0, "-map", 1, "-c", "copy", "-disposition:v:0", "attached_pic", path)
    assert opened(path).size == (96, 64) and opened(path).notes() == ["its cover picture is left out"]
    check_frames(opened(path), by_the_program(film_only, (96, 64)))
    ffmpeg("-i", cover, *sound, "-c:v", "copy", "-c:a", "aac", "-disposition:v:0", "attached_pic", tmp_path / "a.m4a")
    with pytest.raises(SceneError, match="expected a video, found a cover picture alone: a sound file"):
        opened(tmp_path / "a.m4a")


def test_frames_that_an_edit_list_cuts_are_not_shown(tmp_path: Path) -> None:
    """Cut without encoding at 0.7 s, between key frames: the file holds more than it shows."""
    path = tmp_path / "cut.mp4"
    ffmpeg("-ss", 0.7, "-i", clip(tmp_path / "a.mp4", 48, g="12", bf="2"), "-c", "copy", path)
    expected = by_the_program(path, (96, 64))
    assert len(expected) < 48
    check_frames(opened(path), expected)
    assert np.isclose(np.diff(opened(path).times), 1 / 24, atol=1e-3).all()


@pytest.mark.parametrize("codec", [("libx264", "-x264-params", "tff=1"), ("mpeg2video", "-flags", "+ilme+ildct")])
def test_interlaced_frames_are_filled_in_and_the_same_each_time(tmp_path: Path, codec: tuple[str, ...]) -> None:
    path = tmp_path / "interlaced.mp4"
    source = clip(tmp_path / "a.mp4", 48, 48.0)
    fields = ("-vf", "tinterlace=interleave_top,fieldorder=tff", "-field_order", "tt", "-colorspace", "bt709")
    ffmpeg("-i", source, *fields, "-c:v", codec[0], *codec[1:], "-q:v", 2, "-pix_fmt", "yuv420p", path)
    film = opened(path)
    assert film.notes() == [f"{film.count} of {film.count} frames are interlaced: lines filled in by bwdif"]
    expected = by_the_program(path, film.size, "-vf", "bwdif=send_frame:auto:interlaced")
    # The first frame has no neighbour before it; FFmpeg's releases fill it in in other ways.
    check_frames(film, expected, first=1)
    first = images(film)
    assert len({image.tobytes() for image in first if image is not None}) == film.count
    assert all(np.array_equal(a, b) for a, b in zip(first, images(film, threads=3), strict=True))


def test_joined_recordings_go_on(tmp_path: Path) -> None:
    parts = [tmp_path / f"{name}.ts" for name in "ab"]
    for part, length in zip(parts, (18, 14)):
        clip(part, length, g="100", bf="2")
    joined = tmp_path / "joined.ts"
    joined.write_bytes(b"".join(part.read_bytes() for part in parts))
    film = opened(joined)
    np.testing.assert_allclose(film.times, np.arange(32) / 24, atol=1e-4)
    check_frames(film, np.concatenate([by_the_program(part, (96, 64)) for part in parts]))
    assert film.damage() is None and film.notes() == ["its clock jumps (1 x): continued by a step of 41.7 ms"]


def damaged(path: Path, change: str) -> Path:
    """A copy with 700 bytes of the middle zeroed or overwritten, or without them."""
    content = path.read_bytes()
    middle, rng = len(content) // 188 // 2 * 188, np.random.default_rng(0)
    length = 188 * 4
    put = {"hole": bytes(length), "noise": rng.bytes(length), "gone": b""}[change]
    copy = path.with_name(f"{change}{path.suffix}")
    copy.write_bytes(content[:middle] + put + content[middle + length :])
    return copy


@pytest.mark.parametrize("kind", ["hole.mp4", "noise.mp4", "gone.ts", "hole.ts"])
def test_a_damaged_stretch_ends_at_a_key_frame_whatever_the_threads(tmp_path: Path, kind: str) -> None:
    change, suffix = kind.split(".")
    whole = clip(tmp_path / f"a.{suffix}", 60, g="12", bf="2")
    truth = {round(time * 24): image for time, image in zip(opened(whole).times, images(opened(whole)), strict=True)}
    path = damaged(whole, change)
    film = opened(path)
    found = {round(frame.time * 24): frame.image for frame in film.frames(threads=3)}
    intact = {number for number, image in found.items() if image is not None}
    assert 36 <= len(intact) < 60  # a group of 12 frames, or two where the damage meets a key frame
    assert all(np.array_equal(found[number], truth[number]) for number in intact)
    single = open_film(path, tmp_path / "other", 1)
    assert np.array_equal(single.intact, film.intact) and single.damage() == film.damage() is not None


def test_counts_and_times_are_those_shown_whatever_headers_say(tmp_path: Path) -> None:
    """Frame 9 of 24 was dropped. Matroska rounds times to milliseconds and does not say a count."""
    times = np.delete(np.arange(24) / 30, 9)
    for suffix in ("mp4", "mkv"):
        film = opened(write_clip(tmp_path / f"a.{suffix}", frames(23), times.tolist()))
        np.testing.assert_allclose(film.times, times, atol=6e-4)
        assert (film.count, film.rate, film.even) == (23, 30.0, True)
    varying = np.cumsum(np.random.default_rng(0).uniform(0.02, 0.07, 24))
    film = opened(write_clip(tmp_path / "b.mp4", frames(24), varying.tolist()))
    assert not film.even and film.rate == pytest.approx(23 / (varying[-1] - varying[0]), rel=1e-3)


def test_files_without_times_of_display_are_counted(tmp_path: Path) -> None:
    source = clip(tmp_path / "a.mp4", 24, 25.0, bf="2")
    for name, said in (("a.avi", []), ("a.h264", ["no time stamps: 25 frames a second are taken"])):
        ffmpeg("-i", source, "-c", "copy", *(["-r", 25] if said else []), tmp_path / name)
        film = opened(tmp_path / name)
        check_frames(film, by_the_program(source, (96, 64)))
        np.testing.assert_allclose(film.times, np.arange(24) / 25, atol=1e-6)
        assert film.notes() == said and film.rate == 25


def test_a_kept_film_is_not_decoded_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = clip(tmp_path / "a.mp4")
    film = opened(path)
    keep_film(path, tmp_path / "cache")
    monkeypatch.setattr("datasets.video_files.film._FILMS", {})
    monkeypatch.setattr("datasets.video_files.film._decoded", None)  # decoding would fail
    again = opened(path)
    assert (again.size, again.turn, again.rate, again.notes()) == (film.size, film.turn, film.rate, film.notes())
    assert np.array_equal(again.times, film.times) and np.array_equal(again.intact, film.intact)
    path.write_bytes(path.read_bytes())  # another time of change
    with pytest.raises(TypeError):
        opened(path)


def test_a_file_of_one_frame_and_its_pixels(tmp_path: Path) -> None:
    film = opened(write_clip(tmp_path / "a.mp4", [textured_plane(0)], [0.0]))
    assert (film.count, film.rate, film.notes(), film.damage()) == (1, 30.0, [], None)
    check_frames(film, by_the_program(film.path, (96, 64)))
