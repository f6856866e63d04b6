"""A pack: a zip with what a run rendered of each test view, to the bit, so that anyone can measure it again.

    pack.json              SHA-256 of the checkpoint, and of each view's true image
    metrics.json  config.yaml  environment.json  per_image.csv
    renders/0000_VIEW.png  8 bits, to look at
    exact/0000_image.npy   (3, H, W) float32; with ground truth or LiDAR beside it 0000_depth.npy and 0000_flow.npy

The same run makes the same bytes.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from datasets.files.errors import DataError, clear
from datasets.ground_truth import GroundTruth
from datasets.scene import Scene, View
from pipeline.data.training_views import Target
from pipeline.evaluation.evaluate import Render, Rendered
from pipeline.evaluation.image_metrics import Geometry

FORMAT = 1
FILES = ("metrics.json", "config.yaml", "environment.json", "per_image.csv")
LARGEST_TEXT = 64 * 2**20  # bytes of pack.json and metrics.json
HEADER = 1024  # bytes of an .npy file beside its numbers, at most
# Sums over the same floats differ by their order, which an instruction set decides: float32 has 2⁻²⁴ a step.
TOLERANCE = 1e-5


def truth_hash(view: View) -> str:
    """SHA-256 of a test view's pixels, 8 bits as they were read, and where it has them of its alpha and mask."""
    digest = hashlib.sha256()
    for plane in (view.image, view.coverage, view.mask):
        if plane is not None:
            pixels = np.ascontiguousarray(plane)
            digest.update(repr((pixels.shape, str(pixels.dtype))).encode())
            digest.update(pixels.data)
    return digest.hexdigest()


class PackWriter:
    """Writes what is rendered; `render` is the same as that of the model."""

    def __init__(self, file: zipfile.ZipFile, scene: Scene, model: Render) -> None:
        self._file, self._scene, self._model = file, scene, model
        self._views: list[dict[str, Any]] = [{} for _ in scene.test]

    def render(self, index: int, target: Target, known: GroundTruth | None, lidar: np.ndarray | None) -> Rendered:
        found, name = self._model(index, target, known, lidar), self._scene.test[index].name
        parts: dict[str, np.ndarray] = {"image": np.ascontiguousarray(found.image.transpose(2, 0, 1))}
        if found.geometry is not None:
            parts["depth"] = found.geometry.depth
            parts |= {} if found.geometry.flow is None else {"flow": found.geometry.flow}
        for part, values in parts.items():
            self._write(f"exact/{index:04d}_{part}.npy", _npy(values))
        self._write(f"renders/{index:04d}_{name.replace('/', '_')}.png", _png(found.image))
        self._views[index] = {
            "view": name, "truth_sha256": truth_hash(self._scene.test[index]), "n_alive": found.n_alive,
            "parts": list(parts),
        }  # fmt: skip
        return found

    def finish(self, run: Path, checkpoint: Path) -> None:
        """Adds the run's own files, and the list of views."""
        for name in FILES:
            if (run / name).is_file():
                self._write(name, (run / name).read_bytes())
        with open(checkpoint, "rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        content = {"format": FORMAT, "checkpoint_sha256": digest, "views": self._views}
        self._write("pack.json", (json.dumps(content, indent=1) + "\n").encode())

    def _write(self, name: str, content: bytes) -> None:
        entry = zipfile.ZipInfo(name)  # without the time
        entry.compress_type = zipfile.ZIP_STORED if name.endswith(".png") else zipfile.ZIP_DEFLATED
        self._file.writestr(entry, content)


class Pack:
    """An open pack. DataError, one line, for any file that is none."""

    def __init__(self, path: Path, file: zipfile.ZipFile) -> None:
        self.path, self._file = path, file
        pack = self._json("pack.json")
        if pack.get("format") != FORMAT:
            raise DataError(f"{path}: pack.json", f"format {FORMAT}", f"{pack.get('format')!r}")
        self.metrics = self._json("metrics.json")
        try:
            self._views = {str(row["view"]): (place, row) for place, row in enumerate(pack["views"])}
            self.final: dict[str, Any] = dict(self.metrics["final"])
            self.conditions: dict[str, Any] = dict(self.metrics["conditions"])
            self.protocol = str(self.metrics["protocol"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(path, "views, and metrics with a protocol", f"something else ({error!r})") from None

    def refuse_other_truth(self, scene: Scene) -> None:
        """DataError, one line, where a test view is another than the one that was packed."""
        if (names := [view.name for view in scene.test]) != list(self._views):
            other = next((n for n in (*names, *self._views) if n not in self._views or n not in names), "another order")
            raise DataError(self.path, f"the {len(names)} test views of {scene.source}", f"{len(self._views)}: {other}")
        for view in scene.test:
            packed, found = self._views[view.name][1].get("truth_sha256"), truth_hash(view)
            if packed != found:
                raise DataError(
                    f"{scene.source}: {view.name}",
                    f"the true image that was packed (SHA-256 {clear(packed)[:12]}…)",
                    f"another one ({found[:12]}…): the data were altered, or read otherwise",
                )

    def render(self, index: int, target: Target, known: GroundTruth | None, lidar: np.ndarray | None) -> Rendered:
        place, row = self._views[target.name]
        size = (target.camera.height, target.camera.width)
        image = self._array(place, "image", (3, *size)).transpose(1, 2, 0)
        if not (np.abs(image - 0.5) <= 0.5).all():  # nor NaN
            raise DataError(f"{self.path}: {target.name}", "pixels in [0, 1]", "others")
        if not np.array_equal(self._pixels(f"renders/{place:04d}_{target.name.replace('/', '_')}.png"), _bytes(image)):
            raise DataError(f"{self.path}: {target.name}", "a PNG of the exact image", "another picture")
        parts, geometry = row.get("parts", ()), None
        if "depth" in parts:
            flow = self._array(place, "flow", (2, *size)) if "flow" in parts else None
            geometry = Geometry(self._array(place, "depth", size), flow)
        return Rendered(image, row.get("n_alive"), geometry)

    def _array(self, place: int, part: str, shape: tuple[int, ...]) -> np.ndarray:
        name = f"exact/{place:04d}_{part}.npy"
        content = self._content(name, 4 * math.prod(shape) + HEADER)
        try:
            values = np.load(io.BytesIO(content), allow_pickle=False)
        except (ValueError, EOFError, OSError) as error:
            raise DataError(f"{self.path}: {name}", "an array", str(error)) from None
        if values.shape != shape or values.dtype != np.float32:
            raise DataError(f"{self.path}: {name}", f"{shape} float32", f"{values.shape} {values.dtype}")
        return values

    def _pixels(self, name: str) -> np.ndarray:
        try:
            with Image.open(io.BytesIO(self._content(name, LARGEST_TEXT))) as image:
                return np.asarray(image)
        except DataError:
            raise
        except Exception as error:  # PIL raises many types for broken files
            raise DataError(f"{self.path}: {name}", "a readable image", str(error)) from None

    def _json(self, name: str) -> dict[str, Any]:
        try:
            found = json.loads(self._content(name, LARGEST_TEXT))
        except (ValueError, RecursionError) as error:
            raise (
                error if isinstance(error, DataError) else DataError(self.path, f"JSON in {name}", str(error))
            ) from None
        if not isinstance(found, dict):
            raise DataError(f"{self.path}: {name}", "an object", type(found).__name__)
        return found

    def _content(self, name: str, largest: int) -> bytes:
        try:
            if (size := self._file.getinfo(name).file_size) > largest:
                raise DataError(f"{self.path}: {name}", f"at most {largest} bytes", f"{size}")
            return self._file.read(name)
        except KeyError:
            raise DataError(self.path, f"a pack (python -m pipeline.pack) with {name}", "none") from None
        except (zipfile.BadZipFile, OSError, EOFError, NotImplementedError, RuntimeError) as error:
            raise DataError(f"{self.path}: {name}", "a file that is whole", str(error)) from None


@contextmanager
def opened(path: Path) -> Iterator[Pack]:
    try:
        file = zipfile.ZipFile(path)
    except zipfile.BadZipFile as error:
        raise DataError(path, "a folder of PNG files or a zip of pipeline.pack", str(error)) from None
    with file:
        yield Pack(path, file)


def differing(packed: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """The metrics that are numbers in both and not the same, worst first: `psnr: 30.1 packed, 30.2 found`."""
    both = {
        key: (float(packed[key]), float(value))
        for key, value in found.items()
        if _is_number(value) and _is_number(packed.get(key))
    }
    gaps = {key: abs(a - b) / max(abs(a), abs(b)) for key, (a, b) in both.items() if a != b}
    worst = sorted(gaps, key=lambda key: -gaps[key])
    return [f"{key}: {both[key][0]!r} packed, {both[key][1]!r} found" for key in worst if gaps[key] > TOLERANCE]


def equal(packed: Mapping[str, Any], found: Mapping[str, Any]) -> list[str]:
    """The metrics that are numbers in both, the same to the digit."""
    return [key for key, value in found.items() if _is_number(value) and packed.get(key) == value]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _npy(values: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, values.astype(np.float32, copy=False))
    return file.getvalue()


def _png(image: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(_bytes(image)).save(file, "PNG")
    return file.getvalue()


def _bytes(image: np.ndarray) -> np.ndarray:
    return np.round(image * 255.0).astype(np.uint8)
