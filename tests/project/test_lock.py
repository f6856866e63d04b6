"""requirements.lock: it satisfies pyproject.toml, is complete, and pip holds every download against it."""

from __future__ import annotations

import re
import subprocess
import sys
import zipfile
from importlib.metadata import requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from project_file import ROOT, declared

sys.path.insert(0, str(ROOT / "tools"))

import lock as lock_tool  # noqa: E402
import setup_environment  # noqa: E402

LOCKED = ROOT / "requirements.lock"


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


def test_lock_satisfies_pyproject():
    lock = locked()
    groups = [group for name, group in declared().items() if name != "gpu"]  # which only `make gpu` installs
    for needed in (needed for group in groups for needed in group if needed.name != "torch"):
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
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, *setup_environment.locked(LOCKED)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "--require-hashes" in setup_environment.locked(LOCKED)


def test_lock_is_renewed_by_a_pinned_tool_and_says_how():
    assert re.fullmatch(r"uv==[\d.]+", lock_tool.UV)
    assert "make lock" in LOCKED.read_text().splitlines()[1]


def test_a_changed_download_is_refused(tmp_path):
    """A real wheel that is not the one the lock's hash was made of: pip refuses, nothing is installed."""
    wheel = tmp_path / "tampered-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("tampered-1.0.dist-info/METADATA", "Metadata-Version: 2.1\nName: tampered\nVersion: 1.0\n")
        archive.writestr("tampered-1.0.dist-info/WHEEL", "Wheel-Version: 1.0\nTag: py3-none-any\n")
        archive.writestr("tampered-1.0.dist-info/RECORD", "")
    (tmp_path / "lock").write_text(f"tampered==1.0 --hash=sha256:{'0' * 64}\n")
    options = [*setup_environment.locked(tmp_path / "lock"), "--no-index", "--find-links", str(tmp_path)]
    with pytest.raises(setup_environment.SetupError, match="DO NOT MATCH THE HASHES"):
        setup_environment.install(Path(sys.executable), *options, "--target", str(tmp_path / "target"))
    assert not (tmp_path / "target").exists()
