"""Protocols: which one a run follows, and that their files say what the code does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dnerf_folder import write_folder
from tiny import tiny_config, tiny_scene

from pipeline.config.compose import Command
from pipeline.data.prepare import prepare
from pipeline.evaluation import protocol
from pipeline.evaluation.image_metrics import channels_psnr, psnr
from pipeline.evaluation.lpips import _FILES
from pipeline.evaluation.protocol import MixedProtocols, conditions, one_protocol, protocol_of, protocols
from pipeline.report.paper_table import PAPER_DIR, read
from pipeline.report.scenes import DNERF, PLENOPTIC
from pipeline.stages.settle import for_scene

HALF = {"size_px": [400, 400], "background": [0.0, 0.0, 0.0], "test_views_found": 20}


@pytest.mark.parametrize(
    "scene, changed, expected",
    [
        ("dnerf/hook", {}, "dnerf-400-black-v1"),
        ("dnerf/hook", {"background": [1.0, 1.0, 1.0]}, "dnerf-400-white-v1"),
        ("dnerf/hook", {"size_px": [800, 800], "downscale": 1}, "dnerf-800-black-v1"),
        ("dnerf/lego", {"test_split": "val"}, "dnerf-400-black-v1"),
        ("mujoco/any", {"background": [1.0, 1.0, 1.0]}, "mujoco-400-white-v1"),
        ("kitti/04", {"test_every": 4, "size_px": [613, 185]}, "urban-every4-v1"),
    ],
)
def test_conditions_of_a_protocol_have_its_name(scene: str, changed: dict, expected: str) -> None:
    assert protocol_of(scene, HALF | changed) == expected


@pytest.mark.parametrize(
    "scene, changed",
    [
        ("dnerf/lego", {}),  # its test split
        ("dnerf/hook", {"test_split": "val"}),
        ("dnerf/hook", {"validation_every": 8}),
        ("dnerf/hook", {"size_px": [200, 200]}),
        ("dnerf/hook", {"size_px": [400, 400], "downscale": 1}),  # reduced by another program
        ("dnerf/hook", {"background": [0.5, 0.5, 0.5]}),
        ("dnerf/hook", {"data": "altered"}),
        ("plenoptic/sear_steak", {"size_px": [1352, 1014], "test_views_found": 250}),
        ("dnerf/mine", {}),
    ],
)
def test_other_conditions_have_no_name_and_are_told_apart(scene: str, changed: dict) -> None:
    found = protocol_of(scene, HALF | changed)
    assert found.startswith("unnamed-")
    assert found == protocol_of(scene, HALF | changed) != protocol_of(scene, HALF | changed | {"seed": 7})


def test_conditions_are_of_the_images_as_evaluated(tmp_path: Path) -> None:
    """The size after the downscale and the schedule's, and the background that the images have."""
    write_folder(tmp_path / "s")
    order = Command(("scene=dnerf", f"scene.path={tmp_path / 's'}", "train.resolution_scale=0.5", "scene.downscale=1"))
    data = prepare(order.config(), lambda line: None)
    found = conditions(for_scene(order, data), data.scene)
    side = data.scene.test[0].camera.width
    assert found == {
        "downscale": 1, "resolution_scale": 0.5, "size_px": [side // 2, side // 2],
        "background": list(data.scene.background), "test_views_found": len(data.scene.test),
    }  # fmt: skip


def test_only_a_decisive_setting_makes_another_condition() -> None:
    scene, cfg = tiny_scene(), tiny_config()
    other = replace(cfg, scene=replace(cfg.scene, near=0.1, cache="elsewhere"))
    assert conditions(cfg, scene) == conditions(other, scene)
    assert conditions(cfg, scene) != conditions(replace(cfg, scene=replace(cfg.scene, test_every=3)), scene)


def test_every_scene_of_the_paper_has_a_protocol_of_ours() -> None:
    for scene in (*DNERF, *PLENOPTIC):
        assert any(one.covers(scene) for one in protocols().values() if not one.literature)


def test_every_printed_row_says_its_protocol() -> None:
    for name in ("table1_plenoptic", "table1_per_scene", "table2_dnerf", "table3_ablation"):
        assert all(protocols()[row["protocol"]].literature for row in read(name)), name


def test_numbers_of_two_protocols_are_refused_in_one_line() -> None:
    assert one_protocol(["a-v1", "a-v1"], "PSNR") == "a-v1"
    with pytest.raises(MixedProtocols, match=r"^PSNR: expected rows of one protocol, found a-v1 and b-v1, [^\n]*$"):
        one_protocol(["a-v1", "b-v1"], "PSNR")


@pytest.mark.parametrize(
    "text, message",
    [
        ("title: A\nscenes: {}\nimages: b\npnsr: image\n", "expected the keys .*, found pnsr"),
        ("title: A\nscenes: {}\n", "expected a value of images, found none"),
    ],
)
def test_a_wrong_file_is_named(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "toy-v1.yaml").write_text(text)
    with pytest.raises(ValueError, match=rf"toy-v1.yaml: {message}"):
        protocol._read(tmp_path / "toy-v1.yaml")


def test_the_page_has_every_protocol_and_the_hashes_of_lpips() -> None:
    page = (PAPER_DIR.parents[1] / "docs/protocols.md").read_text()
    for one in protocols().values():
        (row,) = [line for line in page.splitlines() if line.startswith(f"| `{one.id}`")]
        assert one.title in row
    assert all(file[1] in page for files in _FILES.values() for file in files)


def test_the_mean_of_channel_psnrs_is_that_of_three_images_and_never_lower() -> None:
    """By Jensen's inequality, as -log is convex; equal where all channels have one error."""
    rng = np.random.default_rng(0)
    truth = rng.uniform(size=(9, 7, 3)).astype(np.float32)
    noise = rng.normal(size=truth.shape).astype(np.float32)
    image = truth + noise * np.float32([0.01, 0.03, 0.1])
    expected = [-10 * np.log10(np.mean((image[..., c].astype(float) - truth[..., c]) ** 2)) for c in range(3)]
    assert channels_psnr(image, truth) == pytest.approx(np.mean(expected), rel=1e-12)  # rounding of float64
    assert channels_psnr(image, truth) > psnr(image, truth) + 1
    assert channels_psnr(truth + 0.125, truth) == pytest.approx(psnr(truth + 0.125, truth), abs=1e-5)  # of float32 sums
