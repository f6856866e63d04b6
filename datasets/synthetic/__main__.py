"""python -m datasets.synthetic wheel --out DIR: writes one synthetic scene to a folder."""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from datasets.files.errors import SceneError
from datasets.settings import CAMERA_PATHS
from datasets.synthetic import DRIVEN, FILMED, PHOTOGRAPHED, SCENE_NAMES, build_scene
from rasterizer.cores import usable_cores


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m datasets.synthetic",
        description="Makes a synthetic scene in the "
        "D-NeRF layout, with exact depth, optical flow and moving pixels for its test views, or "
        f"({', '.join(FILMED)}) in the Plenoptic Video layout, with the same for every frame, or "
        f"({', '.join(DRIVEN)}) a driving log in Waymo's processed layout.",
    )
    parser.add_argument("scene", choices=SCENE_NAMES)
    parser.add_argument("--out", type=Path, required=True, help="folder to make; must not exist or be empty")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=200, help="image width in pixels (default: %(default)s)")
    photographed = parser.add_argument_group("photographed scenes", ", ".join(PHOTOGRAPHED))
    photographed.add_argument("--train-views", type=int, default=100, help="default: %(default)s")
    photographed.add_argument("--test-views", type=int, default=12, help="default: %(default)s")
    photographed.add_argument(
        "--camera-path",
        choices=CAMERA_PATHS,
        default="jumps",
        help="jumps: each time from another side; arc: one camera that moves, test views beside it (default: "
        "%(default)s)",
    )
    filmed = parser.add_argument_group("filmed scenes", ", ".join(FILMED))
    filmed.add_argument("--cameras", type=int, default=12, help="default: %(default)s")
    filmed.add_argument("--frames", type=int, default=60, help=f"also of {', '.join(DRIVEN)} (default: %(default)s)")
    filmed.add_argument("--samples", type=int, default=3, help="rays along a pixel's side (default: %(default)s)")
    filmed.add_argument(
        "--processes",
        type=int,
        default=usable_cores(),
        help="cameras rendered in parallel (default: %(default)s, all processors)",
    )
    options = vars(parser.parse_args(arguments))
    folder = options.pop("out")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        parser.error(f"--out {folder}: expected a folder that does not exist or is empty")
    start = time.perf_counter()
    try:
        with _progress("frames" if options["scene"] in DRIVEN else "cameras") as progress:
            build_scene(folder, **options, progress=progress)
    except (SceneError, OSError) as error:
        parser.error(str(error))
    print(f"{folder}: {_written(options)} in {time.perf_counter() - start:.1f} s")
    return 0


def _written(options: dict[str, Any]) -> str:
    """What the scene consists of. options: of the command line."""
    scene, size, frames = options["scene"], options["size"], options["frames"]
    if scene in FILMED:
        return f"{options['cameras']} cameras, {frames} frames each, {size} pixels wide,"
    if scene in DRIVEN:
        return f"a driving log of {frames} frames, with LiDAR, images {size} pixels wide,"
    return f"{options['train_views']} training and {options['test_views']} test views of {size} x {size} pixels"


@contextmanager
def _progress(unit: str) -> Iterator[Callable[[int, int], None]]:
    """A progress bar on a terminal, one line per unit, "cameras" or "frames", elsewhere."""
    console = Console()
    with Progress(
        TextColumn(f"{{task.completed:.0f}}/{{task.total:.0f}} {unit}"),
        BarColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
        transient=True,
    ) as bar:
        tasks: list[TaskID] = []

        def update(done: int, total: int) -> None:
            if not tasks:
                tasks.append(bar.add_task("film", total=total))
            bar.update(tasks[0], completed=done)
            if not console.is_terminal:
                print(f"{done}/{total} {unit}", flush=True)

        yield update


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # no traceback when the reader of a pipe ends, as in `… | head`
    sys.exit(main())
