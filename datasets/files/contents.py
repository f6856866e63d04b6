"""What a path holds, in the words of an error: of a folder or a file that is not what was expected."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from datasets.files.errors import SceneError

ARCHIVES = (".zip", ".tar", ".gz", ".tgz", ".xz", ".bz2", ".zst", ".7z", ".rar")
# FFmpeg takes any text for a video of a terminal.
NO_VIDEOS = (".json", ".txt", ".csv", ".yaml", ".yml", ".xml", ".md", ".bin", ".db", ".npy", ".npz", ".ply", ".pth",
             ".safetensors")  # fmt: skip
WAYS_OUT = {".heic": "convert it to .jpg", ".heif": "convert it to .jpg", ".avif": "convert it to .jpg"}
KINDS = 3  # of files that are named


def contents(folder: Path) -> str:
    """`2 .heic (convert it to .jpg), 1 folder`: the most frequent kinds of files in a folder."""
    entries = [path for path in sorted(folder.iterdir()) if not path.name.startswith(".")]
    kinds = Counter(path.suffix.lower() or "without a suffix" for path in entries if not path.is_dir())
    folders = sum(path.is_dir() for path in entries)
    parts = [f"{count} {kind}{_way_out(kind)}" for kind, count in kinds.most_common(KINDS)]
    parts += ["…"] * (len(kinds) > KINDS) + [f"{folders} folder{'s' * (folders > 1)}"] * (folders > 0)
    return ", ".join(parts) or "nothing"


def _way_out(suffix: str) -> str:
    if suffix in ARCHIVES:
        return " (unpack it)"
    return f" ({WAYS_OUT[suffix]})" if suffix in WAYS_OUT else ""


def refuse_no_video(path: Path, hint: str = "") -> None:
    """SceneError for a file that is no video by its suffix. hint: where the data may be."""
    suffix = path.suffix.lower()
    if suffix in ARCHIVES:
        raise SceneError(path, "a folder, or a video", "an archive; unpack it, and give its folder")
    if suffix in NO_VIDEOS:
        raise SceneError(path, f"the folder of the data{hint or f', {path.parent}'}", f"a {suffix} file in it")
