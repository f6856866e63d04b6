"""What a result was made with: versions, machine, commit, command; and how much memory it took."""

from __future__ import annotations

import os
import platform
import resource
import subprocess
from contextlib import suppress
from importlib import metadata
from pathlib import Path

import torch

from pipeline.runs.run_folder import now
from rasterizer.cores import usable_cores
from rasterizer.kernel_loader import kernel

PACKAGES = (
    "torch",
    "numpy",
    "gsplat",
    "scipy",
    "scikit-image",
    "pytorch-msssim",
    "safetensors",
    "hydra-core",
    "opencv-contrib-python-headless",
    "imageio-ffmpeg",
    "pycolmap",
)
PROJECT_ROOT = Path(__file__).resolve().parents[2]


def engine_record(backend: str) -> dict[str, str]:
    """What renders: `backend`, its `engine`, `device` and `driver`, which the kernel has none of."""
    if backend == "cpu":
        return {"backend": backend, "engine": kernel.__name__.removeprefix("rasterizer._"), "device": cpu_model()}
    return {
        "backend": backend,
        "engine": f"gsplat {_version('gsplat')}, CUDA {torch.version.cuda}",
        "device": torch.cuda.get_device_name(),
        "driver": _line_of("/proc/driver/nvidia/version", "NVRM version"),
    }


def provenance(command: str, backend: str = "cpu") -> dict:
    """For environment.json. command: what the user typed.

    `machine` is one readable line; `git_commit` ends in "-dirty" where tracked files were changed.
    """
    return {
        "date": now(),
        "command": command,
        "git_commit": git_commit(),
        "machine": machine_line(),
        "rendered_by": engine_record(backend),
        "cpu": cpu_model(),
        "cores": usable_cores(),
        "memory_gb": round(memory_gb(), 1),
        "system": platform.platform(),
        "versions": {"python": platform.python_version(), **{name: _version(name) for name in PACKAGES}},
    }


def machine_line() -> str:
    return f"{cpu_model()}, {usable_cores()} cores, {memory_gb():.0f} GB"


def cpu_model() -> str:
    """The processor's name as the kernel knows it."""
    return _line_of("/proc/cpuinfo", "model name") or platform.processor() or platform.machine() or "unknown processor"


def memory_gb() -> float:
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9


def git_commit() -> str:
    """The commit of the program's checkout; "unknown" outside one."""
    try:

        def git(*arguments: str) -> str:
            return subprocess.run(
                ["git", "-C", str(PROJECT_ROOT), *arguments], capture_output=True, text=True, check=True, timeout=10
            ).stdout.strip()

        return git("rev-parse", "HEAD") + ("-dirty" if git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def reset_peak_memory() -> None:
    """Let `peak_memory_mb` count from now; without effect where the kernel does not offer it."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_memory_mb() -> float:
    """Largest resident memory of this process since `reset_peak_memory`, in MB (10⁶ bytes)."""
    found = _line_of("/proc/self/status", "VmHWM")
    return (int(found.split()[0]) if found else resource.getrusage(resource.RUSAGE_SELF).ru_maxrss) * 1024 / 1e6


def _line_of(file: str, key: str) -> str:
    """What a file of /proc has behind `key:`; empty where there is no such line."""
    with suppress(OSError):
        for line in Path(file).read_text().splitlines():
            if line.startswith(key):
                return line.partition(":")[2].strip()
    return ""


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None
