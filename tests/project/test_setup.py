"""The set-up: where torch is taken from, what is told when it fails; what make does, and what it leaves alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from contextlib import suppress
from importlib.metadata import requires as requires_of
from importlib.metadata import version as version_of
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from project_file import PYPROJECT, ROOT

sys.path.insert(0, str(ROOT / "tools"))

import setup_environment  # noqa: E402

# --- where torch comes from ---


@pytest.fixture()
def pip_calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """The arguments of each call of pip, none of which finds anything; no torch is installed, on Linux."""
    calls: list[tuple[str, ...]] = []

    def pip_install(_: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        calls.append(arguments)
        said = "WARNING: slow\nERROR: No matching distribution found"
        return subprocess.CompletedProcess(arguments, 1, "", said)

    monkeypatch.setattr(setup_environment, "pip_install", pip_install)
    monkeypatch.setattr(setup_environment, "installed_torch", lambda _: "")
    monkeypatch.setattr(setup_environment.platform, "system", lambda: "Linux")
    return calls


def test_on_linux_only_a_cpu_build_can_be_chosen(pip_calls):
    """The index's own build, 2.13.0, brings CUDA packages; PEP 440: a local label in a specifier must match."""
    with pytest.raises(setup_environment.SetupError):
        setup_environment.install_torch(Path("python"), "torch==2.13.0")
    assert len(pip_calls) == 2
    for arguments in pip_calls:
        (asked,) = [Requirement(argument) for argument in arguments if argument.startswith("torch")]
        assert asked.specifier.contains("2.13.0+cpu")
        assert not asked.specifier.contains("2.13.0") and not asked.specifier.contains("2.13.0+cu130")
        assert "--no-deps" in arguments
    assert [setup_environment.CPU_INDEX in arguments for arguments in pip_calls] == [
        False,
        True,
    ]  # pip's settings first


def test_torch_that_is_nowhere_says_where_it_was_sought_and_the_way_out(pip_calls):
    with pytest.raises(setup_environment.SetupError) as error:
        setup_environment.install_torch(Path("python"), "torch==2.13.0")
    assert "\n" not in str(error.value)
    for part in ("torch==2.13.0+cpu", setup_environment.CPU_INDEX, "No matching distribution", "PIP_FIND_LINKS="):
        assert part in str(error.value)


def test_other_systems_take_the_default_index(pip_calls, monkeypatch):
    monkeypatch.setattr(setup_environment.platform, "system", lambda: "Darwin")
    with pytest.raises(setup_environment.SetupError):
        setup_environment.install_torch(Path("python"), "torch==2.13.0")
    assert [arguments[-1] for arguments in pip_calls] == ["torch==2.13.0"]


@pytest.mark.parametrize(
    "there, calls",
    [
        ("2.13.0+cpu", 0),
        ("2.13.0+cu130", 0),  # another build of the pinned version was put there by its owner
        ("2.12.0+cpu", 2),
        ("2.13.0.1", 2),
        ("", 2),
    ],
)
def test_torch_of_the_pinned_version_is_left(pip_calls, monkeypatch, there, calls):
    monkeypatch.setattr(setup_environment, "installed_torch", lambda _: there)
    with suppress(setup_environment.SetupError):
        setup_environment.install_torch(Path("python"), "torch==2.13.0")
    assert len(pip_calls) == calls


def test_installed_torch_is_read_from_the_environment(tmp_path):
    assert setup_environment.installed_torch(Path(sys.executable)) == version_of("torch")
    empty = tmp_path / "python"
    empty.write_text(f'#!/bin/sh\nexec {sys.executable} -S -E "$@"\n')  # -S: no packages
    empty.chmod(0o755)
    assert setup_environment.installed_torch(empty) == ""


LOCK = """# made by a tool
alpha==1 \\
    --hash=sha256:aa
    # via
    #   -r requirements.in
    #   builder
beta==2 \\
    --hash=sha256:bb
    # via alpha
builder-core==3 ; sys_platform != 'win32' \\
    --hash=sha256:cc
    # via other
builder==3 \\
    --hash=sha256:dd
    # via gaussians-4d (pyproject.toml)
other==4 \\
    --hash=sha256:ee
"""


def test_tools_are_the_entries_that_the_build_needs_with_their_hashes():
    part = setup_environment.locked_part(LOCK, ["builder>=2"])
    assert [line.split("==")[0] for line in part.splitlines() if "==" in line] == ["alpha", "beta", "builder"]
    assert [line.split(":")[1].split()[0] for line in part.splitlines() if "--hash" in line] == ["aa", "bb", "dd"]
    with pytest.raises(setup_environment.SetupError, match="absent"):
        setup_environment.locked_part(LOCK, ["absent"])


def test_tools_of_the_lock_have_all_their_dependencies():
    """Against what the installed packages themselves declare."""
    tools = PYPROJECT["build-system"]["requires"]
    part = setup_environment.locked_part((ROOT / "requirements.lock").read_text(), tools)
    there = {line.split("==")[0] for line in part.splitlines() if "==" in line}
    assert {Requirement(tool).name for tool in tools} <= there
    for name in there:
        declared = [Requirement(text) for text in requires_of(name) or []]
        assert {need.name for need in declared if need.marker is None or need.marker.evaluate({"extra": ""})} <= there


def test_torch_is_pinned():
    assert setup_environment.torch_pin(PYPROJECT) == "torch==2.13.0"
    for wrong in (["numpy"], ["torch>=2", "numpy"]):
        with pytest.raises(setup_environment.SetupError, match="one dependency torch==VERSION, found"):
            setup_environment.torch_pin({"project": {"dependencies": wrong}})


@pytest.mark.parametrize(
    "stderr, expected",
    [
        ("WARNING: a\nERROR: first\nERROR: second\nhint", "ERROR: second"),
        (
            "WARNING: Retrying (Retry(total=4)) after a timeout\nERROR: No matching distribution found for rich",
            "the package index cannot be reached: ERROR: No matching distribution found for rich",
        ),
        ("", "it said nothing"),
    ],
)
def test_pip_failure_is_told_in_one_line(stderr, expected):
    assert setup_environment.reason(stderr) == expected


def test_old_python_is_named_in_one_line():
    expected = r"expected 3\.11 or newer, found 3\.9\.2 .*PYTHON="
    with pytest.raises(setup_environment.SetupError, match=expected) as error:
        setup_environment.check_python((3, 9, 2))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "compiler, found", [("no-such-compiler", "No such file"), ("false", "found .*false.*it failed")]
)
def test_unfit_compiler_is_named_in_one_line(monkeypatch, compiler, found):
    monkeypatch.setenv("CXX", compiler)
    expected = rf"expected one with C\+\+20 .*{found}"
    with pytest.raises(setup_environment.SetupError, match=expected) as error:
        setup_environment.check_compiler()
    assert "\n" not in str(error.value)


# --- make ---


def make(*arguments: str, cwd: Path = ROOT) -> str:
    """make's output, run as from a terminal: the flags of a `make test` around this are not handed down."""
    outer = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS")
    environment = {key: value for key, value in os.environ.items() if key not in outer}
    done = subprocess.run(["make", *arguments], cwd=cwd, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture()
def set_up_copy(tmp_path: Path) -> Path:
    """What make looks at, as after a set-up: every product newer than what it is made from."""
    for name in (
        "Makefile",
        "pyproject.toml",
        "requirements.lock",
        "CMakeLists.txt",
        "tools/setup_environment.py",
        "rasterizer/src/module.cpp",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
        os.utime(tmp_path / name, (1000, 1000))
    products = (".venv/.tools", ".venv/.installed", "build/build.ninja", "build/.built", "build/.all_kernels")
    for seconds, product in zip((2000, 3000, 3000, 4000, 5000), products, strict=True):
        (tmp_path / product).parent.mkdir(exist_ok=True)
        (tmp_path / product).touch()
        os.utime(tmp_path / product, (seconds, seconds))
    return tmp_path


def test_make_alone_lists_the_targets():
    listed = {line.split()[1] for line in make().splitlines()}
    assert {"reproduce", "test", "test-data", "setup", "build", "lock", "bench", "report", "clean"} <= listed


def test_second_make_installs_and_builds_nothing(set_up_copy):
    planned = make("-n", "test", cwd=set_up_copy).splitlines()
    assert planned[0].startswith(".venv/bin/python -m pytest ") and "make test: passed" in planned[1]
    assert len(planned) == 2


@pytest.mark.parametrize(
    "changed, installs", [("rasterizer/src/module.cpp", False), ("pyproject.toml", True), ("requirements.lock", True)]
)
def test_make_redoes_what_a_change_asks_for(set_up_copy, changed, installs):
    (set_up_copy / changed).touch()
    planned = make("-n", "build", cwd=set_up_copy)
    assert ("setup_environment.py" in planned) is installs
    assert "cmake --build build --target all other_kernels" in planned  # none that is there stays as it was


def test_set_up_compiles_one_kernel_and_the_tests_the_others(set_up_copy):
    (set_up_copy / "build/.all_kernels").unlink()
    (set_up_copy / "rasterizer/src/module.cpp").touch()
    assert "other_kernels" not in make("-n", "setup", cwd=set_up_copy)
    assert "cmake --build build --target other_kernels" in make("-n", "test", cwd=set_up_copy)
