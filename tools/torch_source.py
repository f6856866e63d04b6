"""Decides where torch comes from, given the resolver's plan and whether the machine has an NVIDIA GPU.

On Linux the default package index serves a torch that brings gigabytes of CUDA packages. A machine without an
NVIDIA GPU has no use for them: there torch comes from PyTorch's own index of CPU builds
(https://pytorch.org/get-started/locally/, "Compute Platform: CPU").
"""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
CUDA_PREFIXES = ("nvidia-", "cuda-", "triton", "pytorch-triton")


@dataclass(frozen=True)
class Package:
    """One package the resolver means to install."""

    name: str  # normalised: lower case, dashes
    version: str
    url: str


@dataclass(frozen=True)
class TorchSource:
    """Where torch comes from, and what made the choice."""

    index: str | None  # None: this machine's package index, as configured
    cuda: tuple[Package, ...]  # the plan's CUDA packages, torch itself not among them


def read_plan(report: dict) -> list[Package]:
    """The packages of a `pip install --dry-run --report` (pip's installation report, version 1)."""
    plan = []
    for item in report["install"]:
        name = item["metadata"]["name"].lower().replace("_", "-").replace(".", "-")
        plan.append(Package(name, item["metadata"]["version"], item["download_info"]["url"]))
    return plan


def choose_torch_source(plan: list[Package], has_gpu: bool) -> TorchSource:
    """CPU_INDEX when the plan has CUDA packages and the machine no NVIDIA GPU; otherwise no change."""
    cuda = tuple(package for package in plan if package.name.startswith(CUDA_PREFIXES))
    return TorchSource(CPU_INDEX if cuda and not has_gpu else None, cuda)


def has_nvidia_gpu(root: Path = Path("/"), search_path: str | None = None) -> bool:
    """Whether an NVIDIA driver has a device here. Tests give a `root` and a `search_path` of programs."""
    if (root / "dev/nvidia0").exists() or (root / "proc/driver/nvidia/version").exists():
        return True
    nvidia_smi = shutil.which("nvidia-smi", path=search_path)
    return bool(nvidia_smi) and subprocess.run([nvidia_smi, "-L"], capture_output=True).returncode == 0
