"""The table in the layout of Table 3: rows, columns and averages, against hand computation."""

from __future__ import annotations

from pathlib import Path

from report_runs import write_run

from pipeline.presentation.table import Table
from pipeline.report.runs import collect
from pipeline.report.tables import GRIDS

COLUMNS = ("wheel_psnr", "wheel_ssim", "lamp_psnr", "lamp_ssim", "mean_psnr", "mean_ssim")


def grid(root: Path) -> Table | None:
    return GRIDS[0].build(collect(root))


def texts(table: Table) -> list[list[str]]:
    return [[row.cells[key].text for key in ("model", *COLUMNS)] for row in table.rows]


def write(root: Path, scene: str, model: str, *psnrs: float, **more) -> None:
    for seed, psnr in enumerate(psnrs):
        write_run(root, f"synthetic/{scene}", model, seed=seed, psnr=psnr, **more)


def test_rows_and_columns_are_those_of_table_3(tmp_path: Path) -> None:
    """An average needs every scene; the mean of a scene is over its seeds, that of scenes over the scenes."""
    for scene, full in (("wheel", 30.0), ("lamp", 27.0)):
        write(tmp_path, scene, "full", full, full + 1)
        write(tmp_path, scene, "no_4drot", full - 2)
        write(tmp_path, scene, "no_error_guided", full - 3)  # ours: not of Table 3
    write(tmp_path, "lamp", "no_4dsh", 25.0)
    write(tmp_path, "wheel", "no_time_split", 29.0)
    write(tmp_path, "still", "full", 40.0)  # without an ablation
    table = grid(tmp_path)
    assert table is not None
    half = 12.706205 * 0.5  # of the t-interval of two seeds one apart
    assert texts(table) == [
        ["no_4drot", "28.00", "0.9000", "25.00", "0.9000", "26.50", "0.9000"],
        ["no_4dsh", "", "", "25.00", "0.9000", "", ""],
        ["no_time_split", "29.00", "0.9000", "", "", "", ""],
        [
            "full",
            f"30.50 ± {half:.2f}",
            "0.9000 ± 0.0000",
            f"27.50 ± {half:.2f}",
            "0.9000 ± 0.0000",
            f"29.00 ± {half:.2f}",
            "0.9000 ± 0.0000",
        ],
    ]
    assert [column.key for column in table.columns if column.key.endswith(("psnr", "ssim"))] == [*COLUMNS]


def test_a_scene_with_one_ablation_has_no_such_table(tmp_path: Path) -> None:
    write(tmp_path, "wheel", "full", 30.0)
    write(tmp_path, "wheel", "no_4drot", 28.0)
    assert grid(tmp_path) is None
