"""Runs the kernel's tests with AddressSanitizer and UndefinedBehaviorSanitizer (`make sanitize`).

Builds go to build/sanitize, for every instruction set of this processor or the named ones:
`.venv/bin/python tools/sanitize.py v3`. The first error ends the run with its source location.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build" / "sanitize"
TESTS = (
    "rasterizer/test_kernel_vs_reference.py",
    "rasterizer/test_kernel_properties.py",
    "rasterizer/test_far_depth_order.py",
    "rasterizer/test_rasterizer.py",
    "rasterizer/test_adam.py",
    "rasterizer/test_loss.py",
    "rasterizer/test_gradients.py",
)


def main(isas: list[str]) -> int:
    """Builds and tests the kernels of `isas` (empty: all); returns the exit status."""
    sys.path.insert(0, str(ROOT))
    from rasterizer.kernel_loader import available_isas

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
        # Tests of other instruction sets would load kernels without sanitizers.
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", "not instruction_set", *tests],
            cwd=ROOT,
            env=environment(isa),
        )
        if done.returncode != 0:
            return done.returncode
    return 0


def build(isas: list[str]) -> None:
    """Configures the sanitized build and compiles what changed."""
    import nanobind

    BUILD.mkdir(parents=True, exist_ok=True)
    configure = [
        *("cmake", "-S", ROOT, "-B", BUILD, "-G", "Ninja"),
        "-DRASTERIZER_SANITIZE=ON",
        "-DCMAKE_BUILD_TYPE=Release",
        f"-Dnanobind_DIR={nanobind.cmake_dir()}",
        f"-DPython_EXECUTABLE={sys.executable}",
    ]
    compile_kernels = ["cmake", "--build", BUILD, "--target", *(f"_kernel_{isa}" for isa in isas)]
    for command in (configure, compile_kernels):
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=tool_path())


def tool_path() -> dict[str, str]:
    """The environment with .venv's cmake and ninja on PATH."""
    return {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


def environment(isa: str) -> dict[str, str]:
    """For the tests: the sanitizer's runtime must be loaded before Python, which is built without it."""
    found = subprocess.run(["c++", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True)
    standard = subprocess.run(["c++", "-print-file-name=libstdc++.so"], capture_output=True, text=True, check=True)
    return {
        **os.environ,
        "LD_PRELOAD": f"{found.stdout.strip()}:{standard.stdout.strip()}",
        "ASAN_OPTIONS": "detect_leaks=0",  # Python frees most of its memory only at exit
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "RASTERIZER_KERNELS": str(BUILD),
        "RASTERIZER_ISA": isa,
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
