"""Target pipeline/data/sfm/__main__.py: a folder of photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hypothesis.strategies import SearchStrategy

from fuzz.edits.bytes import changed_files
from fuzz.target import Changes, Files, Target, require, valid_or_refused
from fuzz.targets.data.dnerf import png
from pipeline.data.sfm.__main__ import read_photographs


def example() -> Files:
    return {f"{number}.png": png(number, 5, 4, channels) for number, channels in enumerate((3, 4))}


def changes(files: Files) -> SearchStrategy[Changes]:
    return changed_files(files, {})


def check(folder: Path) -> str:
    with valid_or_refused(folder) as outcome:
        for photograph in read_photographs(folder):
            image = photograph.image
            require(image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3, f"an image {image.shape}")
    return outcome[0]


TARGET = Target("photographs", "the photographs of python -m pipeline.data.sfm", example, changes, check)
