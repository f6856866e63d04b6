"""Stage sfm: the points and cameras that structure from motion found, or the cameras alone with init.source=random."""

from __future__ import annotations

import shutil

from datasets.files.atomic_write import atomic_file
from pipeline.config.schema import Config
from pipeline.data.prepared import Prepared
from pipeline.runs.run_folder import RunFolder
from pipeline.stages.stage import Log


def copy_points(cfg: Config, data: Prepared, folder: RunFolder, log: Log) -> dict:
    """cached structure from motion → sfm.json, sfm.png."""
    assert data.sfm_folder is not None, "this stage is due only where structure from motion ran"
    for path in (folder.sfm, folder.sfm_picture):
        with atomic_file(path) as temporary:
            shutil.copyfile(data.sfm_folder / path.name, temporary)
    return data.cloud.summary() if data.cloud is not None else {}
