"""A layout is one module and one YAML: with both in folders of their own a scene is read, and scene=auto finds it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hydra import compose, initialize_config_dir
from PIL import Image

from datasets import readers
from datasets.files.errors import SceneError
from datasets.settings import SceneConfig
from datasets.source import open_source
from pipeline.config.compose import CONFIG_DIR, register_schema, to_config

MODULE = """
import json
from pathlib import Path

import numpy as np

from datasets.photographs.photograph import PosedFile
from datasets.photographs.scene import to_scene
from datasets.scene import Scene
from datasets.settings import SceneConfig
from datasets.source import Log
from rasterizer.camera import Camera

TITLE, PRECEDENCE = "Toy", 15


def matches(path: Path) -> str | None:
    return None if (path / "toy.json").is_file() else "no toy.json"


def read(root: Path, cfg: SceneConfig, log: Log) -> Scene:
    entries = json.loads((root / "toy.json").read_text())
    files = []
    for name, x in entries.items():
        pose = np.eye(4)
        pose[:3, 3] = -x, 0, 4
        files.append(PosedFile(name, root / f"{name}.png", Camera(16, 12, 20.0, 20.0, 8.0, 6.0, pose)))
    return to_scene(root, files, cfg, log)
"""
YAML = """
name: ${named_after_folder:toy,${scene.path}}
reader: toy
downscale: 1
test_every: 4
"""
COUNT = 8


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The module is in a folder of the package's path, the YAML in one of Hydra's; returns the latter as a setting."""
    (tmp_path / "readers").mkdir()
    (tmp_path / "readers" / "toy.py").write_text(MODULE)
    (tmp_path / "conf" / "scene").mkdir(parents=True)
    (tmp_path / "conf" / "scene" / "toy.yaml").write_text(YAML)
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(tmp_path / "readers")])
    return f"hydra.searchpath=[file://{tmp_path / 'conf'}]"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Photographs 00.png, 01.png, … of as many times, from x = 0, 0.1, …; a grey for each."""
    data = tmp_path / "data"
    data.mkdir()
    (data / "toy.json").write_text(json.dumps({f"{i:02d}": 0.1 * i for i in range(COUNT)}))
    for i in range(COUNT):
        Image.fromarray(np.full((12, 16, 3), 10 * i, np.uint8)).save(data / f"{i:02d}.png")
    return data


@pytest.mark.parametrize("scene", ["toy", "auto"])
def test_its_scene_is_read(scene: str, settings: str, folder: Path) -> None:
    register_schema()
    with initialize_config_dir(str(CONFIG_DIR), version_base=None):
        overrides = [settings, f"scene={scene}", f"scene.path={folder}"]
        cfg = to_config(compose("config", overrides)).scene
    lines: list[str] = []
    found = open_source(cfg, log=lines.append).scene()
    assert found.name == f"{scene}/data" and found.capture == "clip"
    assert len(found.test) == {"toy": 2, "auto": 1}[scene] and len(found.train) + len(found.test) == COUNT
    for view in found.train + found.test:
        number = int(view.name[-2:])
        assert (np.asarray(view.image) == 10 * number).all()
        np.testing.assert_allclose(view.camera.position, [0.1 * number, 0, -4], atol=1e-12)
    assert any("taken for Toy (scene.reader=toy); not Dynamic 3D Gaussians" in line for line in lines) == (
        scene == "auto"
    )


def test_another_folder_is_not_taken_for_it(settings: str, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(SceneError, match=r"not Dynamic 3D Gaussians \(no train_meta.json\), Toy \(no toy.json\), "):
        open_source(SceneConfig(reader="auto", path=str(tmp_path / "empty")))
