"""Protocols: what an evaluation measures on, by a name with a version; protocols/*.yaml has one file for each.

A run follows the protocol whose conditions are its own: size and background of its test images, and every setting of
`scene` that decides which images are held out and how they are made. Where none fits, its id is `unnamed-` and a hash
of its conditions. Numbers of two protocols are never averaged, compared or ranked together. A version is final: what
changes a number is a new version.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from datasets.files.errors import DataError
from datasets.scene import Scene
from datasets.settings import SceneConfig
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at

FOLDER = Path(__file__).with_name("protocols")
COLOURS = {"black": [0.0, 0.0, 0.0], "white": [1.0, 1.0, 1.0]}
UNRECORDED = "unrecorded"  # of a run older than protocols
# Settings of `scene` that decide the test images or, of synthetic scenes, the training images.
DECISIVE = (
    "test_split", "validation_every", "validation_outermost", "test_every", "test_cameras", "drop_cameras", "sync",
    "offsets", "color_correction", "first_frame", "frames", "log_cameras", "downscale", "seed", "size", "cameras",
    "train_views", "test_views", "camera_path",
)  # fmt: skip
_PSNR = {"image": "of the image", "channels": "mean of the channels' PSNRs"}
_ITERATION = {"final": "the last", "best_on_test": "the best on test"}


class MixedProtocols(ValueError):
    """Numbers of several protocols were to be averaged, compared or ranked together. One line."""


@dataclass(frozen=True)
class Protocol:
    """One file of protocols/. The defaults are what this program's evaluation does."""

    id: str
    title: str
    scenes: Mapping[str, Mapping[str, Any] | None]  # name, or `family/*` -> settings that differ on it
    images: str  # how the true images are made
    literature: bool = False  # of others' numbers: no run of this program follows it
    size: list[int] | None = None  # [width, height] in pixels; None: that of the files
    background: str | None = None  # black | white; None: not stated
    test_views: int | None = None  # of a scene; None: not fixed
    settings: Mapping[str, Any] = field(default_factory=dict)  # of `scene`, where they are not the defaults
    psnr: str = "image"  # image: of the whole image | channels: mean of the three channels' PSNRs | not stated
    ssim: str = "11 × 11 Gaussian window, σ = 1.5, windows inside the image"
    colours: str = "the files' values / 255"
    iteration: str = "final"  # final: the last one | best_on_test | not stated
    note: str = ""

    def covers(self, scene: str) -> bool:
        return any(fnmatchcase(scene, pattern) for pattern in self.scenes)

    def fits(self, scene: str, found: Mapping[str, Any]) -> bool:
        """Whether a run on `scene` with these `conditions` follows the protocol."""
        if self.literature or not self.covers(scene):
            return False
        fixed = {"size_px": self.size, "test_views_found": self.test_views}
        wanted = {**self.settings, **(self.scenes.get(scene) or {}), "background": COLOURS[self.background or "black"]}
        wanted |= {key: value for key, value in fixed.items() if value is not None}
        return wanted == {key: value for key, value in found.items() if fixed.get(key, value) is not None}

    @property
    def words(self) -> str:
        """One line on what its numbers are."""
        size = f"{self.size[0]} × {self.size[1]}, " if self.size else ""
        psnr, iteration = _PSNR.get(self.psnr, self.psnr), _ITERATION.get(self.iteration, self.iteration)
        line = f"{self.title}; images: {size}{self.images}; PSNR: {psnr}; iteration: {iteration}."
        return f"{line} {self.note}".strip()


@cache
def protocols() -> dict[str, Protocol]:
    """All by their ids. DataError, one line, for a file with an unknown or missing key."""
    return {path.stem: _read(path) for path in sorted(FOLDER.glob("*.yaml"))}


def _read(path: Path) -> Protocol:
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    known = {one.name for one in fields(Protocol)} - {"id"}
    if unknown := sorted(set(tree) - known):
        raise DataError(path, f"the keys {', '.join(sorted(known))}", ", ".join(unknown))
    if missing := sorted({"title", "scenes", "images"} - set(tree)):
        raise DataError(path, f"a value of {', '.join(missing)}", "none")
    return Protocol(path.stem, **tree)


def conditions(cfg: Config, scene: Scene) -> dict[str, Any]:
    """Of a run's test images, as protocols compare them: size, background, number, and settings that are no defaults.

    cfg: settled.
    """
    settings, usual, scale = asdict(cfg.scene), asdict(SceneConfig()), cfg.train.resolution_scale
    found: dict[str, Any] = {key: settings[key] for key in DECISIVE if settings[key] != usual[key]}
    found |= {} if scale == 1 else {"resolution_scale": scale}
    camera, background = camera_at(scene.test[0].camera, scale), list(map(float, scene.background))
    size = [camera.width, camera.height]
    return found | {"size_px": size, "background": background, "test_views_found": len(scene.test)}


def protocol_of(scene: str, found: Mapping[str, Any]) -> str:
    """The id of the protocol with these conditions; `unnamed-…`, by a hash of them, where no file has them."""
    for one in protocols().values():
        if one.fits(scene, found):
            return one.id
    text = json.dumps({key: value for key, value in found.items() if key != "test_views_found"}, sort_keys=True)
    return f"unnamed-{hashlib.blake2b(text.encode(), digest_size=4).hexdigest()}"


def measured_by(cfg: Config, scene: Scene, lpips_weights: Mapping[str, str]) -> dict[str, Any]:
    """What metrics.json says of its numbers: protocol, conditions, and the weights of LPIPS by SHA-256."""
    found = conditions(cfg, scene)
    return {"protocol": protocol_of(cfg.scene.name, found), "conditions": found, "lpips_weights": dict(lpips_weights)}


def one_protocol(ids: Iterable[str], what: str) -> str:
    """The protocol that all of `ids` are. MixedProtocols if there are several."""
    found = sorted(set(ids))
    if len(found) != 1:
        raise MixedProtocols(
            f"{what}: expected rows of one protocol, found {' and '.join(found)}, whose images or measures differ "
            "(docs/protocols.md)"
        )
    return found[0]


def in_words(protocol: str) -> str:
    """A line on a protocol, for the notes of a table."""
    if protocol == UNRECORDED:
        return f"{protocol}: the run is older than protocols; its conditions are not known."
    if protocol not in protocols():
        return f"{protocol}: not a protocol of docs/protocols.md; the conditions are in metrics.json."
    return f"{protocol}: {protocols()[protocol].words}"
