"""Quality against size and speed of a trained model: python -m pipeline.studies.compression RUN

Leaves out the Gaussians that the training images miss least, all but each of --fractions, trains the rest for the last
--retrain of the run's schedule again, stores it in 32, 16 and 8 bits, and measures each on the run's test views. Writes a table, a plot, and the smallest model that loses no more than --loss dB as `compact.safetensors`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from torch import Tensor

from datasets.scene import Scene
from pipeline.config.random_streams import Stream, stream
from pipeline.config.schema import Config
from pipeline.evaluation.evaluate import frames_per_second, held_out_psnr, quick_evaluate
from pipeline.model.model import Model
from pipeline.runs.provenance import provenance
from pipeline.studies.compression.importance import keep_most_important
from pipeline.studies.compression.plot import draw
from pipeline.studies.compression.retrain import retrained
from pipeline.studies.compression.storage import PRECISIONS, Precision, load_compact, save_compact
from pipeline.studies.open_run import open_run
from pipeline.terminal.closed_pipe import quiet_on_closed_pipe
from pipeline.training.density.sensitivity_pruning import image_sensitivity
from pipeline.training.loop import Progress
from rasterizer import Rasterizer
from rasterizer.cores import thread_count

FRACTIONS = (0.8, 0.7, 0.6, 0.5, 0.4)
OUTPUT = "compact.safetensors"


@dataclass(frozen=True)
class Point:
    """One size of a model, measured."""

    fraction: float  # of the Gaussians kept
    precision: Precision  # stored in
    gaussians: int
    megabytes: float  # of the file
    psnr: float  # dB, mean over the test views
    fps: float  # frames a second, everything from the 4D Gaussians to the image


def smaller(model: Model, worth: Tensor, scene: Scene, cfg: Config, fraction: float, share: float) -> Model:
    """The `fraction` of `model`, trained again for `share` of the schedule; the whole stays as it is.

    worth: (N,) of each Gaussian.
    """
    if fraction == 1:
        return model
    frame = Rasterizer(threads=thread_count(cfg.threads))

    def look(state: Model, progress: Progress) -> dict:
        return quick_evaluate(state, scene, cfg, frame)

    return retrained(keep_most_important(model, worth, fraction), scene, cfg, share, look)


def measure(models: dict[float, Model], scene: Scene, cfg: Config) -> list[Point]:
    """Every model, by the fraction that it is of the whole, in each precision; PSNR of what was read back.

    Frames a second once for all precisions: what is read back is float32 again.
    """
    threads, points = thread_count(cfg.threads), []
    fps = {fraction: frames_per_second(model, scene, cfg, threads)["fps_render"] for fraction, model in models.items()}
    with TemporaryDirectory() as folder:
        path = Path(folder) / OUTPUT
        for precision in PRECISIONS:
            for fraction, model in models.items():
                size = save_compact(path, model, precision)
                psnr_read = float(held_out_psnr(load_compact(path), scene, cfg, threads).mean())
                points.append(Point(fraction, precision, len(model), size / 1e6, psnr_read, fps[fraction]))
    return points


def smallest(points: list[Point], loss: float) -> Point:
    """The smallest file within `loss` dB of the whole model in single precision, which comes first."""
    return min((p for p in points if p.psnr >= points[0].psnr - loss), key=lambda p: p.megabytes)


def markdown(points: list[Point], chosen: Point, heading: str, share: float) -> str:
    """A row a point; sizes and speeds also as ratios to the whole model's."""
    whole = points[0]
    lines = [
        "### Quality against size and speed",
        "",
        heading,
        "",
        "| Gaussians kept | stored as | MB | of the whole | FPS | × the whole | PSNR, dB | change |",
        "|---:|:---|---:|---:|---:|---:|---:|---:|",
    ]
    for p in points:
        row = (
            f"{p.fraction:.0%}, {p.gaussians:,}",
            p.precision,
            f"{p.megabytes:.2f}",
            f"{p.megabytes / whole.megabytes:.2f}",
            f"{p.fps:.0f}",
            f"{p.fps / whole.fps:.2f}",
            f"{p.psnr:.2f}",
            f"{p.psnr - whole.psnr:+.2f}",
        )
        lines.append("| " + " | ".join(f"**{cell}**" if p is chosen else cell for cell in row) + " |")
    again = f"Trained again after leaving out: the last {share:.0%} of the schedule." if share else "Not trained again."
    note = (
        "- Bold: the smallest within the loss asked for, as stored. Means stay float32, what int8 leaves of the "
        f"rest float16. {again}"
    )
    return "\n".join([*lines, "", note]) + "\n"


@quiet_on_closed_pipe()
def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m pipeline.studies.compression", description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a finished run")
    parser.add_argument("--loss", type=float, default=0.1, help="dB of PSNR that may be lost (0.1)")
    parser.add_argument(
        "--retrain",
        type=float,
        default=0.6,
        metavar="SHARE",
        help="of the schedule to train again after leaving out (0.6); 0: none",
    )
    parser.add_argument(
        "--fractions",
        type=float,
        nargs="+",
        default=FRACTIONS,
        metavar="F",
        help=f"of the Gaussians to keep, beside all of them ({' '.join(map(str, FRACTIONS))})",
    )
    parser.add_argument("--out", type=Path, default=Path("results/compact"), help="(results/compact)")
    options = parser.parse_args(arguments)
    if not 0 <= options.retrain <= 1:
        print(f"--retrain: expected a share of the schedule, 0 to 1, found {options.retrain}", file=sys.stderr)
        return 1
    if bad := [fraction for fraction in options.fractions if not 0 < fraction < 1]:
        print(f"--fractions: expected parts of the Gaussians, above 0 and below 1, found {bad[0]:g}", file=sys.stderr)
        return 1
    try:
        run = open_run(options.run, print)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 1
    cfg, model = run.cfg, run.model
    threads = thread_count(cfg.threads)
    worth = image_sensitivity(
        model,
        run.scene.train,
        run.scene,
        cfg,
        cfg.train.resolution_scale,
        stream(cfg.seed, Stream.SENSITIVITY),
        threads,
    )
    models = {
        fraction: smaller(model, worth, run.scene, cfg, fraction, options.retrain)
        for fraction in (1.0, *options.fractions)
    }
    points = measure(models, run.scene, cfg)
    chosen = smallest(points, options.loss)
    typed = sys.argv[1:] if arguments is None else arguments
    made = provenance(" ".join(["python -m pipeline.studies.compression", *map(str, typed)]))
    heading = (
        f"{cfg.scene.name}, {cfg.ablation.name}, {cfg.train.name}, seed {cfg.seed}. {made['machine']}; "
        f"{made['date'][:16]}; commit {made['git_commit'][:10]}; `{made['command']}`."
    )
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "compact.md").write_text(markdown(points, chosen, heading, options.retrain), encoding="utf-8")
    (out / "compact.svg").write_text(draw(points, f"{cfg.scene.name}, {cfg.train.name}"), encoding="utf-8")
    save_compact(out / OUTPUT, models[chosen.fraction], chosen.precision)
    print(markdown(points, chosen, heading, options.retrain))
    print(f"written to {out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
