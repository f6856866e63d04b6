"""Data sets: one reader per layout on disk. Opened it is a `Source`, which gives a `Scene`.

settings.py   the settings `scene.*`                  scene.py   Scene, View: what every reader returns
source.py     opens the data that the settings name   readers/   a module a layout
"""

from datasets.files.errors import SceneError
from datasets.scene import Scene, View, validate_scene
from datasets.source import Source, open_source

__all__ = ["Scene", "SceneError", "Source", "View", "open_source", "validate_scene"]
