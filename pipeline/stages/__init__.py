"""The stages of a run: (sfm → select_motion → select_time_colour →) init → train → evaluate → view.

A stage with unchanged inputs is skipped. Its inputs are what its result depends on: the stage before it, the data, and
its part of the configuration.

run.py            all stages of a run, in order         stage.py          what a stage is
inputs.py         what each one's result depends on     points.py … viewing.py   the stages
"""

from __future__ import annotations

from pipeline.stages.inputs import fingerprint, stage_inputs
from pipeline.stages.run import NOTHING_KEPT, kept_progress, run

__all__ = ["NOTHING_KEPT", "fingerprint", "kept_progress", "run", "stage_inputs"]
