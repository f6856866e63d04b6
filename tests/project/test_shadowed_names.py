"""Commands started in a folder, or with a path, that has packages of our names."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from project_file import PYPROJECT, ROOT

from gaussians_4d.__main__ import COMMANDS

THEIRS = "raise SystemExit('theirs')\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """With a package `datasets`, as Hugging Face's."""
    (tmp_path / "datasets").mkdir()
    (tmp_path / "datasets/__init__.py").write_text(THEIRS)
    return tmp_path


def run(folder: Path, *arguments: str, path: tuple[Path, ...] = (ROOT,)) -> tuple[int, str, str]:
    """(exit status, standard output, standard error) of a Python in the folder."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(map(str, path))}
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, timeout=60
    )
    return done.returncode, done.stdout, done.stderr


def test_a_package_called_datasets_does_not_hide_ours(folder: Path) -> None:
    for path in ((ROOT,), (folder, ROOT)):
        status, out, err = run(folder, "-m", "pipeline", "--version", path=path)
        assert (status, err) == (0, "") and out.startswith("gaussians-4d ")
        assert run(folder, "-m", "pipeline.export", "--help", path=path)[0] == 0
    assert run(folder, "-c", "import datasets.files")[0] == 1, "the test above would see it"


def test_a_pipeline_of_theirs_does_not_hide_the_commands_by_their_own_name(folder: Path) -> None:
    (folder / "pipeline.py").write_text(THEIRS)
    assert run(folder, "-m", "pipeline")[2] == "theirs\n", "nothing of ours is asked"
    status, out, err = run(folder, "-m", "gaussians_4d", "--version")
    assert (status, err) == (0, "") and out.startswith("gaussians-4d ")
    status, out, _ = run(folder, "-m", "gaussians_4d", "render", "--help")
    assert status == 0 and "Renders a run along a path" in out
    assert run(folder, "-m", "gaussians_4d", "scene=nothing")[2].startswith("error: scene=nothing: no such option")


def test_every_command_has_its_own_name() -> None:
    files = [file for pattern in ("*.py", "*/__main__.py") for file in (ROOT / "pipeline").glob(pattern)]
    found = {
        (file.parent if file.stem == "__main__" else file).stem for file in files if "\n@command\n" in file.read_text()
    }
    assert found == set(COMMANDS)


def test_the_console_script_is_that(folder: Path) -> None:
    (entry,) = PYPROJECT["project"]["scripts"].items()
    assert entry == ("gaussians-4d", "gaussians_4d.__main__:main")
    code = "from gaussians_4d.__main__ import main; import sys; sys.argv[1:] = ['--version']; main()"
    assert run(folder, "-c", code)[1].startswith("gaussians-4d ")


def test_theirs_imported_before_is_said(folder: Path) -> None:
    (folder / "datasets/__init__.py").write_text("")
    _, _, err = run(folder, "-c", "import datasets, pipeline.cli")
    assert err.splitlines()[-1].startswith(f"ImportError: datasets: expected {ROOT}/datasets, found {folder}/datasets")


def test_without_a_checkout_the_script_says_so(tmp_path: Path) -> None:
    (tmp_path / "gaussians_4d").symlink_to(ROOT / "gaussians_4d")
    # -S: an installed checkout would be found before the folder
    status, _, err = run(tmp_path, "-S", "-m", "gaussians_4d", path=())
    assert status == 1 and err.startswith("error: gaussians-4d: expected a checkout") and err.count("\n") == 1
