"""Gradient clipping: norms of the gradients, and PSNR of training with and without clipping.

The pipeline does not clip gradients. Here its Adam is replaced by one that scales the whole gradient down to a
threshold norm, a quantile of the norms of a run without clipping: on two healthy scenes, with ten times the learning
rates, and with one training image of black and white noise. Writes gradient_clipping.md.
"""

from __future__ import annotations

import sys

import torch

from pipeline.studies.command_line import Provenance, StudyParser, log, study_command
from pipeline.studies.gradient_clipping.table import WINDOW, markdown
from pipeline.studies.gradient_clipping.training_runs import CASES, study_config, train_cases
from pipeline.studies.output import write_results

NAME = "gradient_clipping"


@study_command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    parser.add_argument(
        "--iterations", type=int, default=1000, metavar="N", help="of train=fast (default: %(default)s)"
    )
    parser.add_argument(
        "--points", type=int, default=8000, metavar="N", help="initial Gaussians (default: %(default)s)"
    )
    parser.add_argument(
        "--size", type=int, default=200, metavar="PIXELS", help="width of the images (default: %(default)s)"
    )
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0, 1, 2], metavar="SEED", help="random seeds (default: 0 1 2)"
    )
    options = parser.parse_args(arguments)
    parser.require(options.iterations > 2 * WINDOW, "--iterations", f"more than {2 * WINDOW}", options.iterations)
    torch.set_num_threads(1)
    configs = {
        scene: study_config(scene, options.iterations, options.points, options.size)
        for scene in dict.fromkeys(case.scene for case in CASES)
    }
    runs = train_cases(configs, options.seeds, log)
    heading = (
        f"`train=fast` from {options.points:,} points, {options.size} px, {options.iterations:,} iterations. "
        f"{Provenance.of(NAME, arguments)}."
    )
    table = markdown(runs, heading)
    written = write_results(options.out, {f"{NAME}.md": table})
    print(table)
    print(written)
    return 0


if __name__ == "__main__":
    sys.exit(main())
