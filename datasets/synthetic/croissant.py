"""Croissant metadata (ML Commons, 1.0) of a synthetic scene: its files with their SHA-256, and its views as records."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from datasets.manifest import OWN

FILE = "croissant.json"
VERSION = "1.0.0"
_KINDS = {
    ".png": "image/png", ".json": "application/json", ".mp4": "video/mp4", ".npz": "application/zip",
    ".yaml": "application/yaml",
}  # fmt: skip
_CONTEXT = {
    "@language": "en", "@vocab": "https://schema.org/", "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/", "dct": "http://purl.org/dc/terms/", "conformsTo": "dct:conformsTo",
    "citeAs": "cr:citeAs", "column": "cr:column", "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"}, "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract", "field": "cr:field", "fileObject": "cr:fileObject", "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet", "format": "cr:format", "includes": "cr:includes", "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath", "key": "cr:key", "md5": "cr:md5", "parentField": "cr:parentField", "path": "cr:path",
    "recordSet": "cr:recordSet", "references": "cr:references", "regex": "cr:regex", "repeated": "cr:repeated",
    "replace": "cr:replace", "separator": "cr:separator", "source": "cr:source", "subField": "cr:subField",
    "transform": "cr:transform",
}  # fmt: skip
_FIELDS = {"file_path": ("sc:Text", "the image, without .png"), "time": ("sc:Float", "in [0, 1]")}


def write_croissant(folder: Path, scene: str) -> None:
    """croissant.json beside the scene's files. The same files give the same bytes."""
    (folder / FILE).write_text(json.dumps(croissant(folder, scene), indent=1) + "\n")


def croissant(folder: Path, scene: str) -> dict[str, Any]:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in (FILE, OWN))
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "name": f"synthetic_{scene}",
        "description": f"Synthetic scene {scene} of a benchmark of 4D Gaussian Splatting: traced images of one dynamic "
        "scene with exact cameras, times, motion and geometry.",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "license": "https://www.apache.org/licenses/LICENSE-2.0",
        "version": VERSION,
        "distribution": [_file_object(path, folder) for path in files],
        "recordSet": [_views(path) for path in files if path.name.startswith("transforms_")],
    }


def _file_object(path: Path, folder: Path) -> dict[str, str]:
    name = path.relative_to(folder).as_posix()
    return {
        "@type": "cr:FileObject",
        "@id": name,
        "name": name,
        "contentUrl": name,
        "contentSize": f"{path.stat().st_size} B",
        "encodingFormat": _KINDS.get(path.suffix, "application/octet-stream"),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }


def _views(path: Path) -> dict[str, Any]:
    """The views of a split, as its file of cameras lists them."""
    split = path.stem.removeprefix("transforms_")
    frames = json.loads(path.read_text())["frames"]
    fields = [
        {
            "@type": "cr:Field",
            "@id": f"{split}/{name}",
            "name": f"{split}/{name}",
            "description": about,
            "dataType": kind,
            "source": {"fileObject": {"@id": path.name}, "extract": {"jsonPath": f"$.frames[*].{name}"}},
        }
        for name, (kind, about) in _FIELDS.items()
        if frames and name in frames[0]
    ]
    about = f"the views of the split {split}"
    return {"@type": "cr:RecordSet", "@id": split, "name": split, "description": about, "field": fields}
