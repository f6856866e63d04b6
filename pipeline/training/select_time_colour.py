"""Does this scene need colours that change with time? Two short trainings on some of its cameras say so.

4DSH holds two thirds of a Gaussian's numbers. Where a thing's colour does change they show it; where none does they can
but learn noise, and cost bytes and time. Which it is no number in the data says. So the model is trained with and
without, in a part of the schedule and at half size, on three quarters of the training cameras; the other quarter is
the judge. No test view has a say.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from datasets.scene import Scene, SceneError
from datasets.validation import hold_out_poses
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.data.sfm.photograph import Reconstruction
from pipeline.evaluation.evaluate import held_out_psnr
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, kind_of
from pipeline.training import schedule
from pipeline.training.loop import Progress, train
from pipeline.training.unrecorded import no_record

HELD_OUT = 4  # every so many-th pose judges
SIZE = 0.5  # of the images; whether a colour changes shows at half size too
# dB that colours of time must be worth: twice what such a gain varies by from seed to seed (few_views.md), which the
# error over the views does not show.
WORTH = 0.2
PROOF = 2.0  # standard errors that the gain must be above zero


@dataclass(frozen=True)
class Verdict:
    """What the held-out views said."""

    gain: float  # dB of PSNR that colours of time add to the held-out views, in the mean
    standard_error: float  # dB, of that mean
    views: int
    seconds: float  # that both trainings took

    @property
    def kept(self) -> bool:
        return self.gain > max(WORTH, PROOF * self.standard_error)

    def __str__(self) -> str:
        return (
            f"colours that change with time give {self.views} held-out training views {self.gain:+.2f} ± "
            f"{self.standard_error:.2f} dB: {'kept' if self.kept else 'left out'}"
        )


def due(cfg: Config, scene: Scene) -> bool:
    """Is there anything to leave out, and is it asked for? Under a time budget the schedule gets all of it."""
    train = cfg.train
    if train.trial == 0 or train.time_budget_s is not None or kind_of(scene, cfg).fourier_order == 0:
        return False
    try:
        part = hold_out_poses(scene, HELD_OUT)
    except SceneError:
        return False
    return part.extent > 0 and len(part.test) >= 2  # one says nothing of its error


def without_time_colors(cfg: Config) -> Config:
    """The configuration of a model whose colours do not change with time: that of the ablation No-4DSH."""
    return replace(cfg, ablation=replace(cfg.ablation, fourier_order=0))


def judge(scene: Scene, cfg: Config, cloud: Reconstruction | None, threads: int, say: Callable[[str], None]) -> Verdict:
    """The verdict on `scene.train`. A function of the scene, the configuration and its seed, but for the seconds."""
    started, part = time.perf_counter(), hold_out_poses(scene, HELD_OUT)
    short = schedule.shortened(cfg.train, cfg.train.trial)
    short = replace(
        short,
        resolution_scale=SIZE * short.resolution_scale,
        eval_every=short.iterations,
        checkpoint_every=short.iterations,
    )
    cfg, psnr = replace(cfg, train=short, resume=False), []
    for asked, what in ((cfg, "with"), (without_time_colors(cfg), "without")):
        say(
            f"trial: {what} colours that change with time, {short.iterations} iterations; "
            f"{len(part.train)} training views, {len(part.test)} judge"
        )
        psnr.append(_trained_psnr(part, asked, cloud, threads))
    gain, error = mean_and_error(psnr[0] - psnr[1], [view.camera.world_to_cam.tobytes() for view in part.test])
    return Verdict(gain, error, len(part.test), time.perf_counter() - started)


def mean_and_error(gains: np.ndarray, poses: Sequence[Hashable]) -> tuple[float, float]:
    """The mean of `gains` (at least two views,), and its standard error: over the poses, if there are two.

    The frames of one camera err together: a hundred of them know little more of another camera than ten. Of a single
    pose frames are all there is.
    """
    groups: dict[Hashable, list[float]] = defaultdict(list)
    for pose, gain in zip(poses, gains.tolist(), strict=True):
        groups[pose].append(gain)
    samples = np.array([np.mean(group) for group in groups.values()]) if len(groups) > 1 else gains
    return float(samples.mean()), float(samples.std(ddof=1) / len(samples) ** 0.5)


def _trained_psnr(part: Scene, cfg: Config, cloud: Reconstruction | None, threads: int) -> np.ndarray:
    """(test views,) dB, of a model trained on `part.train`."""

    def look(model: Model, progress: Progress) -> dict:
        return {"psnr": float(held_out_psnr(model, part, cfg, threads).mean())}

    start = initialise(part, cfg, stream(cfg.seed, Stream.INIT), cloud)
    with no_record() as run:
        model = train(start, part, cfg, run, look).model
    return held_out_psnr(model, part, cfg, threads)
