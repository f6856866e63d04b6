"""Images of another program, and packed runs, scored: the same numbers, and refusals in one line."""

from __future__ import annotations

import io
import json
import math
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from shell import TINY, Shell

from pipeline.pack import main as pack
from pipeline.report.runs import collect
from pipeline.report.tables import SCENES
from pipeline.score import main as score

ODD = tuple(key for key in TINY if not key.startswith(("scene.size", "train"))) + ("scene.size=53",)
LEVELS = 8  # by which every value of the images differs from the truth


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shell = Shell(tmp_path_factory.mktemp("scored"))
    _, err = shell(*TINY, "out=run", f"scene.cache={shell.folder}/cache")
    assert err == ""
    assert pack([str(shell.folder / "run"), "--out", str(shell.folder / "pack.zip")]) == 0
    return shell.folder / "run"


@pytest.fixture(scope="module")
def truths(run: Path) -> Path:
    """The true images of a scene of odd size, as scoring black images writes them."""
    black = run.parent / "black"
    black.mkdir()
    for number in range(3):
        Image.new("RGB", (53, 53)).save(black / f"r_{number:03d}.png")
    assert scored(run, black, out=run.parent / "of_black")[0] == 0
    return run.parent / "of_black/renders"


@pytest.fixture
def images(truths: Path, tmp_path: Path) -> Path:
    """LEVELS off the truth everywhere, named as the views are."""
    folder = tmp_path / "my-method"
    folder.mkdir()
    for number in range(3):
        truth = np.asarray(Image.open(truths / f"test_r_{number:03d}_truth.png")).astype(int)
        off = np.where(truth < 128, truth + LEVELS, truth - LEVELS).astype(np.uint8)
        Image.fromarray(off).save(folder / f"test_r_{number:03d}.png")
    return folder


def scored(run: Path, images: Path, *more: str, out: Path | None = None) -> tuple[int, dict]:
    out = out or images.parent / "scored"
    status = score([str(images), *ODD, f"scene.cache={run.parent}/cache", "--out", str(out), *more])
    return status, json.loads((out / "metrics.json").read_text()) if status == 0 else {}


def test_images_of_another_program_have_the_psnr_of_their_error(run: Path, images: Path) -> None:
    status, found = scored(run, images)
    assert status == 0
    assert (found["images"], found["recipe"], found["image_bits"]) == ("given", "my-method", 8)
    # float32 images: a relative error of 2e-6 of 8/255 from the rounding of values / 255
    assert found["final"]["psnr"] == pytest.approx(20 * math.log10(255 / LEVELS), abs=1e-4)
    assert found["conditions"]["size_px"] == [53, 53] and found["n_test_views"] == 3


def test_any_names_are_mapped_or_taken_in_order(run: Path, images: Path) -> None:
    _, by_name = scored(run, images)
    odd = images.parent / "odd names"
    odd.mkdir()
    names = {f"test/r_{number:03d}": f"Bild {number + 9}.PNG" for number in range(3)}  # 9, 10, 11: not by letters
    for number, name in enumerate(names.values()):
        shutil.copy(images / f"test_r_{number:03d}.png", odd / name)
    (images.parent / "names.json").write_text(json.dumps(names))
    own = "--method", "my-method"
    for how in (("--names", str(images.parent / "names.json")), ("--in-order",)):
        status, found = scored(run, odd, *how, *own)
        assert status == 0 and found["final"] == by_name["final"], how


def test_given_images_are_a_row_of_the_report_beside_the_run(run: Path, images: Path) -> None:
    root = images.parent / "runs"
    shutil.copytree(run, root / "own")
    cache, out = f"scene.cache={run.parent}/cache", str(root / "packed")
    assert score([str(run.parent / "pack.zip"), "scene=synthetic/wheel", cache, "--out", out]) == 0
    scored(run, images, out=root / "given")
    collection = collect(root)
    assert collection.left_out == collection.warnings == ()
    (table,) = [built for spec in SCENES if (built := spec.build(collection)) is not None]
    rows = {(row.cells["recipe_label"].text, row.cells["images"].text) for row in table.rows}
    assert rows == {("smoke", "rendered"), ("smoke", "given"), ("my-method", "given")}
    assert all(row.cells["seeds"].text == "1" for row in table.rows)


def test_a_packed_run_scores_to_the_digit(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    cache = f"scene.cache={run.parent}/cache"
    assert score([str(run.parent / "pack.zip"), "scene=synthetic/wheel", cache, "--out", str(tmp_path / "found")]) == 0
    own, found = (json.loads((folder / "metrics.json").read_text()) for folder in (run, tmp_path / "found"))
    assert found == own | {"images": "given", "best_on_test": None}
    said = capsys.readouterr().out
    measured = said.split("to the digit as packed: ")[1].split("\n")[0].split(", ")
    assert {"psnr", "ssim", "psnr_moving", "flow_error", "depth_error_median"} <= set(measured)
    assert own["final"].keys() - measured - {k for k, v in own["final"].items() if not isinstance(v, float)} == {
        "fps_raster", "fps_render"
    }  # fmt: skip


def test_a_pack_has_the_same_bytes_again(run: Path, tmp_path: Path) -> None:
    assert pack([str(run), "--out", str(tmp_path / "again.zip")]) == 0
    assert (tmp_path / "again.zip").read_bytes() == (run.parent / "pack.zip").read_bytes()


def test_altered_truth_is_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    shutil.copytree(run.parent / "cache", tmp_path / "cache")
    (file,) = (path for path in tmp_path.glob("cache/*/test/r_001.png") if Image.open(path).size == (48, 48))
    pixels = np.asarray(Image.open(file)).copy()
    pixels[20, 20] = 255 - pixels[20, 20]
    Image.fromarray(pixels).save(file)
    cache, out = f"scene.cache={tmp_path}/cache", str(tmp_path / "out")
    assert score([str(run.parent / "pack.zip"), "scene=synthetic/wheel", cache, "--out", out]) == 1
    assert "test/r_001: expected the true image that was packed (SHA-256 " in capsys.readouterr().err
    assert not Path(out).exists()


def repacked(source: Path, target: Path, change: Callable[[str, bytes], bytes]) -> Path:
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            new.writestr(name, change(name, old.read(name)))
    return target


def better_metrics(name: str, content: bytes) -> bytes:
    if name != "metrics.json":
        return content
    metrics = json.loads(content)
    metrics["final"]["psnr"] += 0.01
    return json.dumps(metrics).encode()


def other_pixels(name: str, content: bytes) -> bytes:
    if name != "exact/0001_image.npy":
        return content
    values = np.load(io.BytesIO(content))
    values[0, 0, 0] = 1 - values[0, 0, 0]
    file = io.BytesIO()
    np.save(file, values)
    return file.getvalue()


def no_pixels(name: str, content: bytes) -> bytes:
    return content[:300] if name == "exact/0002_image.npy" else content


def nothing(name: str, content: bytes) -> bytes:
    return b"[]" if name == "pack.json" else content


@pytest.mark.parametrize(
    "change, error",
    [
        (better_metrics, "expected the packed numbers of the packed images, found psnr: "),
        (other_pixels, "test/r_001: expected a PNG of the exact image, found another picture"),
        (no_pixels, "exact/0002_image.npy: expected an array, found "),
        (nothing, "pack.json: expected an object, found list"),
    ],
)
def test_an_altered_pack_is_refused(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture, change: Callable, error: str
) -> None:
    path = repacked(run.parent / "pack.zip", tmp_path / "altered.zip", change)
    cache, out = f"scene.cache={run.parent}/cache", str(tmp_path / "out")
    assert score([str(path), "scene=synthetic/wheel", cache, "--out", out]) == 1
    err = capsys.readouterr().err
    assert error in err and err.count("\n") == 1
    assert not (tmp_path / "out/metrics.json").exists()


def of_another_size(folder: Path) -> None:
    Image.new("RGB", (54, 53)).save(folder / "test_r_001.png")


def lost(folder: Path) -> None:
    (folder / "test_r_001.png").unlink()


def transparent(folder: Path) -> None:
    Image.new("RGBA", (53, 53), (9, 9, 9, 200)).save(folder / "test_r_001.png")


def of_16_bits(folder: Path) -> None:
    Image.fromarray(np.zeros((53, 53), np.uint16)).save(folder / "test_r_001.png")


def no_image(folder: Path) -> None:
    (folder / "test_r_001.png").write_text("no image")


@pytest.mark.parametrize(
    "change, error",
    [
        (of_another_size, "test_r_001.png: expected 53 x 53 pixels, of test/r_001 by unnamed-"),
        (lost, "expected a PNG named after each of the 3 test views, found 2 PNG files and none of test/r_001"),
        (transparent, "test_r_001.png: expected opaque pixels, composed over the protocol's background, found"),
        (of_16_bits, "test_r_001.png: expected 8 bits a channel, found image mode I;16"),
        (no_image, "test_r_001.png: expected a readable image, found "),
    ],
)
def test_images_that_do_not_fit_are_refused_in_a_line(
    run: Path, images: Path, capsys: pytest.CaptureFixture, change: Callable[[Path], None], error: str
) -> None:
    change(images)
    capsys.readouterr()
    assert scored(run, images)[0] == 1
    err = capsys.readouterr().err
    assert error in err and err.count("\n") == 1


@pytest.mark.parametrize(
    "names, error",
    [
        ({"test/r_000": "test_r_000.png"}, "expected a file of each of the 3 test views, found none of test/r_001"),
        ({"test/r_9": "test_r_000.png"}, "expected test views such as test/r_000, found test/r_9"),
        ({f"test/r_00{n}": "x.png" for n in range(3)}, "found x.png of test/r_000, which is none"),
        (["test_r_000.png"], "names.json: expected a JSON object {view: file}, found something else"),
    ],
)
def test_a_wrong_mapping_is_named(run: Path, images: Path, capsys: pytest.CaptureFixture, names, error: str) -> None:
    file = images.parent / "names.json"
    file.write_text(json.dumps(names))
    assert scored(run, images, "--names", str(file))[0] == 1
    assert error in capsys.readouterr().err


def test_a_trained_run_is_not_overwritten(run: Path, images: Path, capsys: pytest.CaptureFixture) -> None:
    before = (run / "metrics.json").read_bytes()
    assert scored(run, images, out=run)[0] == 1
    assert "expected nothing or an earlier score, found a trained run" in capsys.readouterr().err
    assert (run / "metrics.json").read_bytes() == before
