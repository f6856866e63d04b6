"""Renews requirements.lock (`make lock`): every package set-up installs but torch, with its version and hashes.

    make lock                    only what pyproject.toml asks for anew
    make lock UPGRADE=--upgrade  the newest versions that pyproject.toml allows

uv resolves for all platforms and Python versions at once. It is installed apart from `.venv`, in build/lock.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / "build" / "lock"
UV = "uv==0.13.9"

# What torch's Linux wheels ask for besides plain Python packages. Set-up takes the CPU build, which needs none of it.
CUDA = (
    "cuda-bindings",
    "cuda-toolkit",
    "nvidia-cudnn-cu13",
    "nvidia-cusparselt-cu13",
    "nvidia-nccl-cu13",
    "nvidia-nvshmem-cu13",
    "triton",
)


def main(arguments: list[str]) -> int:
    """Resolves; `arguments` are further ones of `uv pip compile`. Returns the exit status."""
    subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
    subprocess.run([VENV / "bin/pip", "install", "--quiet", "--disable-pip-version-check", UV], check=True)
    excluded = VENV / "excluded.txt"
    excluded.write_text("\n".join(CUDA) + "\n")
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    tools = pyproject["build-system"]["requires"]
    extras = (extra for extra in pyproject["project"]["optional-dependencies"] if extra != "gpu")  # needs CUDA
    # One version of a package for all Pythons (fewest), so that results do not depend on which one runs them.
    command = [
        VENV / "bin/uv",
        "pip",
        "compile",
        "pyproject.toml",
        "-",
        *(f"--extra={extra}" for extra in extras),
        "--universal",
        "--python-version",
        "3.11",
        "--fork-strategy",
        "fewest",
        "--generate-hashes",
        "--no-emit-package",
        "torch",
        "--excludes",
        excluded,
        "--custom-compile-command",
        "make lock",
        "--no-config",
        "--quiet",
        "--output-file",
        "requirements.lock",
        *arguments,
    ]
    return subprocess.run(command, cwd=ROOT, input="\n".join(tools), text=True).returncode


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
