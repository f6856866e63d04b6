"""Which cameras are corrected: those whose colours on held-out points agree clearly better when they are.

Structure from motion matches the same surface in several cameras. Its points are divided into FOLDS parts; the
corrections are fitted to all parts but one and tried on that one, with the median correction of all cameras the
identity, so that one odd camera is told from many. A camera is corrected only if in every part its disagreement with
the others falls by LEAST_LOWER and by LEAST_SHARE of itself. One level of 255 is what 8 bits can hold, half of it is
seen in no picture; what a glossy surface or a match beside its point adds stays below a tenth. The cameras that are
left alone are then the reference of those that are corrected; where there is none, the mean correction is the identity.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from datasets.cameras.color import ColorCorrection
from datasets.source import Photograph
from pipeline.data.colors.fit import around_most, disagreement, fit
from pipeline.data.colors.matches import Matches, matched_colors
from pipeline.data.sfm.reconstruction import Reconstruction

FOLDS = 5
LEAST_LOWER, LEAST_SHARE = 0.5, 0.1  # of 255; of the disagreement before
FEWEST_MATCHES = 50  # of a camera, with points that another one sees: ten in each part


def color_corrections(
    photographs: Sequence[Photograph],
    found: Reconstruction,
    held_out: Collection[str],
    every: bool,
    log: Callable[[str], None],
) -> dict[str, ColorCorrection]:
    """Camera -> its correction, of the cameras that are corrected.

    found: with observations. held_out: names of cameras; they are fitted to the others, which do not depend on them.
    every: correct all cameras with enough matches (scene.color_correction=true).
    """
    matches = matched_colors(photographs, found)
    training = [i for i, name in enumerate(matches.cameras) if name not in held_out]
    enough, rows = _with_enough(matches, training)
    few = [i for i in training if i not in enough]
    before_after: dict[int, tuple[float, float]] = {}
    corrections: dict[int, ColorCorrection] = {}
    if len(enough) > 1:
        chosen, before_after = _validated(rows, {}, enough, every)
        corrections = fit(rows, {i: ColorCorrection() for i in enough if i not in chosen}) if chosen else {}
        corrections = {i: corrections[i] for i in chosen}
    for camera in sorted(set(range(len(matches.cameras))) - set(training)):
        others = {i: corrections.get(i, ColorCorrection()) for i in enough}
        rows = matches.where(np.isin(matches.camera, [camera, *enough])).shared()
        rows = rows.where(np.isin(rows.point, rows.point[rows.camera == camera]))
        if rows.count(camera) < FEWEST_MATCHES:
            few.append(camera)
            continue
        chosen, tried = _validated(rows, others, [camera], every)
        before_after |= tried
        if chosen:
            corrections[camera] = fit(rows, others)[camera]
    for line in _lines(matches, few, corrections, before_after):
        log(line)
    return {matches.cameras[i]: corrections[i] for i in sorted(corrections)}


def recolored(
    photographs: Sequence[Photograph],
    found: Reconstruction,
    held_out: Collection[str],
    corrections: Mapping[str, ColorCorrection],
) -> Reconstruction:
    """The reconstruction with its points' colours moved as the training cameras that see them were corrected."""
    if not corrections:
        return found
    matches = matched_colors(photographs, found)
    change = np.zeros((len(found.points), 3))
    count = np.zeros(len(found.points))
    for i, name in enumerate(matches.cameras):
        if name in held_out:
            continue
        rows = matches.camera == i
        colors = matches.color[rows]
        np.add.at(change, matches.point[rows], corrections.get(name, ColorCorrection()).of(colors) - colors)
        np.add.at(count, matches.point[rows], 1)
    colors = found.colors + change / np.maximum(count, 1)[:, None]
    return replace(found, colors=np.rint(np.clip(colors, 0, 255)).astype(np.uint8))


def _with_enough(matches: Matches, cameras: list[int]) -> tuple[list[int], Matches]:
    """(those of `cameras` with FEWEST_MATCHES among one another, what these share)."""
    while True:
        rows = matches.where(np.isin(matches.camera, cameras)).shared()
        enough = [i for i in cameras if rows.count(i) >= FEWEST_MATCHES]
        if enough == cameras:
            return enough, rows
        cameras = enough


def _validated(
    matches: Matches, given: Mapping[int, ColorCorrection], cameras: Sequence[int], every: bool
) -> tuple[list[int], dict[int, tuple[float, float]]]:
    """(the cameras to correct, camera -> disagreement before and after), on points that the fit has not seen."""
    _, number = np.unique(matches.point, return_inverse=True)
    part = np.random.default_rng(0).permutation(number.max() + 1)[number] % FOLDS
    tried: dict[int, list[tuple[float, float]]] = {camera: [] for camera in cameras}
    for fold in range(FOLDS):
        used, held_out = matches.where(part != fold), matches.where(part == fold)
        found = fit(used, given)
        if not given:
            found = around_most(found, used.color.mean(axis=0))
        for camera in cameras:
            if held_out.count(camera):
                tried[camera].append(
                    (disagreement(held_out, found, camera, False), disagreement(held_out, found, camera, True))
                )
    better = [
        camera
        for camera, pairs in tried.items()
        if every or all(before - after >= max(LEAST_LOWER, LEAST_SHARE * before) for before, after in pairs)
    ]
    return better, {camera: tuple(np.mean(pairs, axis=0).tolist()) for camera, pairs in tried.items()}


def _lines(
    matches: Matches,
    few: Sequence[int],
    corrections: Mapping[int, ColorCorrection],
    before_after: Mapping[int, tuple[float, float]],
) -> list[str]:
    """What the run says."""
    lines = []
    for camera in few:
        lines.append(
            f"colours of {matches.cameras[camera]} are left alone: it has fewer than {FEWEST_MATCHES} matches with "
            "other cameras whose colours are not clipped"
        )
    left = [before for camera, (before, _) in before_after.items() if camera not in corrections]
    agreement = f"colours agree to {max(left):.1f} of 255" if left else ""
    if corrections:
        changed = ", ".join(
            "{} {:.1f} → {:.1f}".format(matches.cameras[i], *before_after[i]) for i in sorted(corrections)
        )
        lines.append(f"colours are corrected (difference from the other cameras, of 255): {changed}")
        lines += [f"those of the others: {agreement}, no correction"] if left else []
    elif left:
        lines.append(f"{agreement}: no correction")
    return lines
