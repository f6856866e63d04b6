"""Makes `.venv` and installs the project's requirements in it: the first half of `make setup`.

Only the standard library is used, since nothing else is there yet. The resolver's plan is read before
anything is installed (`pip install --dry-run`: metadata, not wheels); torch_source.py judges it.
"""

from __future__ import annotations

import json
import os
import platform
import shutil
import ssl
import subprocess
import sys
import urllib.request
from pathlib import Path

from torch_source import Package, TorchSource, choose_torch_source, has_nvidia_gpu, read_plan

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
MIN_PYTHON = (3, 11)
# From 25.3 on a dry run leaves wheels where they are; before, it downloads all it plans (pip issue 12603).
MIN_PIP = (25, 3)
PIP = "pip>=25.3,<27"
# fast-deps: where an index offers no metadata files (PEP 658), read a wheel's last kilobytes, not all of it.
DRY_RUN = ["--dry-run", "--quiet", "--use-feature=fast-deps", "--report", "-"]
COMPILER_TEST = """
#include <concepts>
#include <span>
#include <omp.h>
int main() { return omp_get_max_threads() < 1; }
"""


class SetupError(Exception):
    """One line: what was expected, what was found and, where there is one, the way out."""


def main() -> None:
    check_python(tuple(sys.version_info[:3]))
    check_compiler()
    import tomllib  # new in Python 3.11, hence after the check

    needed = requirements(tomllib.loads((ROOT / "pyproject.toml").read_text()))
    python = make_venv()
    update_pip(python)
    say("reading the resolver's plan")
    plan = plan_of(python, *needed)
    if not plan:
        say("nothing to install")
        return
    source = choose_torch_source(plan, has_nvidia_gpu())
    if source.index is not None:
        install_cpu_torch(python, torch_requirement(needed), source, plan)
        plan = plan_of(python, *needed)
    elif source.cuda:
        say(f"this machine has an NVIDIA GPU: {len(source.cuda)} CUDA packages come with torch")
    say(f"installing {len(plan)} packages")
    install(python, *needed)


# --- what must be there already ---


def check_python(version: tuple[int, ...]) -> None:
    """Raises SetupError if this Python is too old for the project."""
    if version[:2] < MIN_PYTHON:
        raise SetupError(f"Python: expected {dotted(MIN_PYTHON)} or newer, found {dotted(version)}"
                         f" ({sys.executable}); `make PYTHON=/path/to/python3.11` names another")


def check_compiler() -> None:
    """Compiles a line of C++20 with OpenMP (on x86-64 for AVX-512), whatever the compiler calls itself."""
    compiler = os.environ.get("CXX") or next(filter(shutil.which, ("c++", "g++", "clang++")), None)
    expected = "C++ compiler: expected one with C++20 and OpenMP (g++ 11, clang++ 14 with libomp, or newer)"
    if compiler is None:
        raise SetupError(f"{expected}, found none; install one, or name it: `make CXX=/path/to/g++`")
    flags = ["-std=c++20", "-fopenmp", "-fsyntax-only", "-x", "c++", "-"]
    if platform.machine() in ("x86_64", "AMD64"):
        flags.insert(0, "-march=x86-64-v4")
    try:
        command = [*compiler.split(), *flags]
        done = subprocess.run(command, input=COMPILER_TEST, capture_output=True, text=True)
        version = subprocess.run([*compiler.split(), "--version"], capture_output=True, text=True).stdout
    except OSError as error:
        raise SetupError(f"{expected}, found {compiler}: {error}") from None
    if done.returncode != 0:
        said = next((line for line in done.stderr.splitlines() if "error" in line), "it failed")
        raise SetupError(f"{expected}, found {version.splitlines()[0] if version else compiler}: {said}")


# --- the steps ---


def requirements(pyproject: dict) -> list[str]:
    """What a working copy needs: the project's dependencies, its tests' and its build's."""
    project = pyproject["project"]
    tests = project["optional-dependencies"]["dev"]
    return [*project["dependencies"], *tests, *pyproject["build-system"]["requires"]]


def torch_requirement(needed: list[str]) -> str:
    """The pin of torch among `needed`; unpinned, it could bring CUDA packages any day."""
    pins = [requirement for requirement in needed if requirement.startswith("torch==")]
    if len(pins) != 1:
        raise SetupError(f"pyproject.toml: expected one dependency torch==VERSION, found {pins}")
    return pins[0]


def make_venv() -> Path:
    """The Python of `.venv`, which is made if need be."""
    python = VENV / "bin" / "python"
    if not python.exists():
        say(f"making .venv with Python {platform.python_version()}")
        done = subprocess.run([sys.executable, "-m", "venv", str(VENV)], capture_output=True, text=True)
        if done.returncode != 0:
            shutil.rmtree(VENV, ignore_errors=True)
            raise SetupError(f"`{sys.executable} -m venv` failed: {last_line(done.stdout + done.stderr)}")
    question = "import sys, pip; print(*sys.version_info[:2])"
    done = subprocess.run([str(python), "-c", question], capture_output=True, text=True)
    found = tuple(map(int, done.stdout.split())) if done.returncode == 0 else ()
    if found < MIN_PYTHON:
        raise SetupError(f".venv: expected Python {dotted(MIN_PYTHON)} or newer with pip, found"
                         f" {dotted(found) or 'a broken one'}; remove .venv and run again")
    return python


def update_pip(python: Path) -> None:
    """Gives `.venv` a pip whose dry run downloads no wheels."""
    found = pip(python, "--version").stdout.split()[1]
    if tuple(int(part) for part in found.split(".")[:2]) < MIN_PIP:
        done = pip(python, "install", "--quiet", PIP)
        if done.returncode != 0:
            raise SetupError(f"pip: expected {dotted(MIN_PIP)} or newer (before, dry runs download wheels),"
                             f" found {found}, and updating it failed: {last_line(done.stderr)}")


def install_cpu_torch(python: Path, torch: str, source: TorchSource, plan: list[Package]) -> None:
    """Installs torch from `source.index`, after a look at that plan too."""
    at_stake = f"{torch} would bring {len(source.cuda)} CUDA packages ({source.cuda[0].name}, …)"
    way_out = (f"put the CPU wheels of {torch} and what it needs in a folder and run"
               " `PIP_FIND_LINKS=/path/to/folder make setup`")
    index = ["--index-url", source.index]
    try:
        cpu_plan = plan_of(python, torch, *index, "--retries", "1", "--timeout", "30")
    except SetupError as error:
        raise SetupError(f"{at_stake} to a machine without an NVIDIA GPU, and {source.index} cannot be had"
                         f" instead ({error}); {way_out}") from None
    if choose_torch_source(cpu_plan, has_gpu=False).cuda:
        raise SetupError(f"{at_stake} to a machine without an NVIDIA GPU, and with {source.index} it still"
                         f" does; {way_out}")
    saved = download_size([*source.cuda, *only_torch(plan)]) - download_size(only_torch(cpu_plan))
    size = f"{saved / 1e9:.1f} GB" if saved > 0 else "gigabytes"
    say(f"no NVIDIA GPU here, and {at_stake}: taking it from {source.index}, {size} less to download")
    install(python, torch, *index)


def only_torch(plan: list[Package]) -> list[Package]:
    return [package for package in plan if package.name == "torch"]


def download_size(packages: list[Package]) -> float:
    """Bytes, as the server tells; NaN if it does not."""
    context = ssl.create_default_context(cafile=os.environ.get("PIP_CERT"))
    total = 0.0
    for package in packages:
        try:
            request = urllib.request.Request(package.url, method="HEAD")
            with urllib.request.urlopen(request, timeout=10, context=context) as reply:
                total += int(reply.headers["Content-Length"])
        except (OSError, ValueError, TypeError):
            return float("nan")
    return total


# --- pip, and talk ---


def pip(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [str(python), "-m", "pip", "--disable-pip-version-check", *arguments]
    return subprocess.run(command, capture_output=True, text=True)


def plan_of(python: Path, *arguments: str) -> list[Package]:
    """The resolver's plan for `pip install arguments`. Raises SetupError with pip's own error."""
    done = pip(python, "install", *DRY_RUN, *arguments)
    if done.returncode != 0:
        raise SetupError(f"pip has no plan: {last_line(done.stderr)}")
    return read_plan(json.loads(done.stdout))


def install(python: Path, *arguments: str) -> None:
    """`pip install`, silent unless it fails. Python compiles what it imports, when it first does."""
    done = pip(python, "install", "--quiet", "--no-compile", *arguments)
    if done.returncode != 0:
        print(done.stderr, file=sys.stderr)
        raise SetupError(f"pip install failed: {last_line(done.stderr)}")


def say(text: str) -> None:
    print(f"setup: {text}", flush=True)


def dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def last_line(text: str) -> str:
    """The last error in pip's output, else its last line."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR")]
    return (errors or lines or ["it said nothing"])[-1]


if __name__ == "__main__":
    try:
        main()
    except SetupError as error:
        sys.exit(f"setup: {error}")
