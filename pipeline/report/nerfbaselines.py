"""Runs in the shape of NerfBaselines' result files, so that its tools can read and tabulate them.

Its hashes of predictions and truth are left out: they are of its own PNG files. `evaluation_protocol` is ours.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from pipeline.report.runs import FINAL

METRICS = {"psnr": "psnr", "ssim": "ssim", "lpips": "lpips_alex", "lpips_vgg": "lpips_vgg"}  # its names -> ours
DECIMALS = 5  # as it rounds means


def result_file(run: Mapping[str, Any], per_image: pd.DataFrame) -> str:
    """JSON of one run. run: a row of Collection.runs. per_image: its per_image.csv."""
    final = per_image[per_image["model"] == FINAL] if "model" in per_image else per_image
    values = {
        name: final[own].to_numpy(np.float64)
        for name, own in METRICS.items()
        if own in final and final[own].notna().all() and len(final)
    }
    raw = {name: _encoded(found) for name, found in values.items()}
    family, _, scene = run["scene"].partition("/")
    info = {
        "method": f"gaussians-4d:{run['recipe_label']}:{run['model']}",
        "dataset_metadata": {"id": family, "scene": scene or family, "evaluation_protocol": run["protocol"]},
        "total_train_time": _known(run["train_seconds"]),
        "num_iterations": _known(run["iterations"]),
        "resources_utilization": {"memory": _known(run["peak_rss_mb"])},
    }
    content = {
        "nb_info": {key: value for key, value in info.items() if value is not None},
        "evaluate_datetime": run["date"],
        "metrics": {name: round(float(found.mean()), DECIMALS) for name, found in values.items()},
        "metrics_raw": raw,
        "metrics_sha256": _hash(values),
        "evaluation_protocol": run["protocol"],
    }
    return json.dumps(content, indent=2) + "\n"


def _encoded(values: np.ndarray) -> str:
    return base64.b64encode(values.astype("<f4").tobytes()).decode()


def _hash(values: Mapping[str, np.ndarray]) -> str:
    lines = (f"{name.lower()}{_encoded(np.sort(values[name]))}\n" for name in sorted(values))
    return hashlib.sha256("".join(lines).encode()).hexdigest()


def _known(value: float) -> float | None:
    return None if value != value else float(value)
