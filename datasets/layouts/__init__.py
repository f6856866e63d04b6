"""Readers of folders that other tools write. scene=auto says which layout a folder has (detect.py).

colmap.py             COLMAP: images/, sparse/0 (binary or text); colmap_files.py reads the files of sparse/0
nerfstudio.py         nerfstudio: transforms.json
dynamic_gaussians.py  Dynamic 3D Gaussians: train_meta.json, ims/
nerfies.py            Nerfies, HyperNeRF, DyCheck: dataset.json, camera/*.json, rgb/2x
llff.py               NVIDIA Dynamic Scenes: images/, poses_bounds.npy of one moving camera
photograph.py         what they share: an image file with its camera
file_names.py         which camera took it, and when, by names; selection.py: which are trained on and held out
image_size.py         all of one size; photographs.py: photographs → Scene
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from datasets.files.errors import SceneError
from datasets.layouts.photograph import LayoutOptions
from datasets.scene import Scene

__all__ = ["LayoutOptions", "read_layout"]


def read_layout(layout: str, path: Path, options: LayoutOptions) -> Scene:
    """The scene in folder `path`, whose layout is one of settings.LAYOUTS; SceneError if it does not follow it."""
    if not path.is_dir():
        raise SceneError(path, "a folder", "a file" if path.exists() else "nothing there")
    return _reader(layout)(path, options)


def _reader(layout: str) -> Callable[[Path, LayoutOptions], Scene]:
    if layout == "colmap":
        from datasets.layouts.colmap import read_colmap

        return read_colmap
    if layout == "nerfstudio":
        from datasets.layouts.nerfstudio import read_nerfstudio

        return read_nerfstudio
    if layout == "dynamic_gaussians":
        from datasets.layouts.dynamic_gaussians import read_dynamic_gaussians

        return read_dynamic_gaussians
    if layout == "nerfies":
        from datasets.layouts.nerfies import read_nerfies

        return read_nerfies
    from datasets.layouts.llff import read_llff

    return read_llff
