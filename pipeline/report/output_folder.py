"""Writes the files of a report and removes those of the previous report, and nothing else, from the output folder.

report_files.txt lists the written files.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fnmatch import fnmatchcase
from pathlib import Path

LIST = "report_files.txt"
_LIST_MARK = "# Written by python -m pipeline.report, which removes these files when it writes the next report here."
_NAMES = ("tables/*.md", "tables/*.csv", "tables/*.tex", "plots/*.svg", "strips/*.webp", "report.md", "*.html",
          "viewers/*.html", "nerfbaselines/*.json", "films/*.mp4")  # fmt: skip


def replace_report(out: Path, files: Mapping[str, bytes]) -> None:
    """Write `files` (path below `out` -> content) and remove the files of an earlier report.

    ValueError, before anything is changed, where a file that no report wrote would be overwritten. If interrupted, the
    list names all files that may have been written.
    """
    before = _of_earlier_report(out)
    for name in (*files, LIST):
        _refuse_foreign(out, name, before)
    _write_list(out, before | files.keys())
    for name in before:
        (out / name).unlink(missing_ok=True)
    for name, content in files.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    _write_list(out, files)
    for folder in {(out / name).parent for name in before - files.keys()} - {out}:
        if folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()


def _of_earlier_report(out: Path) -> set[str]:
    """Existing files of an earlier report, as paths below `out`."""
    if not _is_list(out / LIST):
        return set()
    # The list may have been edited: only names that a report writes are accepted.
    names = filter(_is_ours, (out / LIST).read_text(encoding="utf-8", errors="replace").splitlines())
    return {name for name in names if (out / name).is_file() or (out / name).is_symlink()}


def _is_ours(name: str) -> bool:
    """Whether a report writes files of that name."""
    return ".." not in name.split("/") and any(
        name.count("/") == pattern.count("/") and fnmatchcase(name, pattern) for pattern in _NAMES
    )


def _refuse_foreign(out: Path, name: str, before: Iterable[str]) -> None:
    path = out / name
    for folder in path.parents[: len(path.relative_to(out).parts)]:
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder}: expected a folder or nothing, found a file; give another --out")
    ours = name in before or (name == LIST and _is_list(path))
    if not ours and (path.exists() or path.is_symlink()):
        raise ValueError(
            f"{path}: expected nothing or what an earlier report wrote, found another file; give another --out"
        )


def _write_list(out: Path, names: Iterable[str]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    (out / LIST).write_text("\n".join([_LIST_MARK, *sorted(names), ""]), encoding="utf-8")


def _is_list(path: Path) -> bool:
    return path.is_file() and path.read_text(encoding="utf-8", errors="replace").startswith(_LIST_MARK)
