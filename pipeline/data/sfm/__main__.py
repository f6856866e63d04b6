"""`python -m pipeline.data.sfm FOLDER [--out DIR]`: structure from motion on a folder of photographs without poses."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from datasets.files.errors import DataError
from datasets.source import Photograph
from pipeline.config.schema import InitConfig
from pipeline.data.sfm.cache import save
from pipeline.data.sfm.run import reconstruct
from pipeline.terminal.command_line import CommandParser, command

SUFFIXES = (".png", ".jpg", ".jpeg")


@command
def main(arguments: list[str]) -> int:
    """The command; returns the exit status."""
    parser = CommandParser(
        "data.sfm", "Structure from motion on a folder of photographs: prints a summary, writes points, cameras, plot."
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, help="folder to make")
    parser.add_argument("--downscale", type=int, default=1, help="read at 1/DOWNSCALE of the size (default: 1)")
    for flag, default in (("--max-features", InitConfig.max_features), ("--min-points", InitConfig.min_points)):
        parser.add_argument(flag, type=int, default=default, help="default: %(default)s")
    options = vars(parser.parse_args(arguments))
    folder, out, downscale = (options.pop(name) for name in ("folder", "out", "downscale"))
    if out is not None and out.exists():
        parser.error(f"--out {out}: expected a folder that does not exist")
    photographs = read_photographs(folder, downscale)
    result = reconstruct(photographs, InitConfig(**options), 1.0, folder)
    summary = result.summary()
    print(
        f"{summary['registered']} of {len(photographs)} photographs, {summary['points']} points, mean track length "
        f"{summary['mean_track_length']:.2f}, mean reprojection error {summary['mean_error_px']:.3f} px; "
        f"{summary['seconds']:.0f} s"
    )
    if out is not None:
        save(result, out)
        print(f"written to {out}")
    return 0


def read_photographs(folder: Path, downscale: int = 1) -> list[Photograph]:
    """Every image in `folder`, sorted by name. ValueError of one line if there is none or one cannot be read."""
    paths = sorted(path for path in folder.glob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise ValueError(f"{folder}: expected photographs ({', '.join(SUFFIXES)}), found none")
    photographs = []
    for path in paths:
        try:
            with Image.open(path) as image:
                photographs.append(Photograph(path.stem, np.asarray(image.convert("RGB").reduce(downscale))))
        except Exception as error:  # PIL raises many types for broken files
            raise DataError(path, "a readable image", str(error)) from None
    return photographs


if __name__ == "__main__":
    sys.exit(main())
