"""The set-up: the lock, where torch is taken from, what is a library; what make does, and what it leaves alone."""

from __future__ import annotations

import ast
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.metadata import metadata, packages_distributions, requires
from importlib.metadata import version as version_of
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import lock  # noqa: E402
import setup_environment  # noqa: E402

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCKED = ROOT / "requirements.lock"


def declared() -> dict[str, list[Requirement]]:
    """What pyproject.toml asks for: `build` its tools, `library` the dependencies, and each extra under its name."""
    project = PYPROJECT["project"]
    groups = {"build": PYPROJECT["build-system"]["requires"], "library": project["dependencies"],
              **project["optional-dependencies"]}
    return {group: [Requirement(line) for line in lines] for group, lines in groups.items()}


def locked() -> dict[str, list[tuple[Requirement, list[str]]]]:
    """The lock: by normalised name each pinned requirement and its hashes."""
    lines = [line for line in LOCKED.read_text().splitlines() if not line.lstrip().startswith("#")]
    found: dict[str, list[tuple[Requirement, list[str]]]] = {}
    for line in "\n".join(lines).replace("\\\n", " ").splitlines():
        pinned, *hashes = re.split(r"\s+--hash=", line.strip())
        requirement = Requirement(pinned)
        found.setdefault(canonicalize_name(requirement.name), []).append((requirement, hashes))
    return found


def version(requirement: Requirement) -> str:
    """What a requirement NAME==VERSION pins."""
    (specifier,) = requirement.specifier
    assert specifier.operator == "==", requirement
    return specifier.version


# --- the lock ---


@pytest.mark.parametrize("group", declared())
def test_lock_satisfies_pyproject(group):
    lock = locked()
    for needed in declared()[group]:
        if needed.name != "torch":
            pins = lock.get(canonicalize_name(needed.name), [])
            assert pins, f"{needed.name} is not in requirements.lock: make lock"
            for pin, _ in pins:
                assert needed.specifier.contains(version(pin)), f"{pin} does not satisfy {needed}: make lock"


def test_lock_pins_and_hashes_every_package_and_names_no_place():
    for pins in locked().values():
        for pin, hashes in pins:
            assert version(pin) and pin.url is None
            assert hashes and all(re.fullmatch(r"sha256:[0-9a-f]{64}", digest) for digest in hashes), pin
    assert not re.search(r"://|index-url|find-links|/", LOCKED.read_text())


def test_lock_holds_what_torch_needs_but_neither_torch_nor_cuda():
    lock = locked()
    for line in requires("torch"):
        needed = Requirement(line)
        if needed.marker is None or needed.marker.evaluate({"extra": ""}):
            pins = [version(pin) for pin, _ in lock[canonicalize_name(needed.name)]]
            assert pins and all(needed.specifier.contains(pin) for pin in pins), needed
    assert "torch" not in lock
    assert not [name for name in lock if name.startswith(("nvidia-", "cuda-", "triton"))]


def test_every_locked_package_finds_its_dependencies_in_the_lock():
    """Set-up resolves nothing (--no-deps), so a package that the lock lacks would be missing without a word."""
    lock = locked()
    for pin, _ in (pin for pins in lock.values() for pin in pins if is_for_here(pin[0])):
        for needed in map(Requirement, requires(pin.name) or []):
            name = canonicalize_name(needed.name)
            if name != "torch" and (needed.marker is None or needed.marker.evaluate({"extra": ""})):
                assert any(needed.specifier.contains(version(other)) for other, _ in lock.get(name, [])), (pin, needed)


def is_for_here(pin: Requirement) -> bool:
    return pin.marker is None or pin.marker.evaluate()


def test_pip_takes_the_lock_and_finds_this_environment_as_it_says():
    """pip itself, with the options of set-up and no index: rc 0 only where all is here in the versions of the lock."""
    options = ["--dry-run", "--no-index", "--disable-pip-version-check", "--quiet"]
    done = subprocess.run([sys.executable, "-m", "pip", "install", *options, *setup_environment.LOCKED],
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "--require-hashes" in setup_environment.LOCKED and str(LOCKED) in setup_environment.LOCKED


def test_lock_is_renewed_by_a_pinned_tool_and_says_how():
    assert re.fullmatch(r"uv==[\d.]+", lock.UV)
    assert "make lock" in LOCKED.read_text().splitlines()[1]


# --- where torch comes from ---


@pytest.fixture()
def pip_calls(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """The arguments of each call of pip, none of which finds anything; no torch is installed, on Linux."""
    calls: list[tuple[str, ...]] = []

    def pip(_: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        calls.append(arguments)
        return subprocess.CompletedProcess(arguments, 1, "", "WARNING: slow\nERROR: No matching distribution found")

    monkeypatch.setattr(setup_environment, "pip", pip)
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
    assert setup_environment.CPU_INDEX not in pip_calls[0] and setup_environment.CPU_INDEX in pip_calls[1]  # pip's own settings first


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


@pytest.mark.parametrize("there, calls", [
    ("2.13.0+cpu", 0), ("2.13.0+cu130", 0),  # another build of the pinned version was put there by its owner
    ("2.12.0+cpu", 2), ("2.13.0.1", 2), ("", 2),
])
def test_torch_of_the_pinned_version_is_left(pip_calls, monkeypatch, there, calls):
    monkeypatch.setattr(setup_environment, "installed_torch", lambda _: there)
    try:
        setup_environment.install_torch(Path("python"), "torch==2.13.0")
    except setup_environment.SetupError:
        pass
    assert len(pip_calls) == calls


def test_installed_torch_is_read_from_the_environment(tmp_path):
    assert setup_environment.installed_torch(Path(sys.executable)) == version_of("torch")
    empty = tmp_path / "python"
    empty.write_text(f"#!/bin/sh\nexec {sys.executable} -S -E \"$@\"\n")  # -S: no packages
    empty.chmod(0o755)
    assert setup_environment.installed_torch(empty) == ""


def test_torch_is_pinned():
    assert setup_environment.torch_pin(PYPROJECT) == "torch==2.13.0"
    for wrong in (["numpy"], ["torch>=2", "numpy"]):
        with pytest.raises(setup_environment.SetupError, match="one dependency torch==VERSION, found"):
            setup_environment.torch_pin({"project": {"dependencies": wrong}})


@pytest.mark.parametrize("stderr, expected", [
    ("WARNING: a\nERROR: first\nERROR: second\nhint", "ERROR: second"),
    ("WARNING: Retrying (Retry(total=4)) after connection broken\nERROR: No matching distribution found for rich",
     "the package index cannot be reached: ERROR: No matching distribution found for rich"),
    ("", "it said nothing"),
])
def test_pip_failure_is_told_in_one_line(stderr, expected):
    assert setup_environment.reason(stderr) == expected


def test_a_changed_download_is_refused(tmp_path):
    """A real wheel that is not the one the lock's hash was made of: pip refuses, nothing is installed."""
    wheel = tmp_path / "tampered-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("tampered-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: tampered\nVersion: 1.0\n")
        archive.writestr("tampered-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr("tampered-1.0.dist-info/RECORD", "")
    (tmp_path / "lock").write_text(f"tampered==1.0 --hash=sha256:{'0' * 64}\n")
    options = [*setup_environment.LOCKED[:-1], str(tmp_path / "lock"), "--no-index", "--find-links", str(tmp_path)]
    with pytest.raises(setup_environment.SetupError, match="DO NOT MATCH THE HASHES"):
        setup_environment.install(Path(sys.executable), *options, "--target", str(tmp_path / "target"))
    assert not (tmp_path / "target").exists()


# --- what is a library ---


def test_only_the_rasterizer_is_in_the_wheel_and_the_checkout_holds_all():
    settings = PYPROJECT["tool"]["scikit-build"]
    assert settings["wheel"]["packages"] == ["rasterizer"]
    assert "build-dir" not in settings  # a wheel's build would change the one that `make` keeps
    (override,) = settings["overrides"]
    assert override["wheel"]["packages"] == ["rasterizer", "datasets", "pipeline"]
    for state, taken in (("editable", True), ("metadata_editable", True), ("wheel", False), ("sdist", False)):
        assert bool(re.search(override["if"]["state"], state)) is taken


def test_the_library_needs_only_what_it_declares():
    group = {"rasterizer": {"library"}, "rasterizer/bench": {"library", "bench"}}
    packages_of = packages_distributions()
    for file in (ROOT / "rasterizer").rglob("*.py"):
        groups = group[file.parent.relative_to(ROOT).as_posix()]
        may = {needed.name for name in groups for needed in declared()[name]} | {"gaussians-4d"}
        modules = imported_modules(file)
        assert not modules & {"pipeline", "datasets", "fuzz", "tests"}, file
        assert {name.lower() for module in modules for name in packages_of.get(module, [])} <= may, file
    assert {needed.name for needed in declared()["library"]} == {"torch", "numpy"}


def test_version_and_licence_are_those_of_pyproject():
    project = PYPROJECT["project"]
    assert metadata("gaussians-4d")["Version"] == project["version"]
    assert metadata("gaussians-4d")["License-Expression"] == project["license"] == "Apache-2.0"
    assert "Apache License" in (ROOT / "LICENSE").read_text()
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])


def imported_modules(file: Path) -> set[str]:
    """Top-level names of what a Python file imports, at the top or later; relative imports left out."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            found.add(node.module.split(".")[0])
    return found


def test_every_imported_package_is_declared():
    names = {needed.name.lower() for group in declared().values() for needed in group}
    names |= {"omegaconf", "gaussians-4d"}  # a part of hydra-core's interface; this project itself
    packages_of = packages_distributions()
    for folder in ("rasterizer", "datasets", "pipeline", "tests"):
        for file in (ROOT / folder).rglob("*.py"):
            modules = imported_modules(file)
            packages = {name.lower() for module in modules for name in packages_of.get(module, [])}
            assert packages <= names, file.relative_to(ROOT)


def test_old_python_is_named_in_one_line():
    expected = r"expected 3\.11 or newer, found 3\.9\.2 .*PYTHON="
    with pytest.raises(setup_environment.SetupError, match=expected) as error:
        setup_environment.check_python((3, 9, 2))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("compiler, found", [
    ("no-such-compiler", "No such file"),
    ("false", "found .*false.*it failed"),
])
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
    for name in ("Makefile", "pyproject.toml", "requirements.lock", "CMakeLists.txt", "tools/setup_environment.py",
                 "rasterizer/src/module.cpp"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
        os.utime(tmp_path / name, (1000, 1000))
    for seconds, product in ((2000, ".venv/.installed"), (3000, "build/build.ninja"), (4000, "build/.built")):
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


@pytest.mark.parametrize("changed, installs", [
    ("rasterizer/src/module.cpp", False),
    ("pyproject.toml", True),
    ("requirements.lock", True),
])
def test_make_redoes_what_a_change_asks_for(set_up_copy, changed, installs):
    (set_up_copy / changed).touch()
    planned = make("-n", "build", cwd=set_up_copy)
    assert ("setup_environment.py" in planned) is installs
    assert "cmake --build build" in planned
