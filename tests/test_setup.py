"""The set-up: where torch is taken from, given recorded plans; what make does, and what it leaves alone."""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tools"))

import setup_environment  # noqa: E402
from torch_source import CPU_INDEX, choose_torch_source, has_nvidia_gpu, read_plan  # noqa: E402

# pip 26.3's plans for torch==2.13.0 on Linux x86-64, shortened: from the default index, and from a CPU wheel.
CUDA_PLAN = [
    ("torch", "2.13.0"), ("typing_extensions", "4.16.0"), ("cuda-toolkit", "13.0.3.0"),
    ("nvidia-cublas", "13.1.1.3"), ("nvidia-cudnn-cu13", "9.20.0.48"), ("triton", "3.7.1"),
    ("cuda-bindings", "13.5.0"), ("MarkupSafe", "3.0.4"),
]
CPU_PLAN = [("torch", "2.13.0+cpu"), ("typing_extensions", "4.16.0"), ("MarkupSafe", "3.0.4")]


def report(packages: list[tuple[str, str]]) -> dict:
    """pip's installation report, as far as the set-up reads it."""
    return {"version": "1", "install": [
        {"metadata": {"name": name, "version": version},
         "download_info": {"url": f"https://index.example/{name}-{version}.whl"}}
        for name, version in packages]}


def test_plan_is_read_with_normalised_names():
    plan = read_plan(report([("Typing_Extensions", "4.16.0"), ("zope.interface", "7.0")]))
    assert [p.name for p in plan] == ["typing-extensions", "zope-interface"]
    assert plan[0].url == "https://index.example/Typing_Extensions-4.16.0.whl"


def test_cuda_plan_without_gpu_takes_the_cpu_index():
    source = choose_torch_source(read_plan(report(CUDA_PLAN)), has_gpu=False)
    assert source.index == CPU_INDEX == "https://download.pytorch.org/whl/cpu"
    assert [p.name for p in source.cuda] == [
        "cuda-toolkit", "nvidia-cublas", "nvidia-cudnn-cu13", "triton", "cuda-bindings"]


@pytest.mark.parametrize("packages, has_gpu", [
    (CUDA_PLAN, True),  # the GPU's owner gets what the index serves
    (CPU_PLAN, False),  # no CUDA in the plan: nothing to avoid
    ([], False),  # everything installed already
])
def test_otherwise_the_configured_index_stays(packages, has_gpu):
    assert choose_torch_source(read_plan(report(packages)), has_gpu).index is None


def test_gpu_is_found_by_device_driver_or_nvidia_smi(tmp_path):
    programs = tmp_path / "bin"
    programs.mkdir()

    def found(root: Path = tmp_path) -> bool:
        return has_nvidia_gpu(root, str(programs))

    assert not found()
    smi = programs / "nvidia-smi"
    for status, expected in ((9, False), (0, True)):  # it fails where the program is installed but no device
        smi.write_text(f"#!/bin/sh\nexit {status}\n")
        smi.chmod(0o755)
        assert found() is expected
    smi.unlink()
    (tmp_path / "dev").mkdir()
    (tmp_path / "dev/nvidia0").touch()
    assert found()


def test_torch_is_pinned_and_the_build_tools_are_installed():
    needed = setup_environment.requirements(tomllib.loads((ROOT / "pyproject.toml").read_text()))
    assert setup_environment.torch_requirement(needed) == "torch==2.13.0"
    assert {"nanobind", "pytest"} <= {requirement.split(">=")[0] for requirement in needed}
    with pytest.raises(setup_environment.SetupError, match=r"one dependency torch==VERSION, found \[\]"):
        setup_environment.torch_requirement(["torch>=2", "numpy"])


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
    needed = setup_environment.requirements(tomllib.loads((ROOT / "pyproject.toml").read_text()))
    declared = {requirement.split(">")[0].split("=")[0].lower() for requirement in needed}
    declared |= {"omegaconf", "gaussians-4d"}  # a part of hydra-core's interface; this project itself
    packages_of = packages_distributions()
    for folder in ("rasterizer", "datasets", "pipeline", "tests"):
        for file in (ROOT / folder).rglob("*.py"):
            modules = imported_modules(file)
            packages = {name.lower() for module in modules for name in packages_of.get(module, [])}
            assert packages <= declared, file.relative_to(ROOT)


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


def test_unreachable_cpu_index_says_what_was_avoided_and_the_way_out(monkeypatch):
    plan = read_plan(report(CUDA_PLAN))

    def unreachable(*_: object) -> list:
        raise setup_environment.SetupError("pip has no plan: ERROR: No matching distribution found for torch")

    monkeypatch.setattr(setup_environment, "plan_of", unreachable)
    with pytest.raises(setup_environment.SetupError) as error:
        setup_environment.install_cpu_torch(
            Path("python"), "torch==2.13.0", choose_torch_source(plan, has_gpu=False), plan)
    assert "\n" not in str(error.value)
    for part in ("5 CUDA packages", CPU_INDEX, "No matching distribution", "PIP_FIND_LINKS="):
        assert part in str(error.value)


def test_cpu_torch_is_installed_from_its_index_with_the_size_saved(monkeypatch, capsys):
    plan, calls = read_plan(report(CUDA_PLAN)), []
    size = {"torch": 0.5e9, "triton": 0.2e9}  # bytes of a CUDA package; what is not here weighs 1 GB
    monkeypatch.setattr(setup_environment, "plan_of", lambda *_: read_plan(report(CPU_PLAN)))
    monkeypatch.setattr(setup_environment, "install", lambda _, *arguments: calls.append(arguments))
    monkeypatch.setattr(setup_environment, "download_size", lambda packages: sum(
        0.2e9 if p.version.endswith("+cpu") else size.get(p.name, 1e9) for p in packages))
    source = choose_torch_source(plan, has_gpu=False)
    setup_environment.install_cpu_torch(Path("python"), "torch==2.13.0", source, plan)
    assert calls == [("torch==2.13.0", "--index-url", CPU_INDEX)]
    assert "4.5 GB less" in capsys.readouterr().out  # 4 × 1 + 0.2 + 0.5 - 0.2


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
    for name in ("Makefile", "pyproject.toml", "CMakeLists.txt", "tools/setup_environment.py",
                 "tools/torch_source.py", "rasterizer/src/module.cpp"):
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
    assert {"reproduce", "test", "setup", "build", "bench", "report", "clean"} <= listed


def test_second_make_installs_and_builds_nothing(set_up_copy):
    assert make("-n", "test", cwd=set_up_copy).split() == [".venv/bin/python", "-m", "pytest"]


@pytest.mark.parametrize("changed, installs", [
    ("rasterizer/src/module.cpp", False),
    ("pyproject.toml", True),
])
def test_make_redoes_what_a_change_asks_for(set_up_copy, changed, installs):
    (set_up_copy / changed).touch()
    planned = make("-n", "build", cwd=set_up_copy)
    assert ("setup_environment.py" in planned) is installs
    assert "cmake --build build" in planned


def test_ci_runs_make_test():
    script = ROOT / ".ci/run"
    assert os.access(script, os.X_OK)
    assert script.read_text().rstrip().endswith("make test")
