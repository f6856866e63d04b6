"""The schemas describe what runs write: a real run and scored images are valid, and damaged ones are not."""

from __future__ import annotations

import copy
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import pytest
from jsonschema import Draft202012Validator
from shell import TINY, Shell

from datasets.scene import Capture
from pipeline.evaluation.metrics import METRICS
from pipeline.pack import main as pack
from pipeline.report.runs import IMAGES
from pipeline.runs.folder_content import folder_content, schema
from pipeline.runs.run_identity import FILES
from pipeline.score import main as score
from pipeline.stages.stages import NAMES
from pipeline.validate import main, violations


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shell = Shell(tmp_path_factory.mktemp("schemas"))
    _, err = shell(*TINY, "out=run", f"scene.cache={shell.folder}/cache")
    assert err == ""
    return shell.folder / "run"


def test_a_run_folder_follows_its_schema(run: Path) -> None:
    content = folder_content(run)
    assert violations("run_folder", content) == [] == violations("metrics", content["metrics.json"])
    assert set(METRICS) & set(content["metrics.json"]["final"]) >= {"psnr", "ssim", "fps_render"}


def test_a_pack_that_was_scored_follows_it_too(run: Path, tmp_path: Path) -> None:
    cache, out = f"scene.cache={run.parent}/cache", tmp_path / "scored"
    assert pack([str(run), "--out", str(tmp_path / "pack.zip")]) == 0
    assert score([str(tmp_path / "pack.zip"), "scene=synthetic/wheel", cache, "--out", str(out)]) == 0
    assert violations("run_folder", folder_content(out)) == []
    images = tmp_path / "images"
    images.mkdir()
    for path in (run / "renders").glob("*_render.png"):
        shutil.copy(path, images / path.name)
    keys = [key for key in TINY if not key.startswith("train")]
    assert score([str(images), *keys, cache, "--out", str(tmp_path / "images_scored")]) == 0
    assert violations("run_folder", folder_content(tmp_path / "images_scored")) == []


def _set(*path: str, value: Any) -> Callable[[dict], None]:
    def change(content: dict) -> None:
        for name in path[:-1]:
            content = content[name]
        content[path[-1]] = value

    return change


@pytest.mark.parametrize(
    "change, where",
    [
        (_set("metrics.json", "capture", value="film"), "capture"),
        (_set("metrics.json", "final", "psnr", value="30.1"), "psnr"),
        (_set("metrics.json", "final", "psnr", value=None), "psnr"),
        (_set("metrics.json", "protocol", value="mine"), "protocol"),
        (_set("metrics.json", "psnr", value=30.1), "metrics.json"),
        (_set("metrics.json", "seed", value=-1), "seed"),
        (_set("config.yaml", "seed", value="0"), "seed"),
        (_set("environment.json", "git_commit", value="main"), "git_commit"),
        (_set("stages.json", "polish", value={}), "stages.json"),
        (_set("strange.bin", value=None), "$"),
        (lambda content: content.pop("checkpoint.safetensors"), "$"),
        (lambda content: content["per_image.csv"][0].pop("psnr"), "per_image.csv"),
        (lambda content: content["metrics.json"].pop("train_seconds"), "metrics.json"),
    ],
)
def test_what_is_damaged_does_not(run: Path, change: Callable[[dict], None], where: str) -> None:
    content = copy.deepcopy(folder_content(run))
    change(content)
    found = violations("run_folder", content)
    assert found and all(where in error for error in found), found


def test_the_command_names_what_does_not_follow(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    damaged = shutil.copytree(run, tmp_path / "damaged")
    (damaged / "strange.bin").touch()
    assert main([str(run)]) == 0 and main([str(run), str(damaged)]) == 1
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == [f"{run}: follows the schema"] * 2
    assert len(said) == 3 and said[2].startswith(f"{damaged}: $: ") and "strange.bin" in said[2]


def test_the_schemas_are_schemas_and_list_what_the_program_has() -> None:
    metrics, folder = schema("metrics"), schema("run_folder")
    for one in (metrics, folder):
        Draft202012Validator.check_schema(one)
    assert tuple(metrics["properties"]["capture"]["enum"]) == get_args(Capture)
    assert tuple(metrics["properties"]["images"]["enum"]) == IMAGES
    assert tuple(folder["properties"]["stages.json"]["propertyNames"]["enum"]) == NAMES
    (names, _) = folder["patternProperties"]
    assert {name for name in FILES.values() if name not in folder["properties"]} == {
        name.replace("\\", "") for name in names[2:-2].split("|")
    }
