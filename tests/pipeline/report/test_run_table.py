"""Tables of runs: means, differences and verdicts against hand computation; a new metric and a new table."""

from __future__ import annotations

import csv
import math
import statistics
from pathlib import Path

import pytest
from report_runs import write_run

from pipeline.evaluation.metrics import METRICS, Metric
from pipeline.evaluation.protocol import MixedProtocols
from pipeline.presentation.table import Row, Table
from pipeline.presentation.table_files import markdown
from pipeline.report import scenes, tables
from pipeline.report.__main__ import main
from pipeline.report.build import content_of
from pipeline.report.run_table import RunTable, Shown, fewest_changes
from pipeline.report.runs import collect

JITTER = "fast (train.marginal_jitter=1)"
DIFFERENCE, VERDICT = "final.psnr.difference", "final.psnr.verdict"
T1, T2 = 12.706205, 4.302653  # the 97.5 % quantiles of Student's t with 1 and 2 degrees of freedom


def texts(table: Table, *keys: str) -> list[tuple[str, ...]]:
    return [tuple(table.cell(row, column_of(table, key)).text for key in keys) for row in table.rows]


def column_of(table: Table, key: str):
    return next(column for column in table.columns if column.key == key)


def scene_table(root: Path, family: str) -> Table:
    return next(spec for spec in tables.SCENES if spec.slug == f"scenes_{family}").build(collect(root))


def write_seeds(root: Path, psnrs: list[float], scene: str = "synthetic/wheel", model: str = "full", **more) -> None:
    out = more.pop("out", "runs")
    for seed, psnr in enumerate(psnrs):
        write_run(root, scene, model, seed=seed, psnr=psnr, out=f"{out}/{scene}/{model}/{seed}", **more)


# --- a new metric, a new table --------------------------------------------------------------------


def test_a_new_metric_is_a_column_of_the_report(tmp_path: Path, monkeypatch) -> None:
    """One entry of METRICS: title, unit, direction, decimals and definition are in every table of scenes and runs."""
    shade = Metric("shade", "Shade", "%", 1, "lower", scale=100.0, measure=lambda view: 0.0, note="Shade: how dark.")
    monkeypatch.setitem(METRICS, "shade", shade)
    for seed, value in enumerate((0.1, 0.3)):
        write_run(tmp_path, "synthetic/wheel", seed=seed, **{"final.shade": value})
    for table in (scene_table(tmp_path, "synthetic"), tables.RAW[0].build(collect(tmp_path))):
        assert column_of(table, "final.shade").header == "Shade, % ↓"
        assert ("", "Shade: how dark.") in table.notes
    assert texts(scene_table(tmp_path, "synthetic"), "final.shade") == [("20.0 ± 127.1",)]


def test_a_new_table_is_one_entry_of_the_list(tmp_path: Path, monkeypatch) -> None:
    toy = RunTable(
        "toy",
        "Costs of recipes",
        ("recipe_label",),
        columns=lambda: (Shown("train_seconds"),),
        section="scenes",
        notes=("A toy.",),
    )
    monkeypatch.setattr(tables, "TABLES", (*tables.TABLES, toy))
    for recipe, seconds in (("fast", 10.0), ("paper", 90.0)):
        write_run(tmp_path / "runs", "synthetic/wheel", recipe=recipe, train_seconds=seconds)
    assert main([str(tmp_path / "runs")]) == 0
    with (tmp_path / "report/tables/toy.csv").open() as file:
        rows = [(row["recipe_label"], float(row["train_seconds"])) for row in csv.DictReader(file)]
    assert rows == [("fast", 10.0), ("paper", 90.0)]
    page, text = ((tmp_path / "report" / name).read_text() for name in ("report.html", "report.md"))
    assert "Costs of recipes" in page and "### Costs of recipes" in text and "- A toy." in text


# --- means ----------------------------------------------------------------------------------------


def test_a_row_has_the_mean_over_its_seeds_and_its_interval(tmp_path: Path) -> None:
    write_seeds(tmp_path, [24.0, 25.0, 27.0])
    (cell,) = [row.cells["final.psnr"] for row in scene_table(tmp_path, "synthetic").rows]
    assert cell.value == pytest.approx(76 / 3) and cell.error == pytest.approx(
        T2 * statistics.stdev([24.0, 25.0, 27.0]) / math.sqrt(3)
    )


def test_mean_over_scenes_is_a_mean_of_scene_means(tmp_path: Path) -> None:
    write_seeds(tmp_path, [25.0, 26.0], "dnerf/lego")
    write_seeds(tmp_path, [30.0, 32.0, 34.0], "dnerf/hook")  # a third seed must not change the scene's weight
    found = Shown("psnr").estimate(collect(tmp_path).runs)
    assert found.mean == pytest.approx((25.5 + 32.0) / 2)
    assert found.std == pytest.approx(statistics.stdev([27.5, 29.0]))  # seeds 0 and 1, which both scenes have


def test_a_number_that_a_seed_lacks_has_no_mean(tmp_path: Path) -> None:
    for seed, flicker in enumerate((0.01, None)):
        write_run(tmp_path, "synthetic/wheel", seed=seed, **{"final.flicker": flicker})
    write_run(tmp_path, "synthetic/lamp", **{"final.flicker": 0.02})
    table = scene_table(tmp_path, "synthetic")
    assert texts(table, "scene_label", "final.flicker") == [
        ("synthetic/wheel", "not measured"),
        ("synthetic/lamp", "5.10"),
    ]


def test_only_what_runs_have_numbers_of_is_a_column(tmp_path: Path) -> None:
    """Image quality always: a note says why LPIPS is missing."""
    write_run(tmp_path, "synthetic/wheel", **{"final.psnr_moving": 15.5, "final.flow_error_px": 2.0})
    write_run(tmp_path, "synthetic/lamp")
    table = scene_table(tmp_path, "synthetic")
    keys = {column.key for column in table.columns}
    assert {"final.psnr_moving", "final.flow_error_px", "final.lpips_vgg"} <= keys
    assert not {"final.psnr_still", "final.flicker", "final.lidar_rmse", "final.ms_ssim"} & keys
    text = markdown(table)
    assert "PSNR, dynamic region, dB ↑" in text and "Dynamic region: pixels of moving bodies" in text
    assert "LPIPS: no weights: offline" in text and "LiDAR" not in text


# --- protocols ------------------------------------------------------------------------------------


def test_rows_of_two_protocols_are_neither_averaged_nor_compared(tmp_path: Path) -> None:
    """The same command on images over white: rows of their own, without the other rows as their baseline."""
    write_seeds(tmp_path, [30.0, 31.0, 32.0], "dnerf/hook")
    write_seeds(tmp_path, [25.0, 26.0, 27.0], "dnerf/hook", model="no_4drot")
    white = {"protocol": "dnerf-400-white-v1", "out": "white"}
    write_seeds(tmp_path, [35.0, 36.0, 37.0], "dnerf/hook", model="no_4drot", **white)
    write_seeds(tmp_path, [40.0], "dnerf/trex", **white)
    table = scene_table(tmp_path, "dnerf")
    assert texts(table, "scene_label", "protocol", "model", "seeds", DIFFERENCE) == [
        ("dnerf/hook", "dnerf-400-black-v1", "full", "3", "·"),
        ("dnerf/hook", "dnerf-400-black-v1", "no_4drot", "3", "-5.00 ± 0.00"),
        ("dnerf/hook", "dnerf-400-white-v1", "no_4drot", "3", "·"),
        ("dnerf/trex", "dnerf-400-white-v1", "full", "1", "·"),
    ]
    notes = [note for _, note in table.notes]
    assert "Rows of 2 protocols: none are averaged, compared or ranked across them." in notes
    assert any(note.startswith("dnerf-400-white-v1: D-NeRF, 400 × 400, over white;") for note in notes)
    runs = collect(tmp_path).runs
    with pytest.raises(MixedProtocols, match="expected rows of one protocol, found dnerf-400-black-v1 and dnerf-400-w"):
        Shown("psnr").estimate(runs)
    table2 = tables.PAPER[2].build(collect(tmp_path))
    ours = [(row.cells["protocol"].text, row.cells["scenes"].text) for row in table2.rows if row.kind == "ours"]
    assert ours[::2] == [("dnerf-400-black-v1", "mean of 1 of 8"), ("dnerf-400-white-v1", "mean of 1 of 8")]


def test_one_protocol_stands_over_the_table(tmp_path: Path) -> None:
    write_run(tmp_path, "dnerf/hook")
    assert "Protocol: dnerf-400-black-v1" in markdown(scene_table(tmp_path, "dnerf")).splitlines()[2]


def test_a_run_without_a_protocol_is_a_row_of_its_own(tmp_path: Path) -> None:
    """metrics.json of a commit before protocols."""
    write_run(tmp_path, "dnerf/hook")
    write_run(tmp_path, "dnerf/hook", out="old", protocol=None)
    assert texts(scene_table(tmp_path, "dnerf"), "protocol") == [("unrecorded",), ("dnerf-400-black-v1",)]


# --- differences ----------------------------------------------------------------------------------


def test_an_ablation_is_compared_with_the_full_model_over_common_seeds(tmp_path: Path) -> None:
    write_seeds(tmp_path, [30.0, 31.0, 32.0, 50.0])
    write_seeds(tmp_path, [25.0, 25.0, 28.0], model="no_4drot")
    full, ablated = scene_table(tmp_path, "synthetic").rows
    cell = ablated.cells[DIFFERENCE]
    # Pairs differ by -5, -6 and -4, with a standard deviation of 1.
    assert (cell.value, cell.error) == (pytest.approx(-5.0), pytest.approx(T2 / math.sqrt(3)))
    assert (ablated.cells[VERDICT].text, full.cells[VERDICT].text) == ("worse", "·")


def test_the_baseline_has_the_same_recipe_and_changes(tmp_path: Path) -> None:
    write_seeds(tmp_path, [30.0], out="a")
    write_seeds(tmp_path, [20.0], out="b", changes={"train.batch": 4})
    write_seeds(tmp_path, [19.0], out="b", changes={"train.batch": 4}, model="no_4drot")
    write_seeds(tmp_path, [18.0], out="c", changes={"train.batch": 2}, model="no_4drot")
    table = scene_table(tmp_path, "synthetic")
    found = dict(zip(texts(table, "recipe_label", "model"), texts(table, DIFFERENCE, VERDICT)))
    assert found[("fast (train.batch=4)", "no_4drot")] == ("-1.00", "too few (1 of 3)")
    assert found[("fast (train.batch=2)", "no_4drot")] == ("·", "no run of full")


def test_what_validation_decided_is_no_part_of_a_label(tmp_path: Path) -> None:
    write_seeds(tmp_path, [30.0, 31.0, 32.0], decided={"fourier_order": 0})
    write_seeds(tmp_path, [30.0, 31.0, 32.0], model="no_4drot")
    (full, ablated) = scene_table(tmp_path, "synthetic").rows
    assert full.cells["model"].text == "full" and ablated.cells[VERDICT].text == "no difference shown"
    assert texts(tables.RAW[0].build(collect(tmp_path)), "validation")[0] == ("fourier_order=0",)


def test_ablations_are_shown_on_the_scenes_made_for_them(tmp_path: Path) -> None:
    for scene, models in (
        ("wheel", ("full", "no_4drot", "no_4dsh")),
        ("lamp", ("full", "no_4dsh")),
        ("burst", ("full",)),
    ):
        for model in models:
            worse = 5.0 if (scene, model) == ("wheel", "no_4drot") else 0.0
            off = [0.0, 0.0, 0.0] if model == "full" else [-0.1, 0.0, 0.1]
            write_seeds(tmp_path, [30 - worse + of_seed for of_seed in off], f"synthetic/{scene}", model)
    write_seeds(tmp_path, [30.0], out="other", changes={"train.batch": 4})  # has no ablation
    collection = collect(tmp_path)
    table = tables.ABLATIONS.build(collection)
    assert texts(table, "scene_label", "model", VERDICT, "best_on_test.psnr.verdict") == [
        ("synthetic/wheel", "full", "·", "·"),
        ("synthetic/wheel", "no_4drot", "worse", "worse"),
        ("synthetic/lamp", "full", "·", "·"),
        ("synthetic/lamp", "no_4dsh", "no difference shown", "no difference shown"),
    ]
    verdicts = content_of(collection).verdicts
    assert [(v["model"], v["scene"], v["word"], v["difference"]) for v in verdicts] == [
        ("no_4drot", "synthetic/wheel", "worse", "-5.00 ± 0.25"),
        ("no_4dsh", "synthetic/lamp", "no difference shown", "+0.00 ± 0.25"),
    ]


def test_without_an_ablation_there_are_no_verdicts(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel")
    write_run(tmp_path, "synthetic/lamp", "no_4dsh")
    assert tables.ABLATIONS.build(collect(tmp_path)) is None


# --- changed settings -----------------------------------------------------------------------------


def changed(root: Path) -> dict[tuple[str, str], Row]:
    table = tables.COMPARE.build(collect(root))
    return dict(zip(texts(table, "scene_label", "recipe_label"), table.rows))


def test_changes_are_compared_per_scene_and_over_scenes(tmp_path: Path) -> None:
    write_seeds(tmp_path, [20.0, 22.0, 24.0], "synthetic/wheel")
    write_seeds(tmp_path, [30.0, 30.0], "synthetic/lamp")
    for scene, psnr in (("synthetic/wheel", 23.0), ("synthetic/lamp", 31.0)):
        write_seeds(tmp_path, [psnr, psnr], scene, out="jitter", changes={"train.marginal_jitter": 1})
    rows = changed(tmp_path)
    wheel, mean = rows["synthetic/wheel", JITTER], rows["mean of 2", JITTER]
    # Seeds 0 and 1 differ by 3 and 1, the scenes by 2 and 1: t(1) / √2 × their standard deviations √2 and 1/√2.
    assert (wheel.cells[DIFFERENCE].value, wheel.cells[DIFFERENCE].error) == (pytest.approx(2.0), pytest.approx(T1))
    assert (mean.cells[DIFFERENCE].value, mean.cells[DIFFERENCE].error) == (pytest.approx(1.5), pytest.approx(T1 / 2))
    assert list(rows)[0] == ("synthetic/wheel", "fast") and len(rows) == 5


def test_changes_of_the_scene_are_not_changes_of_the_recipe(tmp_path: Path) -> None:
    small = {"scene.downscale": 4}
    write_seeds(tmp_path, [20.0], "dnerf/lego", out="a")
    write_seeds(tmp_path, [30.0], "dnerf/lego", out="b", changes=small)
    write_seeds(tmp_path, [31.0], "dnerf/lego", out="c", changes=small | {"train.batch": 2})
    rows = changed(tmp_path)
    scene = "dnerf/lego (scene.downscale=4)"
    assert set(rows) == {(scene, "fast"), (scene, "fast (train.batch=2)")}
    assert rows[scene, "fast (train.batch=2)"].cells[DIFFERENCE].text == "+1.00"


def test_a_named_recipe_is_compared_with_the_one_of_the_fewest_changes(tmp_path: Path) -> None:
    """As of an experiment whose every run has a change in common; a recipe of another kind is not compared."""
    common, jitter = {"train.eval_every": 600}, {"train.marginal_jitter": 0}
    write_seeds(tmp_path, [30.0], out="short", recipe="short", changes=common)
    write_seeds(tmp_path, [29.0], out="no_jitter", recipe="no_jitter", changes=common | jitter)
    write_seeds(tmp_path, [28.0], out="both", recipe="both", changes=common | jitter | {"train.batch": 1})
    write_seeds(tmp_path, [20.0], out="paper", recipe="paper", changes={"train.iterations": 100})
    found = {recipe: row.cells[DIFFERENCE].text for (_, recipe), row in changed(tmp_path).items()}
    assert found == {
        "short (train.eval_every=600)": "·",
        "no_jitter (train.eval_every=600, train.marginal_jitter=0)": "-1.00",
        "both (train.batch=1, train.eval_every=600, train.marginal_jitter=0)": "-2.00",
    }


def test_of_two_recipes_the_own_is_the_baseline(tmp_path: Path) -> None:
    for recipe, psnr in (("fast", 30.0), ("paper", 20.0)):
        write_seeds(tmp_path, [psnr], out=recipe, recipe=recipe)
        write_seeds(tmp_path, [psnr + 1], out=f"{recipe}4", recipe=recipe, changes={"train.batch": 4})
    write_seeds(tmp_path, [25.0], out="named", recipe="named", changes={"train.batch": 4})  # of which is unknown
    found = {recipe: row.cells[DIFFERENCE].text for (_, recipe), row in changed(tmp_path).items()}
    assert found == {"fast": "·", "paper": "·", "fast (train.batch=4)": "+1.00", "paper (train.batch=4)": "+1.00"}


def test_lower_is_better_for_some(tmp_path: Path) -> None:
    """Flicker by optimiser: the difference is in levels of 255, and one that is lower is better."""
    table = RunTable(
        "flicker",
        "Flicker",
        ("scene_label", "protocol", "model", "recipe_label"),
        against=fewest_changes,
        differences=lambda: (Shown("flicker"),),
    )
    for seed, off in enumerate((-0.001, 0.0, 0.001)):
        for name, flicker in (("pairs", 0.01), ("times", 0.008), ("views", 0.014)):
            changes = {} if name == "pairs" else {"train.optimiser": name}
            values = {"final.flicker": flicker + (0.1 * off if changes else 0.0)}
            write_run(tmp_path, "synthetic/counter", seed=seed, out=f"{name}{seed}", changes=changes, **values)
    found = table.build(collect(tmp_path))
    error = T2 * 0.0255 / math.sqrt(3)
    assert texts(found, "final.flicker.difference", "final.flicker.verdict")[1:] == [
        (f"-0.51 ± {error:.2f}", "better"),
        (f"+1.02 ± {error:.2f}", "worse"),
    ]


def test_without_an_unchanged_run_nothing_is_compared(tmp_path: Path) -> None:
    for batch in (2, 4):
        write_seeds(tmp_path, [20.0], out=f"batch{batch}", changes={"train.batch": batch})
    assert tables.COMPARE.build(collect(tmp_path)) is None


# --- families -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "scene, capture, family",
    [
        ("dnerf/lego", "monocular", "dnerf"),
        ("dnerf/mine", "monocular", "monocular"),
        ("dnerf", "static", "static"),
        ("plenoptic/flame_steak", "multi_view", "plenoptic"),
        ("plenoptic/mine", "multi_view", "multi_view"),
        ("video/mine", "clip", "clip"),
        ("synthetic/street", "drive", "synthetic"),
        ("kitti/04", "drive", "drive"),
    ],
)
def test_family_of_a_scene(scene: str, capture: str, family: str) -> None:
    assert scenes.family(scene, capture) == family


def test_one_table_per_family(tmp_path: Path) -> None:
    for scene, capture in (("dnerf/mine", "monocular"), ("dnerf/hook", "monocular"), ("kitti/04", "drive")):
        write_run(tmp_path, scene, capture=capture, test_split="every 4th frame" if capture == "drive" else None)
    found = {table.slug: table for spec in tables.SCENES if (table := spec.build(collect(tmp_path)))}
    assert {slug: texts(table, "scene_label") for slug, table in found.items()} == {
        "scenes_dnerf": [("dnerf/hook",)],
        "scenes_monocular": [("dnerf/mine",)],
        "scenes_drive": [("kitti/04",)],
    }
    assert ("", "kitti/04: held out every 4th frame.") in found["scenes_drive"].notes


# --- runs of a GPU ---------------------------------------------------------------------------------


def test_times_of_a_gpu_are_marked_and_averaged_with_none_of_a_cpu(tmp_path: Path) -> None:
    by = {"backend": "gsplat", "engine": "gsplat 1.5.3, CUDA 13.0", "device": "NVIDIA H200", "driver": "580"}
    for seed in (0, 1):
        write_run(tmp_path, "synthetic/wheel", seed=seed, **{"final.fps_render": 10.0})
        gpu = {"rendered_by": by, "final.fps_render": 900.0, "train_seconds": 5.0}
        write_run(tmp_path, "synthetic/wheel", seed=seed, changes={"backend": "gsplat"}, out=f"runs/gpu/{seed}", **gpu)
    table = scene_table(tmp_path, "synthetic")
    cells = texts(table, "recipe_label", "final.fps_render", "train_seconds", "final.psnr")
    (_, cpu_fps, cpu_seconds, _), (label, fps, seconds, psnr) = cells
    assert label == "fast (backend=gsplat)" and fps == "900.0 ± 0.0 †" and seconds == "5.0 ± 0.0 †"
    assert cpu_fps == "10.0 ± 0.0" and "†" not in cpu_seconds + psnr
    notes = [note for _, note in table.notes if "†" in note]
    assert len(notes) == 1 and "NVIDIA H200, gsplat 1.5.3, CUDA 13.0" in notes[0] and "not bit-identical" in notes[0]


def test_without_a_run_of_a_gpu_nothing_is_marked(tmp_path: Path) -> None:
    write_run(tmp_path, "synthetic/wheel")
    assert "†" not in markdown(scene_table(tmp_path, "synthetic"))
