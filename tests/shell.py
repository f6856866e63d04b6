"""Runs the command line in a folder of its own, and reads what a run left."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from pipeline.configure import CONFIG_DIR


class Shell:
    """Runs `python -m pipeline` in a folder of its own, scenes cached between runs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._environment = {**os.environ, "PYTHONPATH": str(CONFIG_DIR.parent), "OMP_NUM_THREADS": "1"}

    def start(self, *arguments: str, module: str = "pipeline") -> subprocess.Popen:
        return subprocess.Popen([sys.executable, "-m", module, *arguments], cwd=self.folder, text=True,
                                stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=self._environment)

    def __call__(self, *arguments: str, status: int = 0, module: str = "pipeline") -> tuple[str, str]:
        process = self.start(*arguments, module=module)
        out, err = process.communicate(timeout=120)
        assert process.returncode == status, err
        return out, err


def result(folder: Path) -> dict:
    """metrics.json without what depends on the machine's speed and the clock."""
    metrics = json.loads((folder / "metrics.json").read_text())
    for name in ("date", "train_seconds", "peak_rss_mb"):
        del metrics[name]
    for model in ("final", "best_on_test"):
        for name in ("fps_raster", "fps_render"):
            del metrics[model][name]
    return metrics
