"""Runs the kernel's tests on kernels built with AddressSanitizer and UndefinedBehaviorSanitizer (`make sanitize`).

They are built into build/sanitize, apart from those in use, for each instruction set that this processor has, or those
that are named: `.venv/bin/python tools/sanitize.py v3`. The first fault ends the run with its place in the source.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build" / "sanitize"
TESTS = (
    "test_rasterizer.py",
    "test_rasterizer_rules.py",
    "test_depth_order.py",
    "test_frame.py",
    "test_adam.py",
    "test_loss.py",
    "test_sweeps.py",
)


def main(isas: list[str]) -> int:
    """Builds and tests; returns the exit status."""
    sys.path.insert(0, str(ROOT))
    from rasterizer.kernel import available_isas

    isas = isas or available_isas()
    if wrong := [isa for isa in isas if isa not in available_isas()]:
        print(
            f"error: expected some of {', '.join(available_isas())} (what this processor has), found {wrong[0]!r}",
            file=sys.stderr,
        )
        return 1
    build(isas)
    for isa in isas:
        print(f"sanitize: {isa}", flush=True)
        tests = [str(ROOT / "tests" / name) for name in TESTS]
        # Those tests choose kernels of other instruction sets in processes of their own, at their own time.
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "not instruction_set", *tests],
            cwd=ROOT,
            env=environment(isa),
        )
        if done.returncode != 0:
            return done.returncode
    return 0


def build(isas: list[str]) -> None:
    """Configure once, build what changed."""
    import nanobind

    BUILD.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        [
            "cmake",
            "-S",
            ROOT,
            "-B",
            BUILD,
            "-G",
            "Ninja",
            "-DRASTERIZER_SANITIZE=ON",
            "-DCMAKE_BUILD_TYPE=Release",
            f"-Dnanobind_DIR={nanobind.cmake_dir()}",
            f"-DPython_EXECUTABLE={sys.executable}",
        ],
        check=True,
        stdout=subprocess.DEVNULL,
        env=tool_path(),
    )
    subprocess.run(
        ["cmake", "--build", BUILD, "--target", *(f"_kernel_{isa}" for isa in isas)],
        check=True,
        stdout=subprocess.DEVNULL,
        env=tool_path(),
    )


def tool_path() -> dict[str, str]:
    """The environment with cmake and ninja of .venv."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def environment(isa: str) -> dict[str, str]:
    """For the tests: the sanitizer's runtime must be loaded before Python, which was built without it."""
    found = subprocess.run(["c++", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    standard = subprocess.run(["c++", "-print-file-name=libstdc++.so"], capture_output=True, text=True, check=True)
    return {
        **os.environ,
        "LD_PRELOAD": f"{found.stdout.strip()}:{standard.stdout.strip()}",
        "ASAN_OPTIONS": "detect_leaks=0",  # Python keeps what it has until the end
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "RASTERIZER_KERNELS": str(BUILD),
        "RASTERIZER_ISA": isa,
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
