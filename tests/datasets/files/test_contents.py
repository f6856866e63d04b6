"""A path that is not the data's: the line says what it holds, and where the data are."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from layout_folders import write_nerfstudio

from datasets.files.contents import contents
from datasets.files.errors import SceneError
from datasets.files.unused_masks import unused_masks
from datasets.settings import SceneConfig
from datasets.source import open_source
from datasets.video_files.image_folder import image_paths


def refused(path: Path, reader: str = "auto") -> str:
    with pytest.raises(SceneError) as error:
        open_source(SceneConfig(name="x", reader=reader, path=str(path)), log=lambda line: None).scene()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_contents(tmp_path: Path) -> None:
    assert contents(tmp_path) == "nothing"
    for name in ("1.HEIC", "2.heic", "a.zip", "README", ".hidden"):
        (tmp_path / name).touch()
    assert contents(tmp_path) == "2 .heic (convert it to .jpg), 1 without a suffix, 1 .zip (unpack it)"
    for name in ("b.txt", "b.csv"):
        (tmp_path / name).touch()
    (tmp_path / "folder").mkdir()
    assert contents(tmp_path).startswith("2 .heic") and contents(tmp_path).endswith(", …, 1 folder")


@pytest.mark.parametrize("reader", ["auto", "video"])
def test_pictures_that_cannot_be_read_are_named(tmp_path: Path, reader: str) -> None:
    (tmp_path / "IMG_1.HEIC").touch()
    assert "1 .heic (convert it to .jpg)" in refused(tmp_path, reader)


@pytest.mark.parametrize("reader", ["auto", "video"])
def test_files_that_are_no_video_are_no_clip(tmp_path: Path, reader: str) -> None:
    """FFmpeg would read the text as a film of a terminal."""
    for name, line in (("a.zip", "found an archive; unpack it"), ("images.txt", r"found a \.txt file in it")):
        (tmp_path / name).write_text("text\n" * 1000)
        assert re.search(line, refused(tmp_path / name, reader))


def test_the_folder_of_the_data_is_named(tmp_path: Path) -> None:
    root = write_nerfstudio(tmp_path / "jug")
    hint = f", perhaps {root} (nerfstudio), found"
    assert hint in refused(root / "transforms.json") and hint in refused(tmp_path)
    (root / "colmap/points").mkdir(parents=True)
    assert hint in refused(root / "colmap/points")
    assert "perhaps" not in refused(tmp_path / "jug/colmap/points", "nerfstudio")


def test_masks_beside_images_are_named(tmp_path: Path) -> None:
    images = [tmp_path / "images" / name for name in ("a.png", "b.png")]
    masks = [tmp_path / name for name in ("masks/a.png", "masks/b.png", "images/a_mask.png")]
    for file in (*images, *masks):
        file.parent.mkdir(exist_ok=True)
        file.touch()
    said = f"{tmp_path}/masks (2 files), {tmp_path}/images/*_mask.* (1 files)"
    assert unused_masks(images) == said
    assert image_paths(tmp_path / "images") == images, "a mask is no frame"
    assert unused_masks([*images, *masks]) is None, "they are in use"


def test_a_message_of_many_parts_is_whole() -> None:
    """A list of layouts may be long; a single name in it may not."""
    parts = [f"layout {i} (no file of it at all, which takes some words to say)" for i in range(40)]
    text = str(SceneError("here", "one", [*parts, "x" * 5000]))
    assert all(part in text for part in parts) and len(text) < sum(map(len, parts)) + 1000
