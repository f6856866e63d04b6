"""The reader of a calibration, by the kind of the file or folder that scene.calibration names."""

from __future__ import annotations

from pathlib import Path

from datasets.calibrations import colmap_model, matlab, opencv_storage, qualisys, ros_camera_info, toml_tables
from datasets.calibrations.rig import Rig
from datasets.calibrations.yaml_values import load
from datasets.files.contents import contents
from datasets.files.errors import SceneError
from datasets.files.natural_order import natural_order

YAML = (".yaml", ".yml")
KNOWN = (
    "a calibration: .toml (anipose, caliscope, Pose2Sim), .yaml (OpenCV, ROS camera_info), .qca.txt (Qualisys), "
    ".mat (MATLAB, DANNCE), a folder of such .yaml, or COLMAP's sparse/0"
)


def read_calibration(path: Path) -> Rig:
    """The cameras in `path`. SceneError for a file that is none, and for cameras of one name."""
    rig = _read(path)
    names = [camera.name for camera in rig.cameras]
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise SceneError(path, "one name a camera", f"several called {twice}")
    return rig


def _read(path: Path) -> Rig:
    suffix = path.suffix.lower()
    if path.is_dir():
        if colmap_model.images_file(path):
            return colmap_model.read(path)
        files = sorted((p for p in path.iterdir() if p.suffix.lower() in YAML), key=lambda p: natural_order(p.name))
        if not files:
            raise SceneError(path, KNOWN, f"a folder with {contents(path)}")
        return _yaml(files)
    if not path.is_file():
        raise SceneError(path, KNOWN, "nothing there")
    if suffix in (".bin", ".txt") and path.stem in ("images", "cameras"):
        return colmap_model.read(path.parent)
    if suffix in YAML:
        pair = [path.with_name(f"{stem}{path.suffix}") for stem in ("intri", "extri")]
        return _yaml(pair if path in pair and all(p.is_file() for p in pair) else [path])
    if suffix == ".toml":
        return toml_tables.read(path)
    if suffix == ".mat":
        return matlab.read(path)
    if path.name.lower().endswith((".qca.txt", ".qca", ".qca.xml")):
        return qualisys.read(path)
    raise SceneError(path, KNOWN, f"a {suffix or 'file without a suffix'}")


def _yaml(files: list[Path]) -> Rig:
    content = {path: load(path) for path in files}
    if all(ros_camera_info.is_camera_info(values) for values in content.values()):
        return ros_camera_info.rig(content)
    return opencv_storage.rig(content)
