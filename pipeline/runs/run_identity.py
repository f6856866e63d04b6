"""Which run a folder holds, by its config.yaml and stages.json; checked before anything in it is changed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf

from datasets.files.atomic_write import TEMPORARY
from datasets.files.claim import HIDDEN
from datasets.files.errors import DataError, clear, read_json

# Keys that do not change what a run computes: a finished run may be repeated with others.
# The data have a hash of their own, wherever they lie.
FREE_KEYS = ("out", "threads", "resume", "until", "only", "scene.path", "scene.cache", "evaluate", "estimate", "view",
             "view_at")  # fmt: skip
FILES = {  # by their names in the program
    "config": "config.yaml",
    "provenance": "environment.json",
    "stages": "stages.json",
    "log_file": "log.jsonl",
    "sfm": "sfm.json",
    "sfm_picture": "sfm.png",
    "canonical": "canonical.json",
    "scene": "scene.json",
    "init_ply": "init.ply",
    "checkpoint": "checkpoint.safetensors",
    "curve": "error_vs_time.csv",
    "metrics": "metrics.json",
    "per_image": "per_image.csv",
    "renders": "renders",
    "exports": "exports",
    "figures": "figures",
    "films": "films",
    "viewer": "viewer.html",
}
UNFINISHED = tuple(f"{TEMPORARY}{name}" for name in FILES.values())  # left behind by a killed run
_GROUPS = ("scene", "train", "seed")  # of every run's config.yaml


def refuse_foreign(path: Path) -> None:
    """ValueError where `path` holds files that no run made: a run must not overwrite another folder."""
    if not path.exists():
        return
    if not path.is_dir():
        raise ValueError(f"{path}: expected a run folder or nothing, found a file; give another out=DIR")
    names = (entry.name for entry in path.iterdir())
    entries = sorted(name for name in names if name not in UNFINISHED and not name.startswith(HIDDEN))
    strange = [name for name in entries if name not in FILES.values()]
    if entries and not _is_run(path):
        found = (strange or entries)[0]
        raise ValueError(
            f"{path}: expected a run folder or an empty one, found {found}, which no run of this program "
            "made; give another out=DIR"
        )


def refuse_other_run(path: Path, config: dict, ignored: tuple[str, ...] = ()) -> None:
    """ValueError where `path` holds a run of other settings than `config`. ignored: keys, or groups of keys."""
    if not (path / "config.yaml").exists() or not read_stages(path):
        return  # nothing was made yet: a run that failed over a wrong path may be corrected
    free = (*FREE_KEYS, *ignored)
    stored, wanted = flat(read_config(path / "config.yaml"), free), flat(config, free)
    differing = [key for key in {**stored, **wanted} if stored.get(key) != wanted.get(key)]
    if differing:
        first = differing[0]
        others = clear(", ".join(differing[1:4])) + (", …" if len(differing) > 4 else "")
        more = f" (and {others})" if differing[1:] else ""
        # the folder of the data, which names the scene, was renamed
        renamed = (
            f"{clear('scene.name=' + stored['scene.name'])} continues it; or "
            if differing == ["scene.name"] and "scene.name" in stored
            else ""
        )
        raise ValueError(
            f"{path}: holds another run, with {clear(f'{first}={stored.get(first)}')} but this "
            f"command has {wanted.get(first)}{more}; {renamed}give another out=DIR, or resume=false to "
            "replace it"
        )


def read_stages(path: Path) -> dict:
    """Of a run folder: stage -> its record (RunFolder.finish), without "values" where it was only begun; empty where
    none was."""
    path = path / "stages.json"
    if not path.exists():
        return {}
    stages = read_json(path)
    if not isinstance(stages, dict) or not all(map(_is_record, stages.values())):
        raise DataError(path, "a record of each stage", "something else; resume=false starts the run anew")
    return stages


def _is_record(record: Any) -> bool:
    if not isinstance(record, dict) or not isinstance(record.get("inputs"), dict):
        return False
    finished = (record.get("values"), dict), (record.get("outputs"), list), (record.get("commit"), str)
    return "values" not in record or all(isinstance(value, kind) for value, kind in finished)


def read_config(path: Path, where: str | None = None) -> dict:
    """config.yaml as plain dicts. DataError, which names `where` (None: the path), for what is no such file."""
    try:
        text = path.read_text(encoding="utf-8")
        # No run writes aliases (*name); a few lines of them can make a tree that fills the memory.
        if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            raise ValueError("an alias")
        tree: Any = OmegaConf.to_container(OmegaConf.create(text), resolve=False)
    except Exception as error:  # yaml and OmegaConf raise unrelated types for unreadable files
        raise DataError(where or path, "YAML", str(error)) from None
    if not isinstance(tree, dict):
        raise DataError(where or path, "keys and values", f"a {type(tree).__name__}")
    return tree


def _is_run(path: Path) -> bool:
    """Whether the folder is a run folder of this program, by its config.yaml or, if that is damaged, stages.json."""
    try:
        return set(_GROUPS) <= set(read_config(path / "config.yaml"))
    except DataError:
        return (path / "stages.json").exists()


def flat(config: dict, free: tuple[str, ...] = (), prefix: str = "") -> dict[str, Any]:
    """Dotted key -> value, without those that are `free`."""
    found: dict[str, Any] = {}
    for name, value in config.items():
        key = f"{prefix}{name}"
        if key in free:
            continue
        found |= flat(value, free, f"{key}.") if isinstance(value, dict) else {key: value}
    return found
