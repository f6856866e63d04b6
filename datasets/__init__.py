"""Data sets: one reader per layout on disk, each of which returns a `Scene`.

settings.py   the settings `scene.*`         kinds.py   which kind of scene they name
load.py       loads it with its reader       scene.py   Scene, View: what every reader returns
"""

from datasets.files.errors import SceneError
from datasets.kinds import SceneKind, scene_kind, with_reader
from datasets.load import load_clip, load_clip_set, load_footage, load_posed, load_scene
from datasets.scene import Scene, View, validate_scene

__all__ = [
    "Scene",
    "SceneError",
    "SceneKind",
    "View",
    "load_clip",
    "load_clip_set",
    "load_footage",
    "load_posed",
    "load_scene",
    "scene_kind",
    "validate_scene",
    "with_reader",
]
