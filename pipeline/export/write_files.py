"""Writes a model in one of the formats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from datasets.files.atomic_write import atomic_file
from pipeline.export.formats import FORMATS, CheckpointFormat, FilmFormat
from pipeline.export.frame import frame_at
from pipeline.export.moving import moving_gaussians
from pipeline.export.source import Source


def write_files(name: str, source: Source, times: Sequence[float], folder: Path, world: bool = False) -> Iterator[Path]:
    """Writes `source` in format `name`, a file at a time, and yields the paths: `scene_0000.ply` … for several frames,
    of which those of an earlier export are removed.

    times: canonical, of a static format's frames. world: in the coordinates of the data's files. ValueError where model
    and format do not fit, or the file of the model would be replaced.
    """
    form = FORMATS[name]
    model, line = source.in_world() if world or isinstance(form, CheckpointFormat) else (source.model, source.timeline)
    _spare(source, folder, name)
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(form, CheckpointFormat):
        yield _written(folder / f"{source.name}.{name}", form.content(model))
    elif isinstance(form, FilmFormat):
        moving = moving_gaussians(model, line.start, line.duration)
        yield _written(folder / f"{source.name}.{name}", form.content(moving, line))
    else:
        for old in _frames(source, folder, name):  # of a longer sequence
            old.unlink()
        for index, time in enumerate(times):
            numbered = f"{source.name}_{index:04d}" if len(times) > 1 else source.name
            frame = frame_at(model, source.time_in_world(time) if world else time, line.duration)
            yield _written(folder / f"{numbered}.{name}", form.content(frame))


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
