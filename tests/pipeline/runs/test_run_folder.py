"""The run folder: whole files, growing files that lost their end, and whose run it is."""

from __future__ import annotations

import json
import multiprocessing
from pathlib import Path

import pytest
from shell import FORKING

from datasets.files.atomic_write import atomic_file, write_text
from pipeline.runs.run_folder import CURVE_COLUMNS, RunFolder, write_csv, write_json

CONFIG = {
    "scene": {"name": "auto/a", "path": None, "cache": "a"},
    "train": {"iterations": 60, "batch": 2},
    "seed": 0,
    "threads": 1,
    "out": "x",
    "resume": True,
    "evaluate": {"lpips": True},
}


def changed(**groups: dict | int) -> dict:
    return {
        **CONFIG,
        **{name: {**CONFIG[name], **value} if isinstance(value, dict) else value for name, value in groups.items()},
    }


INPUTS = {"data": "d", "config": "c", "code": "1"}


def opened(path: Path, config: dict = CONFIG, resume: bool = True) -> RunFolder:
    folder = RunFolder(path, resume)
    try:
        folder.claim(config)
    except ValueError:
        folder.__exit__()
        raise
    return folder


def made(path: Path, config: dict = CONFIG) -> None:
    """A run folder whose first stage is done."""
    with opened(path, config) as folder:
        folder.init_ply.write_text("ply")
        folder.finish("init", INPUTS, "commit", ("init.ply",), {"n_gaussians": 3})


def test_replacing_is_all_or_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    write_json(path, {"a": 1})
    with pytest.raises(ZeroDivisionError), atomic_file(path) as temporary:
        temporary.write_text("half of")
        raise ZeroDivisionError
    assert json.loads(path.read_text()) == {"a": 1}
    assert list(tmp_path.iterdir()) == [path]


def test_json_with_nan_is_refused_and_the_old_file_kept(tmp_path: Path) -> None:
    write_json(tmp_path / "a.json", 1)
    with pytest.raises(ValueError):
        write_json(tmp_path / "a.json", float("nan"))
    assert (tmp_path / "a.json").read_text() == "1\n"


def test_csv(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", [{"view": "test/r_0", "psnr": 1.5}, {"view": "a,b", "psnr": None}])
    assert (tmp_path / "a.csv").read_text() == 'view,psnr\ntest/r_0,1.5\n"a,b",\n'


def test_curve_and_log_forget_what_comes_after_the_checkpoint(tmp_path: Path) -> None:
    with opened(tmp_path / "run", CONFIG) as folder:
        folder.log({"event": "start"})
        for iteration in (10, 20, 30):
            folder.log({"event": "train", "iteration": iteration})
            folder.append_error_vs_time(
                {"train_seconds": 0.5, "cpu_seconds": 1.0, "iteration": iteration, "psnr": 20.0}
            )
        folder.truncate_after(20)
        assert [row.get("iteration") for row in folder.log_rows()] == [None, 10, 20]
        assert folder.curve.read_text() == (",".join(CURVE_COLUMNS) + "\n0.5,1.0,10,20.0,,,,\n0.5,1.0,20,20.0,,,,\n")


def test_a_line_cut_short_by_a_kill_is_dropped(tmp_path: Path) -> None:
    with opened(tmp_path / "run", CONFIG) as folder:
        folder.log({"iteration": 1})
        folder.append_error_vs_time({"iteration": 1})
        for path in (folder.log_file, folder.curve):
            path.write_text(path.read_text()[:-3])
        folder.log({"iteration": 2})
        folder.append_error_vs_time({"iteration": 2})
        folder.truncate_after(5)
        assert [row["iteration"] for row in folder.log_rows()] == [2]
        assert folder.curve.read_text().splitlines()[1:] == [",,2,,,,,"]


def test_a_curve_cut_within_its_header(tmp_path: Path) -> None:
    with opened(tmp_path / "run", CONFIG) as folder:
        write_text(folder.curve, "train_sec")
        folder.truncate_after(0)
        assert folder.curve.read_text() == ",".join(CURVE_COLUMNS) + "\n"


def test_stage_records(tmp_path: Path) -> None:
    made(tmp_path / "run")
    with opened(tmp_path / "run") as folder:
        assert folder.values_of("init") == {"n_gaussians": 3} and folder.values_of("train") == {}
        assert folder.state("init", INPUTS) == ("done", "commit") and folder.state("train", INPUTS)[0] == "open"
        assert folder.state("init", {**INPUTS, "code": "2"}) == ("other code", "commit")
        assert folder.state("init", {**INPUTS, "config": "2"})[0] == "open"
        folder.init_ply.unlink()
        assert folder.state("init", INPUTS)[0] == "open"


def test_where_and_how_a_run_is_made_does_not_make_it_another(tmp_path: Path) -> None:
    made(tmp_path / "run")
    with opened(tmp_path / "run", changed(scene={"cache": "b"}, threads=2, out="y", evaluate={"lpips": False})):
        pass


def test_another_run_is_refused_and_what_differs_said(tmp_path: Path) -> None:
    made(tmp_path / "run")
    with pytest.raises(
        ValueError,
        match=r"run: holds another run, with train.batch=2 but this command has 4 "
        r"\(and seed\); give another out=DIR, or resume=false",
    ):
        opened(tmp_path / "run", changed(train={"batch": 4}, seed=1))
    with opened(tmp_path / "run", CONFIG):  # it was let go of, and is as it was
        pass


def test_of_a_renamed_data_folder_the_name_that_continues_is_said(tmp_path: Path) -> None:
    made(tmp_path / "run")
    name = CONFIG["scene"]["name"]
    with pytest.raises(ValueError, match=f"has auto/moved; scene.name={name} continues it; or give another out=DIR"):
        opened(tmp_path / "run", changed(scene={"name": "auto/moved"}))


def test_before_anything_is_made_a_mistake_may_be_corrected(tmp_path: Path) -> None:
    with opened(tmp_path / "run", changed(scene={"path": "typo"})):
        pass
    with opened(tmp_path / "run", changed(scene={"path": "right"})):
        pass


def test_not_resuming_starts_over(tmp_path: Path) -> None:
    made(tmp_path / "run")
    with opened(tmp_path / "run", changed(seed=1), resume=False) as folder:
        assert folder.values_of("init") == {} and not folder.init_ply.exists()


@pytest.mark.parametrize("resume", [True, False])
def test_a_folder_that_is_not_ours_is_left_alone(tmp_path: Path, resume: bool) -> None:
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(ValueError, match="expected a run folder or an empty one, found thesis.tex"):
        opened(tmp_path, CONFIG, resume)
    assert list(tmp_path.iterdir()) == [tmp_path / "thesis.tex"]


def _open(path: Path, answer: multiprocessing.Queue) -> None:
    try:
        opened(path, CONFIG)
        answer.put("opened")
    except ValueError as error:
        answer.put(str(error))


def test_two_processes_do_not_share_one(tmp_path: Path) -> None:
    answer = FORKING.Queue()
    with opened(tmp_path / "run", CONFIG):
        process = FORKING.Process(target=_open, args=(tmp_path / "run", answer))
        process.start()
        assert "found another process at work in it" in answer.get(timeout=60)
        process.join()
