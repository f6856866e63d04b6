"""The formats of `pipeline.export`: how each is written, who reads it, and what it loses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pipeline.export.fourdgs_file import fourdgs_bytes
from pipeline.export.ftgs_ply import ftgs_bytes
from pipeline.export.gltf import glb_bytes
from pipeline.export.moving import MovingGaussians
from pipeline.export.source import Timeline
from pipeline.export.splat import splat_bytes
from pipeline.export.splatv import splatv_bytes
from pipeline.export.spz import spz_bytes
from pipeline.model.model import Model
from pipeline.model.ply import ply_bytes
from pipeline.model.released_checkpoint import released_bytes


@dataclass(frozen=True)
class Format:
    """One file format."""

    read_by: str
    loses: str


@dataclass(frozen=True)
class FrameFormat(Format):
    """A file holds one frame, a static model."""

    holds = "a frame a file"
    content: Callable[[Model], bytes]


@dataclass(frozen=True)
class FilmFormat(Format):
    """A file holds all of time, as Gaussians that move on lines and fade."""

    holds = "all of time"
    content: Callable[[MovingGaussians, Timeline], bytes]


@dataclass(frozen=True)
class CheckpointFormat(Format):
    """A file holds the 4D Gaussians themselves, in the coordinates of the data's files."""

    holds = "the 4D Gaussians"
    content: Callable[[Model], bytes]


_NO_4DSH = "colours that change with time (their mean is kept)"

FORMATS: dict[str, FrameFormat | FilmFormat | CheckpointFormat] = {
    "ply": FrameFormat("viewers of 3DGS, SuperSplat (which plays a sequence)", "nothing of the frame", ply_bytes),
    "splat": FrameFormat(
        "most web viewers", "SH of degree 1 and more; colours, opacities and rotations have 8 bits", splat_bytes
    ),
    "spz": FrameFormat(
        "Niantic's viewers, SuperSplat, Babylon.js",
        "nothing but bits: colours, opacities and scales have 8, rotations 10; SH are multiples of 1/128, "
        "positions of 1/4096",
        spz_bytes,
    ),
    "glb": FrameFormat("Babylon.js, Cesium, PlayCanvas (KHR_gaussian_splatting)", "nothing of the frame", glb_bytes),
    "ftgs.ply": FilmFormat(
        "ftgs-player",
        f"{_NO_4DSH}; the threshold of p(t)",
        lambda moving, line: ftgs_bytes(moving, line.start, line.duration, line.frames),
    ),
    "splatv": FilmFormat(
        "gsplat.js, splaTV",
        f"SH of degree 1 and more; {_NO_4DSH}; colours and opacities have 8 bits, all but positions half precision; "
        "p(t) ends at 0.02 instead of 0.05",
        lambda moving, line: splatv_bytes(moving, line.start, line.duration, line.camera),
    ),
    "4dgs": FilmFormat(
        "fourdgs and its players",
        f"{_NO_4DSH}; SH have 8 bits, all else an error bound that the file states",
        lambda moving, line: fourdgs_bytes(moving, line.start, line.duration, line.seconds),
    ),
    "pth": CheckpointFormat(
        "the released program (--start_checkpoint)", "the optimizer's moments, the label of a sphere", released_bytes
    ),
}
