"""Makes `.venv` and installs in it what requirements.lock pins, then torch: all of `make setup` but the kernel.

    setup_environment.py tools      .venv, and what the kernel is compiled with
    setup_environment.py packages   the rest, which make installs while the kernel compiles
    setup_environment.py gpu        the build of torch with CUDA in place of the other, and the extra `gpu`

Only the standard library is used, since nothing else is there yet. torch is not in the lock: one version of it has
many builds, each with hashes of its own, and which is wanted depends on the machine. Linux wheels on the default
package index bring gigabytes of CUDA packages that nothing here uses, so on Linux the CPU build is asked for by its
name, `torch==VERSION+cpu`, which no other build answers to.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
LOCK = ROOT / "requirements.lock"
MIN_PYTHON = (3, 11)
# PyTorch's own index of CPU builds: https://pytorch.org/get-started/locally/, "Compute Platform: CPU".
CPU_INDEX = "https://download.pytorch.org/whl/cpu"
COMPILER_TEST = """
#include <concepts>
#include <span>
#include <omp.h>
int main() { return omp_get_max_threads() < 1; }
"""


class SetupError(Exception):
    """One line: what was expected, what was found and, where there is one, the way out."""


def main(part: str) -> None:
    check_python(tuple(sys.version_info[:3]))
    import tomllib  # new in Python 3.11, hence after the check

    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())
    python = make_venv()
    if part == "tools":
        check_compiler()
        install_tools(python, pyproject)
    elif part == "gpu":
        install_gpu(python, pyproject)
    else:
        log(f"installing what {LOCK.name} pins")
        install(python, *locked(LOCK))
        install_torch(python, torch_pin(pyproject))


# --- what must be there already ---


def check_python(version: tuple[int, ...]) -> None:
    """Raises SetupError if this Python is too old for the project."""
    if version[:2] < MIN_PYTHON:
        raise SetupError(
            f"Python: expected {dotted(MIN_PYTHON)} or newer, found {dotted(version)}"
            f" ({sys.executable}); `make PYTHON=/path/to/python3.11` names another"
        )


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


def make_venv() -> Path:
    """The Python of `.venv`, which is made if need be."""
    python = VENV / "bin" / "python"
    if not python.exists():
        log(f"making .venv with Python {platform.python_version()}")
        done = subprocess.run([sys.executable, "-m", "venv", str(VENV)], capture_output=True, text=True)
        if done.returncode != 0:
            shutil.rmtree(VENV, ignore_errors=True)
            raise SetupError(f"`{sys.executable} -m venv` failed: {last_line(done.stdout + done.stderr)}")
    question = "import sys, pip; print(*sys.version_info[:2])"
    done = subprocess.run([str(python), "-c", question], capture_output=True, text=True)
    found = tuple(map(int, done.stdout.split())) if done.returncode == 0 else ()
    if found < MIN_PYTHON:
        raise SetupError(
            f".venv: expected Python {dotted(MIN_PYTHON)} or newer with pip, found"
            f" {dotted(found) or 'a broken one'}; remove .venv and run again"
        )
    return python


def locked(requirements: Path) -> list[str]:
    """pip's options for the lock or a part of it. Nothing is resolved: the lock is complete but for torch, which some
    of its packages ask for. Of those only Hydra's parser has no wheel; it is plain Python."""
    binary = ["--only-binary", ":all:", "--no-binary", "antlr4-python3-runtime"]
    return ["--require-hashes", "--no-deps", *binary, "--requirement", str(requirements)]


def install_tools(python: Path, pyproject: dict) -> None:
    """Installs what pyproject.toml's build needs, in the versions of the lock."""
    requirements = VENV / "tools.txt"
    requirements.write_text(locked_part(LOCK.read_text(), pyproject["build-system"]["requires"]))
    install(python, *locked(requirements))


def locked_part(lock: str, requires: list[str]) -> str:
    """The entries of a lock for these packages and all that they need. Each entry names after "via" what needs it."""
    entries = {entry.partition("==")[0]: entry for entry in re.split(r"^(?=[a-z0-9])", lock, flags=re.MULTILINE)[1:]}
    wanted = {re.split(r"[^A-Za-z0-9-]", name)[0] for name in requires}
    if missing := wanted - set(entries):
        raise SetupError(f"{LOCK.name}: expected an entry for each build requirement, found none for {missing}")
    while more := {name for name, entry in entries.items() if wanted & needed_by(entry)} - wanted:
        wanted |= more
    return "".join(entry for name, entry in entries.items() if name in wanted)


def needed_by(entry: str) -> set[str]:
    """The packages that an entry of the lock names after "via"."""
    return set(re.findall(r"^    #\s+(?:via )?([a-z0-9-]+)$", entry, flags=re.MULTILINE)) - {"via"}


def torch_pin(pyproject: dict) -> str:
    """`torch==VERSION` among the project's dependencies."""
    pins = [needed for needed in pyproject["project"]["dependencies"] if needed.startswith("torch")]
    if len(pins) != 1 or not pins[0].startswith("torch=="):
        raise SetupError(f"pyproject.toml: expected one dependency torch==VERSION, found {pins}")
    return pins[0]


def install_torch(python: Path, pin: str) -> None:
    """Installs the CPU build: from where this machine's pip looks, else from PyTorch's index. Any build that is there
    already is left. Without dependencies, which the lock has."""
    if f"torch=={installed_torch(python).partition('+')[0]}" == pin:
        return
    wheel = ["--no-deps", "--only-binary", ":all:"]
    if platform.system() != "Linux":  # elsewhere the default index has nothing but CPU builds
        log(f"installing {pin}")
        install(python, *wheel, pin)
        return
    build = f"{pin}+cpu"
    log(f"installing {build}")
    if pip_install(python, *wheel, build).returncode == 0:
        return
    log(f"not where pip is set to look; taking it from {CPU_INDEX}")
    done = pip_install(python, *wheel, build, "--index-url", CPU_INDEX, "--retries", "1", "--timeout", "30")
    if done.returncode != 0:
        raise SetupError(
            f"{build}: neither where pip is set to look nor at {CPU_INDEX} ({reason(done.stderr)}); put"
            " its wheel in a folder and run `PIP_FIND_LINKS=/path/to/folder make setup`"
        )


def install_gpu(python: Path, pyproject: dict) -> None:
    """Installs torch with CUDA, from where pip is set to look: the default index has that build for Linux. The rest of
    the lock stays as it is."""
    pin, extra = torch_pin(pyproject), pyproject["project"]["optional-dependencies"]["gpu"]
    if not installed_torch(python) or installed_torch(python).endswith("+cpu"):
        log(f"installing {pin} with CUDA")
        install(python, "--force-reinstall", "--no-deps", "--only-binary", ":all:", pin)
        if installed_torch(python).endswith("+cpu"):
            raise SetupError(
                f"{pin}: expected a build with CUDA, found {installed_torch(python)}; name an index that has one: "
                "`PIP_INDEX_URL=https://download.pytorch.org/whl/cu130 make gpu`"
            )
    log(f"installing {', '.join(extra)}")
    install(python, pin, *extra)


def installed_torch(python: Path) -> str:
    """Its version in `.venv`; empty if it is not there."""
    question = "import importlib.metadata as m; print(m.version('torch'))"
    return subprocess.run([str(python), "-c", question], capture_output=True, text=True).stdout.strip()


# --- pip, and talk ---


def pip_install(python: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Without compiling: Python compiles what it imports, when it first does."""
    command = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-compile"]
    return subprocess.run([*command, *arguments], capture_output=True, text=True)


def install(python: Path, *arguments: str) -> None:
    """`pip install`, silent unless it fails."""
    done = pip_install(python, *arguments)
    if done.returncode != 0:
        print(*(line for line in done.stderr.splitlines() if not line.startswith("WARNING")), sep="\n", file=sys.stderr)
        raise SetupError(f"pip install failed: {reason(done.stderr)}")


def log(text: str) -> None:
    print(f"setup: {text}", flush=True)


def dotted(version: tuple[int, ...]) -> str:
    return ".".join(map(str, version))


def reason(stderr: str) -> str:
    """One line of what pip wrote: its last error, and whether it got no answer from the package index."""
    unreachable = "the package index cannot be reached: " if "Retrying (" in stderr else ""
    return unreachable + last_line(stderr)


def last_line(text: str) -> str:
    """The last error in pip's output, else its last line."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if line.startswith("ERROR")]
    return (errors or lines or ["it said nothing"])[-1]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("tools", "packages", "gpu"))
    try:
        main(parser.parse_args().part)
    except SetupError as error:
        sys.exit(f"setup: {error}")
