"""python -m datasets.synthetic wheel --out DIR: makes one synthetic scene in a folder of your choice."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from datasets.scene import SceneError
from datasets.synthetic import SCENE_NAMES, build_scene


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m datasets.synthetic", description="Makes a synthetic scene in the "
                                     "D-NeRF layout, with exact depth and optical flow for its test views.")
    parser.add_argument("scene", choices=SCENE_NAMES)
    parser.add_argument("--out", type=Path, required=True, help="folder to make; must not exist or be empty")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--size", type=int, default=200, help="image side in pixels (default: %(default)s)")
    parser.add_argument("--train-views", type=int, default=100, help="default: %(default)s")
    parser.add_argument("--test-views", type=int, default=12, help="default: %(default)s")
    options = vars(parser.parse_args(arguments))
    folder = options.pop("out")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        parser.error(f"--out {folder}: expected a folder that does not exist or is empty")
    start = time.perf_counter()
    try:
        build_scene(folder, **options)
    except SceneError as error:
        parser.error(str(error))
    print(f"{folder}: {options['train_views']} training and {options['test_views']} test views of "
          f"{options['size']} x {options['size']} pixels in {time.perf_counter() - start:.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
