"""Manifests: what is missing or altered is named, and their hashes are those that sha256sum computes."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from datasets import manifest
from datasets.__main__ import main
from datasets.manifest import Manifest, described, names, published, read_manifest, recorded, write_manifest
from datasets.synthetic import build_scene

CONTENT = {
    "../poses: all.txt": b"poses",
    "train/r_0.png": b"first",
    "train/r_1.png": b"second",
    "transforms_train.json": b"{}",
}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The data set `toy` of one scene, with its manifest."""
    folder = tmp_path / "toy/disc"
    (folder / "train").mkdir(parents=True)
    for name, content in CONTENT.items():
        (folder / name).write_bytes(content)
    (tmp_path / "manifests").mkdir()
    monkeypatch.setattr(manifest, "FOLDER", tmp_path / "manifests")
    toy = Manifest(
        "toy", "Toy: a disc", "nowhere", "none", {"disc": described(folder, list(CONTENT))}, ("it is: flat",)
    )
    write_manifest(tmp_path / "manifests/toy.yaml", toy)
    assert published("toy") == toy
    assert "train/r_{0..1}.png:" in (tmp_path / "manifests/toy.yaml").read_text()
    return folder


def test_a_scene_has_the_hash_of_the_lines_of_sha256sum(data: Path) -> None:
    lines = "".join(f"{hashlib.sha256(CONTENT[name]).hexdigest()}  {name}\n" for name in sorted(CONTENT))
    assert published("toy").scenes["disc"].sha256 == hashlib.sha256(lines.encode()).hexdigest()


def test_whole_data_are_verified(data: Path, capsys: pytest.CaptureFixture) -> None:
    (data / "notes.txt").write_text("mine")
    assert main(["verify", "toy", str(data.parent)]) == main(["verify", "toy/disc", str(data)]) == 0
    said = capsys.readouterr().out
    assert "it is: flat" in said and "disc: as published, 4 files, 18 bytes, SHA-256 " in said
    assert "1 other files, which the manifest lacks" in said


def test_what_is_missing_or_altered_is_named(data: Path, capsys: pytest.CaptureFixture) -> None:
    (data / "train/r_0.png").write_bytes(b"fIrst")  # of the same size
    (data / "transforms_train.json").unlink()
    assert main(["verify", "toy/disc", str(data)]) == 1
    said = capsys.readouterr().out
    assert "1 missing: transforms_train.json; 1 altered: train/r_0.png" in said
    found = recorded("toy/disc", data)
    assert found and "altered" in found["found"] and recorded("toy/other", data) is None


def test_a_scene_is_known_by_its_folder_and_files_where_its_name_says_nothing(data: Path) -> None:
    assert recorded("auto/disc", data) == recorded("toy/disc", data)
    assert recorded("auto/cube", data) is None
    (data / "train/r_2.png").write_bytes(b"more")
    found = recorded("auto/disc", data)
    assert found and found["found"] == "as published, and 1 other files"
    (data / "train/r_1.png").unlink()
    assert recorded("auto/disc", data) is None, "another folder of this name"


def test_a_scene_may_lie_deeper_in_the_data_set(data: Path, capsys: pytest.CaptureFixture) -> None:
    toy = published("toy")
    deeper = replace(toy, scenes={"disc": replace(toy.scenes["disc"], folder="toy/disc")})
    write_manifest(manifest.FOLDER / "toy.yaml", deeper)
    assert published("toy") == deeper
    assert main(["verify", "toy", str(data.parents[1])]) == main(["verify", "toy/disc", str(data)]) == 0


@pytest.mark.parametrize(
    "name, error",
    [
        ("tay", "manifest: expected one of toy, or synthetic/NAME, found 'tay'"),
        ("toy/cube", "toy: expected one of disc, found cube"),
        ("synthetic/wheel", "expected a synthetic scene with manifest.yaml, found none"),
    ],
)
def test_an_unknown_name_is_a_line(data: Path, capsys: pytest.CaptureFixture, name: str, error: str) -> None:
    assert main(["verify", name, str(data)]) == 1
    assert error in capsys.readouterr().err
    assert main(["verify", "toy", str(data / "nowhere")]) == 1
    assert "nowhere: expected a folder of the data set, found nothing there" in capsys.readouterr().err


def test_a_damaged_manifest_is_named(data: Path) -> None:
    path = manifest.FOLDER / "toy.yaml"
    path.write_text(path.read_text().replace("sha256", "sha"))
    with pytest.raises(ValueError, match="toy.yaml: expected a manifest, found 'sha256'"):
        read_manifest(path)


def test_a_synthetic_scene_publishes_its_own(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    folders = [
        build_scene(tmp_path / name, scene="still", size=16, train_views=2, test_views=1) for name in ("one", "two")
    ]
    assert main(["verify", "synthetic/still", str(folders[0])]) == 0
    first, second = (recorded("synthetic/still", folder) for folder in folders)
    assert first == second and first is not None and first["found"] == "as published"
    next(iter(folders[1].glob("test/*.npz"))).write_bytes(b"")
    assert main(["verify", "synthetic/still", str(folders[1])]) == 1
    assert "1 altered: test/r_000.npz" in capsys.readouterr().out


def test_a_synthetic_scene_appears_with_its_manifest_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process that finds the folder would otherwise write the manifest, too."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("datasets.synthetic.write_croissant", interrupted)
    with pytest.raises(KeyboardInterrupt):
        build_scene(tmp_path / "one", scene="still", size=16, train_views=2, test_views=1)
    assert list(tmp_path.iterdir()) == []


def test_every_published_manifest_can_be_read() -> None:
    for name in names():
        found = published(name)
        assert found.name == name and found.scenes and all(scene.files for scene in found.scenes.values())
