"""Reference points: the PSNR of a short training by ten seeds, on each instruction set of kernel and of PyTorch.

Writes reference_points.md, a line an iteration, and reference_points.csv, a line a run; the latter is results.csv,
which `make test` compares its own runs with. About four minutes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pipeline.runs.run_folder import csv_text
from pipeline.studies.common import StudyParser, made_by, markdown_table, write_results
from pipeline.studies.reference_points.points import COMMAND, SEEDS, Curves, Rounding, curve, points, table
from pipeline.terminal.command_line import command
from rasterizer.kernel_loader import ISA_VARIABLE, available_isas

NAME = "reference_points"
TORCH_VARIABLE = "ATEN_CPU_CAPABILITY"
HEADER = ("iteration", "PSNR, dB", "sd of seeds", "sd of kernels", "tolerance")


def roundings() -> list[Rounding]:
    """Every kernel of this machine with PyTorch's best instruction set, and the best kernel with PyTorch's others."""
    import torch

    best = torch.backends.cpu.get_cpu_capability().lower()
    others = [level for level in ("avx2", "default") if level != best]
    kernels = available_isas()
    return [*(Rounding(kernel, best) for kernel in kernels), *(Rounding(kernels[0], level) for level in others)]


def train(rounding: Rounding, seeds: Sequence[int], folder: Path) -> dict[int, np.ndarray]:
    """Seed -> its curve. The runs are one command, in a folder of their own, and share the scene in `folder`."""
    out = folder / f"{rounding.kernel}-{rounding.torch}"
    overrides = [f"scene.cache={folder / 'cache'}", f"out={out}/seed${{seed}}", "threads=1"]
    words = ["-m", *COMMAND, *overrides, f"seed={','.join(map(str, seeds))}"]
    chosen = {ISA_VARIABLE: rounding.kernel, TORCH_VARIABLE: rounding.torch}
    subprocess.run(
        [sys.executable, "-m", "pipeline", *words], env=os.environ | chosen, stdout=subprocess.DEVNULL, check=True
    )
    return {seed: curve(out / f"seed{seed}") for seed in seeds}


def markdown(curves: Curves, heading: str) -> str:
    rows = [
        [str(p.iteration), f"{p.mean:.3f}", f"{p.between_seeds:.3f}", f"{p.between_kernels:.5f}", f"{p.tolerance:.4f}"]
        for p in points(curves)
    ]
    names = ", ".join(dict.fromkeys(rounding for rounding, _ in curves))
    about = f"Test PSNR, {SEEDS} seeds. Instruction sets, kernel/PyTorch: {names}."
    return f"### Reference points\n\n{heading}\n\n{about}\n\n{markdown_table(HEADER, rows)}\n"


@command
def main(arguments: list[str]) -> int:
    parser = StudyParser(NAME, __doc__)
    options = parser.parse_args(arguments)
    curves: dict[tuple[str, int], np.ndarray] = {}
    with tempfile.TemporaryDirectory() as folder:
        for rounding in roundings():
            for seed, found in train(rounding, range(SEEDS), Path(folder)).items():
                curves[str(rounding), seed] = found
    write_results(options.out, NAME, markdown(curves, made_by(NAME, arguments)), {"csv": csv_text(*table(curves))})
    return 0


if __name__ == "__main__":
    sys.exit(main())
