"""The formats of `pipeline.export`: how each is written, who reads it, and what it loses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from datasets.canonical import Canonical
from datasets.files.atomic_write import atomic_file
from pipeline.export.pieces import film_of
from pipeline.export.source import Source
from pipeline.export.splats import frame_at
from pipeline.export.static_formats import glb_bytes, splat_bytes, spz_bytes
from pipeline.export.temporal_formats import fourdgs_bytes, ftgs_bytes, splatv_bytes
from pipeline.model.ply import ply_bytes
from pipeline.model.released_checkpoint import released_bytes

COARSEST = (
    0.1  # × the median size of the Gaussians: steps of float32 from which a file of the data's coordinates is shifted
)
FRAME, FILM, MODEL = "a frame a file", "all of time", "the 4D Gaussians"  # what a file holds


@dataclass(frozen=True)
class Format:
    """content takes what a file holds. FRAME: a static model. FILM: MovingGaussians, which move on lines and fade, and
    the Timeline. MODEL: the model, in the coordinates of the data's files."""

    holds: str
    read_by: str
    loses: str
    content: Callable[..., bytes]
    windows: bool = False  # of a FILM: its Gaussians have windows in time
    states: str = ""  # where the file states its coordinates, which `content` takes as its second argument


_NO_4DSH = "colours that change with time (their mean is kept)"

FORMATS = {
    "ply": Format(
        FRAME,
        "viewers of 3DGS, SuperSplat (which plays a sequence)",
        "nothing of the frame",
        ply_bytes,
        states="a comment in its header",
    ),
    "splat": Format(
        FRAME, "most web viewers", "SH of degree 1 and more; colours, opacities and rotations have 8 bits", splat_bytes
    ),
    "spz": Format(
        FRAME,
        "Niantic's viewers, SuperSplat, Babylon.js",
        "nothing but bits: colours, opacities and scales have 8, rotations 10; SH are multiples of 1/128, "
        "positions of 1/4096",
        spz_bytes,
    ),
    "glb": Format(
        FRAME,
        "Babylon.js, Cesium, PlayCanvas (KHR_gaussian_splatting)",
        "nothing of the frame",
        glb_bytes,
        states="the translation of its node",
    ),
    "ftgs.ply": Format(FILM, "ftgs-player", f"{_NO_4DSH}; the threshold of p(t)", ftgs_bytes),
    "splatv": Format(
        FILM,
        "gsplat.js, splaTV",
        f"SH of degree 1 and more; {_NO_4DSH}; colours and opacities have 8 bits, all but positions half precision; "
        "p(t) ends at 0.02 instead of 0.05",
        splatv_bytes,
    ),
    "4dgs": Format(
        FILM,
        "fourdgs and its players",
        f"{_NO_4DSH}; SH have 8 bits, all else an error bound that the file states",
        fourdgs_bytes,
        windows=True,
    ),
    "pth": Format(
        MODEL,
        "the released program (--start_checkpoint)",
        "the optimizer's moments, the label of a sphere",
        released_bytes,
    ),
}


def write_files(
    name: str, source: Source, times: Sequence[float], folder: Path, world: bool, log: Callable[[str], None]
) -> Iterator[Path]:
    """Writes `source` in format `name`, a file at a time, and yields the paths: `scene_0000.ply` … for several frames,
    of which those of an earlier export are removed.

    times: canonical, of a static format's frames. world: in the coordinates of the data's files. ValueError where model
    and format do not fit, or the file of the model would be replaced.
    """
    form = FORMATS[name]
    _spare(source, folder, name)
    data_to_file = _coordinates(name, source, world, log)
    model, line = source.in_file(data_to_file)
    folder.mkdir(parents=True, exist_ok=True)
    if form.holds == MODEL:
        yield _written(folder / f"{source.name}.{name}", form.content(model))
    elif form.holds == FILM:
        moving = film_of(model, line, form.windows)
        if moving.note:
            log(f"{name}: {moving.note}")
        yield _written(folder / f"{source.name}.{name}", form.content(moving, line))
    else:
        for old in _frames(source, folder, name):  # of a longer sequence
            old.unlink()
        for index, time in enumerate(times):
            numbered = f"{source.name}_{index:04d}" if len(times) > 1 else source.name
            own_time = data_to_file.time(source.canonical.inverse.time(time)) if world else time
            content = [frame_at(model, own_time, line.duration)]
            stated = [data_to_file if source.known else None] if form.states else []
            yield _written(folder / f"{numbered}.{name}", form.content(*content, *stated))


def _coordinates(name: str, source: Source, world: bool, log: Callable[[str], None]) -> Canonical:
    """From the coordinates of the data's files to those of a file: canonical ones, or the data's, from which a shift
    is subtracted where float32 is too coarse for them. ValueError where the format has no place for the shift."""
    form = FORMATS[name]
    if not (world or form.holds == MODEL):
        return source.canonical
    p = source.model.parameters
    positions = source.canonical.inverse.points(p["mean"][:, :3].numpy())
    largest = float(np.abs(positions).max(initial=0.0))
    step = float(np.spacing(np.float32(largest)))
    size = float(p["log_scale"][:, :3].double().mean(dim=1).median().exp()) * source.canonical.unit
    if step <= COARSEST * size:
        return Canonical()
    coarse = (
        f"float32 holds {largest:g} in steps of {step:.2g}, where half of the Gaussians are smaller than {size:.2g}"
    )
    if not form.states:
        instead = "ply and glb state a shift" + ("" if form.holds == MODEL else "; or leave out --world")
        raise ValueError(f"{name}: expected smaller coordinates, found that {coarse}; {instead}")
    shift = np.round(np.median(positions, axis=0))
    text = ", ".join(f"{x:.0f}" for x in shift)
    log(f"{name}: positions are the data's minus ({text}), which {form.states} says: {coarse}")
    return Canonical(tuple(shift.tolist()))


def _frames(source: Source, folder: Path, name: str) -> list[Path]:
    return list(folder.glob(f"{source.name}_[0-9][0-9][0-9][0-9].{name}"))


def _spare(source: Source, folder: Path, name: str) -> None:
    """ValueError if the export would replace or remove the file that the model was read from."""
    if source.file is None:
        return
    own = source.file.resolve()
    if any(path.resolve() == own for path in (folder / f"{source.name}.{name}", *_frames(source, folder, name))):
        raise ValueError(f"{source.file}: would be replaced by its export; expected another folder (--out DIR)")


def _written(path: Path, content: bytes) -> Path:
    with atomic_file(path) as temporary:
        temporary.write_bytes(content)
    return path
