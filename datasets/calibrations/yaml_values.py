"""The values of a YAML file, OpenCV's (FileStorage) or another: matrices are `{rows, cols, data}` in both."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from datasets.files.errors import SceneError

HEADER = "%YAML:1.0"  # OpenCV's, which is no YAML


class _Loader(yaml.SafeLoader):
    """Reads OpenCV's tagged matrices as plain mappings."""


for _tag in ("tag:yaml.org,2002:opencv-matrix", "tag:yaml.org,2002:opencv-nd-matrix"):
    _Loader.add_constructor(_tag, lambda loader, node: loader.construct_mapping(node, deep=True))


def load(path: Path) -> dict[str, Any]:
    """The mapping of the file; SceneError where it is none."""
    try:
        text = path.read_text(encoding="utf-8-sig")
        content = yaml.load(text.replace(HEADER, "", 1), _Loader)  # noqa: S506 (a SafeLoader)
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise SceneError(path, "YAML", str(error)) from None
    if not isinstance(content, dict):
        raise SceneError(path, "YAML of keys and values", type(content).__name__)
    return {str(key): value for key, value in content.items()}


def matrix(value: Any) -> Any:
    """Nested lists of a matrix that is stored with `data`; other values as they are."""
    if not isinstance(value, dict) or "data" not in value:
        return value
    rows, cols, data = value.get("rows"), value.get("cols"), value["data"]
    if isinstance(rows, int) and isinstance(cols, int) and isinstance(data, list) and len(data) == rows * cols:
        return np.array(data, dtype=object).reshape(rows, cols).tolist()
    return data
