"""The run folder: every file that a run writes, and the record of its finished stages.

    config.yaml  environment.json  stages.json  log.jsonl
    sfm.json  sfm.png  canonical.json  init.ply  checkpoint.safetensors  error_vs_time.csv
    metrics.json  per_image.csv  renders/  viewer.html

Whole files are written atomically (datasets/files/atomic_write.py). The two that grow line by line (log.jsonl,
error_vs_time.csv) lose at most an incomplete last line, which is dropped when they are read.
"""

from __future__ import annotations

import csv
import fcntl
import io
import json
import os
import shutil
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from datasets.files.atomic_write import disk_errors_named, write_json, write_text
from pipeline.runs.run_identity import FILES, UNFINISHED, Resolve, read_stages, refuse_foreign, refuse_other_run

CURVE_COLUMNS = ("train_seconds", "iteration", "psnr", "ssim", "test_loss", "n_gaussians", "psnr_moving")
OLD_CURVE_COLUMNS = CURVE_COLUMNS[:-1]  # up to version 0.1


def write_csv(path: Path, rows: list[dict]) -> None:
    """One row a dict; the first one names the columns. None is an empty cell."""
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(rows[0]) if rows else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


class RunFolder:
    """An open run folder; a context manager that keeps other processes out until it is closed."""

    def __init__(self, path: Path, config: dict, resume: bool = True, resolve: Resolve = dict) -> None:
        """Open `path` for the run `config` (resolved, as plain dicts), making the folder if need be.

        resume=False first deletes what an earlier run left there. resolve: fills in what the data decide in the
        config.yaml of a run from before it was written resolved. ValueError if the folder is not a run folder, holds
        another run, or is in use; then nothing there has changed.
        """
        refuse_foreign(path)
        with disk_errors_named(path):
            path.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._lock = _locked(path)
        try:
            if resume:
                refuse_other_run(path, config, resolve)
            else:
                self._clear()
            for name in UNFINISHED:
                (path / name).unlink(missing_ok=True)
        except BaseException:
            self._lock.close()
            raise
        write_text(self.config, OmegaConf.to_yaml(OmegaConf.create(config)))

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, *exception: Any) -> None:
        self._lock.close()

    @property
    def config(self) -> Path:
        return self.path / "config.yaml"

    @property
    def provenance(self) -> Path:
        return self.path / "environment.json"

    @property
    def sfm(self) -> Path:
        return self.path / "sfm.json"

    @property
    def sfm_picture(self) -> Path:
        return self.path / "sfm.png"

    @property
    def canonical(self) -> Path:
        return self.path / "canonical.json"

    @property
    def init_ply(self) -> Path:
        return self.path / "init.ply"

    @property
    def checkpoint(self) -> Path:
        return self.path / "checkpoint.safetensors"

    @property
    def curve(self) -> Path:
        return self.path / "error_vs_time.csv"

    @property
    def log_file(self) -> Path:
        return self.path / "log.jsonl"

    @property
    def metrics(self) -> Path:
        return self.path / "metrics.json"

    @property
    def per_image(self) -> Path:
        return self.path / "per_image.csv"

    @property
    def renders(self) -> Path:
        return self.path / "renders"

    @property
    def viewer(self) -> Path:
        return self.path / "viewer.html"

    # What grows while a run goes on.

    def log(self, row: dict) -> None:
        """Append a line to log.jsonl, dated."""
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
            header, *lines = self.curve.read_text(errors="replace").splitlines() or [""]
            if header == ",".join(OLD_CURVE_COLUMNS):
                lines = [line + "," for line in lines if line.count(",") == len(OLD_CURVE_COLUMNS) - 1]
            complete = [line for line in lines if line.count(",") == len(CURVE_COLUMNS) - 1]
            kept = [line for line in complete if _iteration_of(line.split(",")[1]) <= iteration]
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

    # What is done: one record a finished stage, with the hash of what went into it.

    def values_of(self, stage: str) -> dict:
        """What `finish` kept of a finished stage."""
        return self._stages()[stage]["values"]

    def inputs_of(self, stage: str) -> str | None:
        """The inputs' hash the stage was last finished with; None if it never was."""
        return self._stages().get(stage, {}).get("inputs")

    def finish(self, stage: str, inputs: str, **values: Any) -> None:
        """Record that `stage` ended well."""
        record = {"inputs": inputs, "date": now(), "values": values}
        write_json(self.path / "stages.json", {**self._stages(), stage: record})

    def _stages(self) -> dict:
        return read_stages(self.path)

    def _clear(self) -> None:
        for name in FILES:
            path = self.path / name
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


def _locked(path: Path) -> io.TextIOWrapper:
    with disk_errors_named(path / ".lock"):
        lock = open(path / ".lock", "w")  # noqa: SIM115 (held until the run ends)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        lock.close()
        raise ValueError(f"{path}: expected a free run folder, found another process at work in it") from error
    return lock
