"""The run folder: every file that a run writes, and the record of its finished stages.

    config.yaml  environment.json  stages.json  log.jsonl
    sfm.json  sfm.png  canonical.json  scene.json  init.ply  checkpoint.safetensors  error_vs_time.csv
    metrics.json  per_image.csv  renders/  viewer.html

Whole files are written atomically (datasets/files/atomic_write.py). The two that grow line by line (log.jsonl,
error_vs_time.csv) lose at most an incomplete last line, which is dropped when they are read.
"""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import sys
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from omegaconf import OmegaConf

from datasets.files.atomic_write import disk_errors_named, write_json, write_text
from datasets.files.claim import Claim
from pipeline.runs.run_identity import FILES, UNFINISHED, read_stages, refuse_foreign, refuse_other_run

CURVE_COLUMNS = (
    *("train_seconds", "cpu_seconds", "iteration", "psnr", "ssim"),
    *("test_loss", "n_gaussians", "psnr_moving"),
)


State = Literal["open", "done", "other code"]  # of a stage


def csv_text(header: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """None is an empty cell."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    return text.getvalue()


def config_text(config: dict) -> str:
    """The content of config.yaml."""
    return OmegaConf.to_yaml(OmegaConf.create(config))


def write_csv(path: Path, rows: list[dict]) -> None:
    """One row a dict; the first one names the columns."""
    write_text(path, csv_text(rows[0] if rows else [], (row.values() for row in rows)))


class RunFolder:
    """An open run folder; a context manager that keeps other processes out, of all machines, until it is closed.

    Its attributes are the paths of FILES: `folder.init_ply`. A process that has lost the folder to another gets none.
    """

    def __init__(self, path: Path, resume: bool = True) -> None:
        """Open `path`, making the folder if need be. resume=False first deletes what an earlier run left there.

        ValueError if the folder is not a run folder, Busy if it is in use; then nothing there has changed.
        """
        refuse_foreign(path)
        with disk_errors_named(path):
            path.mkdir(parents=True, exist_ok=True)
            self._claim = Claim(path)
        self._path = path
        for name in UNFINISHED if resume else (*FILES.values(), *UNFINISHED):
            _remove(path / name)

    @property
    def path(self) -> Path:
        self._claim.check()
        return self._path

    def __getattr__(self, name: str) -> Path:
        if name not in FILES:
            raise AttributeError(f"run folder: expected one of {', '.join(FILES)}, found {name}")
        return self.path / FILES[name]

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._claim.release()

    def claim(self, config: dict) -> None:
        """Make the folder that of the run `config`, as plain dicts. ValueError if it holds another run."""
        refuse_other_run(self.path, config)
        self.write_config(config)

    def write_config(self, config: dict) -> None:
        write_text(self.config, config_text(config))

    # What grows while a run goes on.

    def log(self, row: dict) -> None:
        line = json.dumps({"date": now(), **row}) + "\n"
        _append(self.log_file, line)

    def append_error_vs_time(self, row: dict) -> None:
        """Append a row of CURVE_COLUMNS to error_vs_time.csv."""
        header = "" if self.curve.exists() else ",".join(CURVE_COLUMNS) + "\n"
        cells = ("" if row.get(column) is None else str(row[column]) for column in CURVE_COLUMNS)
        _append(self.curve, header + ",".join(cells) + "\n")

    def truncate_after(self, iteration: int) -> None:
        """Forget what was logged after `iteration`: a resumed run does it again."""
        if self.log_file.exists():
            rows = [row for row in self.log_rows() if _iteration_of(row.get("iteration", 0)) <= iteration]
            write_text(self.log_file, "".join(json.dumps(row) + "\n" for row in rows))
        if self.curve.exists():
            _, *lines = self.curve.read_text(errors="replace").splitlines() or [""]
            complete = [line for line in lines if line.count(",") == len(CURVE_COLUMNS) - 1]
            column = CURVE_COLUMNS.index("iteration")
            kept = [line for line in complete if _iteration_of(line.split(",")[column]) <= iteration]
            write_text(self.curve, "\n".join([",".join(CURVE_COLUMNS), *kept]) + "\n")

    def log_rows(self) -> list[dict]:
        """The lines of log.jsonl; one cut short by a kill, or damaged otherwise, is left out."""
        rows = []
        lines = self.log_file.read_text(errors="replace").splitlines() if self.log_file.exists() else []
        for line in lines:
            try:
                row = json.loads(line)
            except (ValueError, RecursionError):
                continue
            if isinstance(row, dict):
                rows.append(row)
        return rows

    # What is done: one record a stage, with the hashes of what went into it: {"data", "config", "code"}.

    def state(self, stage: str, inputs: dict[str, str]) -> tuple[State, str]:
        """Whether a stage is done with these inputs, and the commit that did it. A stage is open, too, where an output
        that it had is missing."""
        record = read_stages(self.path).get(stage, {})
        if "values" not in record or not all((self.path / name).exists() for name in record["outputs"]):
            return "open", ""
        if any(record["inputs"].get(part) != inputs[part] for part in ("data", "config")):
            return "open", ""
        return "done" if record["inputs"].get("code") == inputs["code"] else "other code", record["commit"]

    def values_of(self, stage: str) -> dict:
        """What `finish` kept of a stage; empty for one that is not finished."""
        return read_stages(self.path).get(stage, {}).get("values", {})

    @property
    def data(self) -> str | None:
        """The hash of the data that the folder's stages were done with; None where none was begun."""
        return next((record["inputs"].get("data") for record in read_stages(self.path).values()), None)

    def begin(self, stage: str, inputs: dict[str, str], outputs: Sequence[str]) -> bool:
        """Record that `stage` begins. Where it had begun with other inputs, `outputs` and the records of later stages
        are deleted first; True if that was because of other code alone."""
        stages = read_stages(self.path)
        before = stages.get(stage)
        if before and before["inputs"] == inputs:
            return False
        if before:
            for name in outputs:
                _remove(self.path / name)
            stages = {name: stages[name] for name in list(stages)[: list(stages).index(stage)]}
        write_json(self.stages, {**stages, stage: {"inputs": inputs, "date": now()}})
        return before is not None and "values" not in before

    def finish(self, stage: str, inputs: dict[str, str], commit: str, outputs: Sequence[str], values: dict) -> None:
        """Record that `stage` ended well, with the outputs that it has made."""
        there = [name for name in outputs if (self.path / name).exists()]
        record = {"inputs": inputs, "commit": commit, "date": now(), "outputs": there, "values": values}
        write_json(self.stages, {**read_stages(self.path), stage: record})


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _iteration_of(value: Any) -> int:
    """The iteration of a line; where it is no number, one that no run reaches."""
    try:
        return int(value)
    except (TypeError, ValueError, OverflowError):
        return sys.maxsize


def now() -> str:
    """UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")


def _append(path: Path, text: str) -> None:
    """Append whole lines, first ending one that a kill left incomplete."""
    with disk_errors_named(path), open(path, "ab+") as file:
        if file.tell() > 0:
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":
                text = "\n" + text
        file.write(text.encode())
