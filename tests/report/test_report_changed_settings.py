"""Effect of changed settings: differences, standard errors and ratios against hand computation."""

from __future__ import annotations

import math

import pandas as pd
import pytest

from pipeline.presentation.table_files import comma_separated, markdown
from pipeline.report.tables.changed_settings import changed_settings
from pipeline.runs.read.collect import Collection


def rows(train: str, scene: str, psnrs: list[float], seconds: float = 10.0, moving: float = math.nan) -> list[dict]:
    """moving: what moving pixels have more than all."""
    return [
        {
            "scene": scene,
            "test_split": "",
            "ablation": "full",
            "train": train,
            "seed": seed,
            "final.psnr": psnr,
            "final.ssim": psnr / 100,
            "final.psnr_moving": psnr + moving,
            "final.psnr_foreground": math.nan,
            "model_mb": 1.0,
            "train_seconds": seconds,
            "n_gaussians": 100.0,
            "final.fps_render": 50.0,
        }
        for seed, psnr in enumerate(psnrs)
    ]


def collection(*parts: list[dict]) -> Collection:
    return Collection(pd.DataFrame(sum(parts, [])), pd.DataFrame(), {}, (), ())


def test_change_is_compared_per_scene_over_common_seeds() -> None:
    (table,) = changed_settings(
        collection(
            rows("fast", "synthetic/wheel", [20.0, 22.0, 24.0]),
            rows("fast", "synthetic/lamp", [30.0, 30.0]),
            rows("fast (dropout=0.1)", "synthetic/wheel", [23.0, 23.0], seconds=20.0),
            rows("fast (dropout=0.1)", "synthetic/lamp", [31.0, 31.0], seconds=5.0),
            rows("fast (batch=2)", "synthetic/wheel", [20.0, 22.0, 24.0]),
        )
    )
    first, second = table.rows
    assert first.cells["change"].text == "dropout=0.1"  # the best mean first
    wheel, mean = first.cells["synthetic/wheel"], first.cells["mean"]
    # Seeds 0 and 1: 23 against 21 ± √2, whose standard error is √2/√2.
    assert (wheel.value, wheel.std) == (pytest.approx(2.0), pytest.approx(1.0))
    assert (mean.value, mean.std) == (pytest.approx(1.5), pytest.approx(0.5))
    assert (first.cells["ssim"].value, first.cells["ssim"].std) == (pytest.approx(0.015), pytest.approx(0.005))
    assert first.cells["train_seconds"].value == pytest.approx(math.sqrt(2.0 * 0.5))  # geometric
    assert second.cells["mean"].value == 0.0 and second.cells["synthetic/lamp"].text == ""
    assert "+2.00 ± 1.00" in markdown(table)


def test_no_table_for_a_single_variant() -> None:
    assert (
        changed_settings(
            collection(rows("fast", "synthetic/wheel", [20.0]), rows("fast (batch=2)", "synthetic/wheel", [20.0]))
        )
        == []
    )


def test_no_table_without_the_unchanged_schedule() -> None:
    assert (
        changed_settings(
            collection(
                rows("fast (batch=4)", "synthetic/wheel", [20.0]), rows("fast (batch=2)", "synthetic/wheel", [20.0])
            )
        )
        == []
    )


def test_one_seed_has_no_standard_error() -> None:
    (table,) = changed_settings(
        collection(
            rows("fast", "synthetic/wheel", [20.0]),
            rows("fast (batch=2)", "synthetic/wheel", [21.0]),
            rows("fast (batch=4)", "synthetic/wheel", [21.5]),
        )
    )
    assert table.rows[0].cells["mean"].text == "+1.50" and table.rows[0].cells["mean"].std is None
    assert "nan" not in comma_separated(table).lower()


def test_changes_of_the_scene_are_not_changes_of_the_schedule() -> None:
    small = "scene.background_model=none, scene.downscale=4, scene.test_cameras=[5, 6]"
    (table,) = changed_settings(
        collection(
            rows("fast", "dnerf/lego", [20.0]),
            rows("fast (batch=2)", "dnerf/lego", [20.5]),
            rows(f"fast ({small})", "dnerf/lego", [30.0]),
            rows(f"fast ({small}, batch=2)", "dnerf/lego", [31.0]),
            rows(f"fast ({small}, batch=4)", "dnerf/lego", [33.0]),
        )
    )
    of_two = {row.cells["change"].text: row.cells for row in table.rows}
    assert set(of_two) == {"batch=2", "batch=4"}
    assert of_two["batch=2"]["dnerf/lego"].value == 0.5
    assert of_two["batch=2"][f"dnerf/lego ({small})"].value == 1.0 and of_two["batch=2"]["mean"].value == 0.75


def test_a_missing_number_is_not_measured_and_the_note_is_of_standard_errors() -> None:
    without = [{**row, "final.fps_render": math.nan} for row in rows("fast (batch=2)", "synthetic/wheel", [20.0, 22.0])]
    (table,) = changed_settings(
        collection(
            rows("fast", "synthetic/wheel", [20.0, 22.0]),
            without,
            rows("fast (dropout=0.1)", "synthetic/wheel", [21.0]),
        )
    )
    text = markdown(table)
    assert "n/a" in text and "standard deviation over seeds" not in text and comma_separated(table)


def test_moving_pixels_are_compared_on_the_scenes_that_have_them() -> None:
    (table,) = changed_settings(
        collection(
            rows("fast", "synthetic/wheel", [20.0, 22.0], moving=-5.0),
            rows("fast", "synthetic/lamp", [30.0, 30.0]),
            rows("fast (dropout=0.1)", "synthetic/wheel", [23.0, 23.0], moving=-7.0),
            rows("fast (dropout=0.1)", "synthetic/lamp", [31.0, 31.0]),
            rows("fast (batch=2)", "synthetic/lamp", [31.0, 31.0]),
        )
    )
    dropout, batch = (
        {row.cells["change"].text: row.cells for row in table.rows}[key] for key in ("dropout=0.1", "batch=2")
    )
    # 23 - 7 against 21 - 5 ± √2 / √2; nothing moves on lamp, and no run knows a foreground
    for key in ("synthetic/wheel_moving", "moving"):
        assert (dropout[key].value, dropout[key].std) == (pytest.approx(0.0), pytest.approx(1.0))
    assert "moving" not in batch
    headers = [column.header for column in table.columns]
    assert "synthetic/wheel moving" in headers and "mean, moving" in headers
    assert not {"synthetic/lamp moving", "mean, foreground"} & set(headers)
