"""Tables name and compare the trained model, which may differ from the requested one."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
from report_runs import write_run

from pipeline.presentation.seed_statistics import verdict
from pipeline.report.__main__ import main
from pipeline.report.compare.curve_figures import curve_figures
from pipeline.report.tables.ablation_verdicts import ablation_verdicts
from pipeline.report.tables.changed_settings import changed_settings
from pipeline.report.tables.equal_time import equal_time
from pipeline.report.tables.paper_tables import paper_tables
from pipeline.report.tables.summary import summarise
from pipeline.runs.read import model_labels as models
from pipeline.runs.read.collect import collect
from pipeline.runs.read.run_files import MOTIONS
from pipeline.runs.read.variants import name_variants
from rasterizer.gaussians import Motion

# Runs from before metrics.json had `model`
LEFT_OUT = {"select_time_colour": {"gain": 0.0, "standard_error": 0.1, "kept": False}}
KEPT = {"select_time_colour": {"gain": 1.0, "standard_error": 0.1, "kept": True}}


def model(motion: str = "full", fourier_order: int = 2, sh_degree: int = 3) -> dict:
    return {"model": {"motion": motion, "fourier_order": fourier_order, "sh_degree": sh_degree}}


def labels(root: Path) -> list[str]:
    return list(name_variants(collect(root)).runs["ablation"])


def test_motions_are_those_of_a_model() -> None:
    """ "velocity" is one of training alone: what has been trained is read as "full"."""
    assert {*MOTIONS, "velocity"} == set(get_args(Motion))


@pytest.mark.parametrize(
    "requested, settings, metrics, label",
    [
        ("full", "", {}, "full"),
        ("full", "", LEFT_OUT, "full, 4DSH left out"),
        ("full", "", KEPT, "full"),
        ("full", "", model(), "full"),
        ("full", "", model(fourier_order=0), "full, 4DSH left out"),
        ("full", "", model(fourier_order=0) | LEFT_OUT, "full, 4DSH left out"),
        ("full", "", model("static", 0), "full"),  # a static scene has no time-varying colour
        ("no_4drot", "  rotation_4d: false\n", model("separable", 0), "no_4drot, 4DSH left out"),
        ("no_4drot", "  rotation_4d: false\n", model("separable"), "no_4drot"),
        ("no_4dsh", "  fourier_order: 0\n", model(fourier_order=0), "no_4dsh"),  # none were requested
        ("no_4dsh", "", model(fourier_order=0), "no_4dsh"),  # a run without its settings
        ("static", "  rotation_4d: false\n  fourier_order: 0\n  static: true\n", model("static", 0), "static"),
        ("full", "  static: null\n", model("static", 0) | {"select_motion": {"dynamic": False}}, "static"),
        ("full", "", model() | {"select_motion": {"dynamic": True}}, "full"),
        # Overrides of `ablation` keys, also if all runs of the name have them.
        ("full", "  fourier_order: 1\n", {}, "full (fourier_order=1)"),
        ("full", "  fourier_order: 1\n", model(fourier_order=1), "full (fourier_order=1)"),
        ("full", "  fourier_order: 1\n", model(fourier_order=0), "full, 4DSH left out"),  # selection removed them
        ("full", "  fourier_order: 0\n", model(fourier_order=0), "full (fourier_order=0)"),  # none were requested
        ("full", "  sh_degree: 1\n", model(fourier_order=0, sh_degree=1), "full, 4DSH left out (sh_degree=1)"),
        ("full", "  fourier_order: 1\n", model("static", 0), "full"),  # without effect in a static scene
        ("full", "  static: true\n", model("static", 0), "full (static=True)"),
        ("mine", "  rotation_4d: false\n", model("separable"), "mine"),  # a name that is not in conf/ablation
        ("mine", "", model(fourier_order=0), "mine"),
        ("mine", "  fourier_order: 2\n", model(fourier_order=0), "mine, 4DSH left out"),
    ],
)
def test_label_of_the_trained_model(tmp_path, requested: str, settings: str, metrics: dict, label: str) -> None:
    for seed in range(2):
        write_run(tmp_path, "synthetic/wheel", requested, seed=seed, ablation_settings=settings, **metrics)
    assert labels(tmp_path) == [label] * 2


def test_selection_may_differ_between_seeds(tmp_path) -> None:
    write_run(tmp_path, "synthetic/lamp", seed=0, psnr=30.0, **KEPT)
    write_run(tmp_path, "synthetic/lamp", seed=1, psnr=20.0, **LEFT_OUT)
    collection = name_variants(collect(tmp_path))
    assert list(collection.runs["ablation"]) == ["full", "full, 4DSH left out"]
    assert [(h.model, h.psnr) for h in summarise(collection).headlines] == [
        ("full", "30.00"),
        ("full, 4DSH left out", "20.00"),
    ]
    (figure,) = curve_figures(collection)
    assert (figure.title, [line.label for line in figure.lines]) == (
        "synthetic/lamp: ablation, fast",
        ["full", "full, 4DSH left out"],
    )


@pytest.mark.parametrize(
    "metrics, message",
    [
        ({"model": 3}, "model: expected an object, found 3"),
        (model("moving"), "model.motion: expected static, separable, full, found 'moving'"),
        (
            {"model": {"motion": "full", "fourier_order": "two", "sh_degree": 3}},
            "model.fourier_order: expected a finite",
        ),
    ],
)
def test_run_with_an_invalid_model_is_left_out(tmp_path, metrics: dict, message: str) -> None:
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/wheel", seed=1, **metrics)
    found = collect(tmp_path)
    assert len(found.runs) == 1 and message in found.left_out[0]


# --- comparisons ------------------------------------------------


@pytest.mark.parametrize(
    "label, baseline",
    [
        ("full", None),
        ("full, 4DSH left out", None),
        ("no_4dsh", "full"),
        ("no_4drot", "full"),
        ("no_4drot, 4DSH left out", "full, 4DSH left out"),
        ("full (fourier_order=1)", "full"),
        ("no_4drot (sh_degree=1)", "full (sh_degree=1)"),
        ("no_4drot, 4DSH left out (sh_degree=1)", "full, 4DSH left out (sh_degree=1)"),
    ],
)
def test_baseline_of_a_model(label: str, baseline: str | None) -> None:
    assert models.baseline_of(label) == baseline


def test_ablation_is_not_compared_with_a_full_model_without_4dsh(tmp_path) -> None:
    for seed in range(3):
        write_run(tmp_path, "synthetic/lamp", "full", seed=seed, psnr=30.0 + 0.1 * seed, **LEFT_OUT)
        write_run(tmp_path, "synthetic/lamp", "no_4dsh", seed=seed, psnr=30.0 + 0.1 * seed)
    collection = name_variants(collect(tmp_path))
    assert verdict(collection.runs, "synthetic/lamp", "no_4dsh", "fast", "final.psnr") is None
    assert [row.cells["verdict"].text for row in ablation_verdicts(collection.runs).rows] == ["no run of full"] * 2
    assert summarise(collection).ablations == ()


def test_models_without_4dsh_are_compared_and_labelled(tmp_path, capsys) -> None:
    for seed in range(3):
        for ablation, psnr in (("full", 30.0), ("no_4drot", 25.0)):
            write_run(
                tmp_path / "runs", "synthetic/wheel", ablation, seed=seed, psnr=psnr + 0.1 * seed, images=2, **LEFT_OUT
            )
    main([str(tmp_path / "runs")])
    out, page, text = (
        capsys.readouterr().out,
        *((tmp_path / "report" / name).read_text() for name in ("report.html", "report.md")),
    )
    for document in (out, page, text):
        assert "no_4drot, 4DSH left out" in document and "selection by validation removed it" in document
        # The label is never shortened to the ablation; only commands and paths contain that alone.
        assert not re.search(r"(<b>|\| |<td[^>]*>)(full|no_4drot)( *\||</b>|</td>)", document)
    assert "synthetic/wheel: worse, full, 4DSH left out − ablation = 5.00 dB" in out


# --- schedules, which may select -------------------------------


def write_seeds(root: Path, train: str = "fast", **metrics) -> None:
    for seed in range(2):
        write_run(root, "dnerf/lego", train=train, seed=seed, psnr=30.0 + (train != "fast") + seed, **metrics)


def test_schedules_are_compared_for_one_requested_model(tmp_path) -> None:
    write_seeds(tmp_path, **LEFT_OUT)
    write_seeds(tmp_path, "paper")
    collection = name_variants(collect(tmp_path))
    (figure,) = curve_figures(collection)
    assert [line.label for line in figure.lines] == ["fast, 4DSH left out", "paper"]
    table = equal_time(collection)
    assert [(row.cells["train"].text, row.cells["ablation"].text) for row in table.rows] == [
        ("fast", "full, 4DSH left out"),
        ("paper", "full"),
    ]
    assert models.LEFT_OUT_NOTE in table.notes


def test_schedules_are_compared_on_the_same_images(tmp_path) -> None:
    """Runs at another size are another scene, and what stands beside a value of the curve is of the curve too."""
    for train, size in (("fast", 400), ("paper", 400), ("fast", 200)):
        overrides = ["scene=dnerf/lego", f"train={train}", *([f"scene.size={size}"] if size < 400 else [])]
        write_run(
            tmp_path, "dnerf/lego", train=train, out=f"{train}{size}", overrides=overrides, **{"final.psnr": 99.0}
        )
    table = equal_time(name_variants(collect(tmp_path)))
    assert [row.cells["train"].text for row in table.rows] == ["fast", "paper"]
    assert all(row.cells["final_psnr"].value == row.cells["shared_psnr"].value < 99 for row in table.rows)


def test_changed_settings_name_the_scenes_without_4dsh(tmp_path) -> None:
    write_seeds(tmp_path, **LEFT_OUT)
    write_seeds(tmp_path, "fast (batch=1)")
    write_seeds(tmp_path, "fast (batch=2)", **LEFT_OUT)
    (table,) = changed_settings(name_variants(collect(tmp_path)))
    assert {row.cells["change"].text: row.cells["mean"].value for row in table.rows} == {"batch=1": 1, "batch=2": 1}
    sentence = "from models of: the unchanged schedule (dnerf/lego); batch=2 (dnerf/lego)"
    assert any(sentence in note for _, note in table.notes)


def test_means_of_the_papers_tables_name_the_scenes_without_4dsh(tmp_path) -> None:
    write_run(tmp_path, "dnerf/lego", seed=0, psnr=26.0, **LEFT_OUT)
    write_run(tmp_path, "dnerf/lego", seed=1, psnr=28.0, **KEPT)
    write_run(tmp_path, "dnerf/hook", seed=0, psnr=30.0, **KEPT)
    (table,) = paper_tables(name_variants(collect(tmp_path)))
    final = next(row for row in table.rows if row.kind == "ours")
    assert final.cells["scenes"].text == "mean of 2 of 8" and final.cells["psnr"].value == 28.5
    assert any("from the models of lego (1 of 2 runs)." in note for _, note in table.notes)


def test_table_3_separates_models_without_4dsh(tmp_path) -> None:
    for scene in ("plenoptic/flame_salmon", "plenoptic/cut_roasted_beef"):
        write_run(tmp_path, scene, psnr=29.0, **LEFT_OUT)
        write_run(tmp_path, scene, "no_4dsh", psnr=28.0)
    table = next(t for t in paper_tables(name_variants(collect(tmp_path))) if t.slug == "table3_ablation")
    ours = [(row.cells["ablation"].text, row.cells["mean_psnr"].text) for row in table.rows if row.kind == "ours"]
    assert ours == [
        ("no_4dsh", "28.00"),
        ("no_4dsh", "28.25"),
        ("full, 4DSH left out", "29.00"),
        ("full, 4DSH left out", "29.25"),
    ]
