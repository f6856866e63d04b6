"""Alpha composition over a background, downscaling, and detection of the background of opaque images."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from rasterizer.camera import Camera

Color = tuple[float, float, float]  # RGB in [0, 1]
BLACK: Color = (0.0, 0.0, 0.0)
WHITE: Color = (1.0, 1.0, 1.0)

TRAINING_SIDE = 640  # pixels: of training images, where scene.downscale=0 leaves the choice to chosen_downscale
BORDER_TOLERANCE = 8  # levels of 255: JPEG artefacts in an area of one colour
BORDER_SHARE = 0.9  # least share of border pixels of that colour; objects may cover the rest
HIDDEN_IMAGES = 8  # whose transparent pixels are looked at
HIDDEN_SHARE = 0.01  # least share of transparent pixels


def background_color(setting: str | Sequence[float]) -> Color | None:
    """scene.background as RGB in [0, 1]; None for auto."""
    if isinstance(setting, str):
        return {"auto": None, "black": BLACK, "white": WHITE}[setting]
    return cast(Color, tuple(float(channel) for channel in setting))


def hidden_color(images: Sequence[np.ndarray]) -> Color | None:
    """The one colour that images (H, W, 4) uint8 have under their transparent pixels, RGB in [0, 1]: the background
    that was there before it was made transparent. None with few transparent pixels, or where there are several colours.
    """
    hidden = np.concatenate([image[image[..., 3] == 0][:, :3] for image in images])
    enough = len(hidden) >= HIDDEN_SHARE * sum(image[..., 3].size for image in images)
    return _common_color(hidden) if enough and len(hidden) else None


def compose(rgba: np.ndarray, background: Color, downscale: int = 1) -> np.ndarray:
    """An RGBA image (H, W, 4) uint8 with straight alpha over `background`, reduced by area average.

    Premultiplied colour and alpha are averaged, then composed, then rounded once. As both steps are linear, this equals
    composition at full size. The average of straight colour would mix the colour of transparent pixels into the edges.
    Rows and columns that fill no block of downscale² pixels are left out.
    Returns (H // downscale, W // downscale, 3) uint8.
    """
    alpha = rgba[..., 3].astype(np.float32) / 255
    transparency = 255 * (1 - _block_means(alpha, downscale))
    # One channel at a time: numpy is several times faster on planes than on interleaved pixels.
    channels = [
        _block_means(rgba[..., c] * alpha, downscale) + np.float32(background[c]) * transparency for c in range(3)
    ]
    return np.rint(np.stack(channels, axis=-1)).astype(np.uint8)


def coverage(rgba: np.ndarray, downscale: int = 1) -> np.ndarray | None:
    """Alpha of `compose`'s image, (H // downscale, W // downscale) uint8; None if all of it is opaque."""
    alpha = rgba[..., 3]
    return None if alpha.min() == 255 else np.rint(_block_means(alpha.astype(np.float32), downscale)).astype(np.uint8)


def reduced_camera(camera: Camera, downscale: int) -> Camera:
    """The camera of `compose`'s image: cropped at the right and lower edge to whole blocks, then scaled."""
    width, height = camera.width // downscale, camera.height // downscale
    return replace(camera, width=width * downscale, height=height * downscale).resized(width, height)


def chosen_downscale(size: tuple[int, int]) -> int:
    """The downscale where the settings leave it open: the longer side is TRAINING_SIDE at most."""
    return max(1, -(-max(size) // TRAINING_SIDE))


def _block_means(plane: np.ndarray, side: int) -> np.ndarray:
    """Means (H // side, W // side) of the whole side × side blocks of (H, W)."""
    plane = plane[: plane.shape[0] // side * side, : plane.shape[1] // side * side]
    total = np.asarray(sum(plane[i::side, j::side] for i in range(side) for j in range(side)))
    return total / np.float32(side**2)


def border_color(images: Sequence[np.ndarray]) -> Color | None:
    """The common colour of the borders of opaque images (H, W, 3) uint8, RGB in [0, 1]; None if there is none.

    A colour within BORDER_TOLERANCE of black or white is taken as black or white.
    """
    return _common_color(
        np.concatenate([np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]) for image in images])
    )


def _common_color(pixels: np.ndarray) -> Color | None:
    """That of BORDER_SHARE of the pixels (N, 3) uint8, within BORDER_TOLERANCE; None if there is none."""
    median = np.median(pixels, axis=0)
    similar = (np.abs(pixels - median) <= BORDER_TOLERANCE).all(axis=1)
    if similar.mean() < BORDER_SHARE:
        return None
    snapped = np.where(median <= BORDER_TOLERANCE, 0, np.where(median >= 255 - BORDER_TOLERANCE, 255, median))
    if np.ptp(snapped) == 0 and snapped[0] in (0, 255):
        return (float(snapped[0] / 255),) * 3
    return tuple((np.median(pixels[similar], axis=0) / 255).tolist())


def chosen_background(
    images: Sequence[np.ndarray],
    opaque: bool,
    requested: Color | None,
    log: Callable[[str], None],
    hidden: Color | None = None,
) -> Color:
    """`requested`, or if that is None the border colour of `images`, (H, W, 3) uint8, if all of the scene's are
    `opaque`, or else their `hidden_color`, or else black. log: gets a line where the colour is no black, or another
    one than requested."""
    border = border_color(images) if opaque else None
    if requested is None:
        if border not in (None, BLACK):
            log(f"scene.background: {_color_name(border)}, the border colour of the images; "
                "scene.background=black overrides")  # fmt: skip
        if hidden not in (None, BLACK):
            log(f"scene.background: {_color_name(hidden)}, the colour of the images under their transparent pixels; "
                "scene.background=black overrides")  # fmt: skip
        return border or hidden or BLACK
    if border is not None and border != requested:
        log(f"scene.background: {_color_name(requested)} as set, but the images' borders are {_color_name(border)}")
    return requested


def _color_name(color: Color) -> str:
    names = {BLACK: "black", WHITE: "white"}
    return names.get(color) or "[" + ",".join(f"{channel:.3g}" for channel in color) + "]"
