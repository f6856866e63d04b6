"""Croissant metadata of a synthetic scene: every file with its SHA-256, and views that its paths lead to."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from datasets.synthetic import build_scene


def test_every_file_and_every_view_is_described(tmp_path: Path) -> None:
    folder = build_scene(tmp_path / "scene", scene="wheel", size=16, train_views=3, test_views=1)
    found = json.loads((folder / "croissant.json").read_text())
    digests = {row["contentUrl"]: row["sha256"] for row in found["distribution"]}
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    assert digests == {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for name, path in files.items()
        if name not in ("croissant.json", "manifest.yaml")
    }
    assert [record["name"] for record in found["recordSet"]] == ["test", "train", "val"]
    for record in found["recordSet"]:
        for field in record["field"]:
            source = field["source"]
            frames = json.loads((folder / source["fileObject"]["@id"]).read_text())["frames"]
            name = source["extract"]["jsonPath"].removeprefix("$.frames[*].")
            assert source["fileObject"]["@id"] in digests and all(name in frame for frame in frames)
