"""Only the paper's scenes, evaluated on its split, enter the paper's tables; others have tables of their own."""

from __future__ import annotations

import pytest
from report_runs import write_run

from pipeline.report.__main__ import main
from pipeline.report.read import scenes
from pipeline.report.tables.paper_tables import paper_tables
from pipeline.report.tables.scene_tables import scene_tables
from pipeline.runs.read.collect import collect
from pipeline.runs.read.variants import name_variants


@pytest.mark.parametrize(
    "scene, family",
    [
        ("dnerf/lego", "dnerf"),
        ("dnerf/mine", "dnerf_own"),
        ("dnerf", "dnerf_own"),
        ("plenoptic/flame_steak", "plenoptic"),
        ("plenoptic/mine", "plenoptic_own"),
        ("video/mine", "video_own"),
        ("synthetic/wheel", "synthetic"),
        ("mine", "other"),
        ("other/lego", "other"),
    ],
)
def test_family_of_a_scene(scene: str, family: str) -> None:
    assert scenes.family(scene) == family


def test_one_table_per_family(tmp_path) -> None:
    for scene in ("dnerf/mine", "dnerf/hook", "plenoptic/mine", "video/mine", "anything"):
        write_run(tmp_path, scene)
    found = {table.slug: [row.cells["scene"].text for row in table.rows] for table in scene_tables(collect(tmp_path))}
    assert found == {
        "scenes_dnerf": ["dnerf/hook"],
        "scenes_dnerf_own": ["dnerf/mine"],
        "scenes_plenoptic_own": ["plenoptic/mine"],
        "scenes_video_own": ["video/mine"],
        "scenes_other": ["anything"],
    }


def test_lego_on_its_test_split_is_not_in_table_2(tmp_path, capsys) -> None:
    write_run(tmp_path / "runs", "dnerf/lego", psnr=20.0, scene_settings="  test_split: test\n")
    main([str(tmp_path / "runs")])
    out = capsys.readouterr().out
    assert "Table 2" not in out and "dnerf/lego, fast: evaluated on `test`" in out
    write_run(tmp_path / "runs", "dnerf/hook", psnr=30.0, scene_settings="  test_split: test\n")  # as in the paper
    (table,) = paper_tables(name_variants(collect(tmp_path / "runs")))
    final = next(row for row in table.rows if row.kind == "ours")
    assert (final.cells["scenes"].text, final.cells["psnr"].text) == ("mean of 1 of 8", "30.00")
    assert any(note.startswith("Not in this table: dnerf/lego") for _, note in table.notes)


@pytest.mark.parametrize("settings", ["  test_split: val\n", ""])  # "": older runs do not record it
def test_lego_on_val_is_in_table_2(tmp_path, settings: str) -> None:
    write_run(tmp_path, "dnerf/lego", scene_settings=settings)
    assert len(paper_tables(collect(tmp_path))) == 1


def test_runs_on_validation_views_are_not_in_the_papers_tables(tmp_path) -> None:
    write_run(tmp_path, "dnerf/hook", psnr=30.0)
    write_run(tmp_path, "dnerf/hook", psnr=35.0, out="validated", scene_settings="  validation_every: 5\n")
    write_run(tmp_path, "plenoptic/flame_salmon", scene_settings="  validation_every: 5\n")
    collection = name_variants(collect(tmp_path))
    (table,) = paper_tables(collection)  # Table 1 has no run
    assert [row.cells["psnr"].text for row in table.rows if row.kind == "ours"] == ["30.00", "30.25"]
    assert any(
        "Not in this table: dnerf/hook, fast (scene.validation_every=5): evaluated on training views" in note
        for _, note in table.notes
    )
    # Named also without an override, as where an experiment file sets it, so that the two are not averaged.
    assert sorted(collection.runs["train"]) == ["fast", *["fast (scene.validation_every=5)"] * 2]


def test_runs_on_two_test_splits_have_different_names(tmp_path) -> None:
    for split in ("val", "test"):
        write_run(tmp_path, "dnerf/lego", out=split, scene_settings=f"  test_split: {split}\n")
    assert len(set(name_variants(collect(tmp_path)).runs["train"])) == 2
