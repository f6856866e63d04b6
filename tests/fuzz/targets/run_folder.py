"""Target pipeline/runs/run_folder.py: the run folder of a resumed run."""

from __future__ import annotations

import tempfile
from pathlib import Path

from hypothesis.strategies import SearchStrategy

from datasets.files.claim import HIDDEN
from fuzz.edits.bytes import changed_files, edit_text
from fuzz.edits.json import edit_json
from fuzz.target import REFUSED, Changes, Files, Target, check_message, read_files, require, valid_or_refused
from pipeline.runs.run_folder import CURVE_COLUMNS, RunFolder

CONFIG = {"seed": 0, "scene": {"name": "toy", "path": "data", "init_box": [-1.2, 1.2]}, "train": {"name": "fast"}}
INPUTS = {"data": "ab12", "config": "cd34", "code": "ef56"}
NEXT = 5  # the iteration it resumes from


def example() -> Files:
    with tempfile.TemporaryDirectory() as temporary:
        with RunFolder(Path(temporary) / "run") as run:
            run.claim(CONFIG)
            for iteration in (2, 4, 6):
                run.log({"event": "train", "iteration": iteration})
                run.append_error_vs_time({"train_seconds": 0.5, "iteration": iteration, "psnr": 20.0})
            run.finish("init", INPUTS, "commit", (), {"n_gaussians": 3})
        files = read_files(Path(temporary) / "run")
    return {name: content for name, content in files.items() if not name.startswith(HIDDEN)}


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {".json": edit_json, ".yaml": edit_text, ".csv": edit_text, ".jsonl": edit_text})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        try:
            with RunFolder(folder) as run:
                run.claim(CONFIG)
        except ValueError as error:
            if "holds another run" not in str(error):
                raise
            check_message(str(error), str(folder), "resume=false")
            return REFUSED
        with RunFolder(folder) as run:
            run.truncate_after(NEXT)
            require(all(isinstance(row, dict) for row in run.log_rows()), "a line of log.jsonl that is no object")
            if run.curve.exists():
                header, *lines = run.curve.read_text().splitlines()
                require(
                    header == ",".join(CURVE_COLUMNS)
                    and all(
                        line.count(",") == header.count(",")
                        and int(line.split(",")[CURVE_COLUMNS.index("iteration")]) <= NEXT
                        for line in lines
                    ),
                    "a curve with other lines",
                )
            require(isinstance(run.values_of("init"), dict), "values of a stage that are no object")
            require(run.state("init", INPUTS)[0] in ("open", "done", "other code"), "a state that no stage has")
    return outcome[0]


TARGET = Target(
    "run_folder", "the folder of a resumed run: config.yaml, stages.json, log.jsonl", example, changes, check
)
