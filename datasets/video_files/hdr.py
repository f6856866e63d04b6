"""Tone mapping of high dynamic range: HLG or PQ in BT.2020 to 8-bit BT.709, as a phone's own SDR picture looks.

Transfer functions: ITU-R BT.2100. The curve is Reinhard's with a white point: x (1 + x / w²) / (1 + x), for luminance x
relative to diffuse white, w = WHITE.
"""

from __future__ import annotations

import numpy as np

PQ = 16  # code point of the transfer function; that of HLG is 18
DIFFUSE_WHITE = 203.0  # cd/m² (ITU-R BT.2408)
PEAK = 1000.0  # cd/m², of HLG's nominal display
WHITE = PEAK / DIFFUSE_WHITE  # the luminance that becomes white
EXPOSURE = 1.6  # so that middle grey, and not only black and white, keeps its brightness under the curve
_TO_709 = np.array(  # linear BT.2020 → linear BT.709 (ITU-R BT.2087)
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)


def tone_mapped(image: np.ndarray, transfer: int) -> np.ndarray:
    """(H, W, 3) uint16 of 16 bits, R'G'B' in BT.2020, to (H, W, 3) uint8 sRGB. transfer: PQ or HLG."""
    signal = image.astype(np.float32) / np.float32(65535)
    light = _pq_light(signal) if transfer == PQ else _hlg_light(signal)  # relative to diffuse white
    linear = np.maximum(light @ _TO_709.T, 0) * np.float32(EXPOSURE)
    luminance = linear @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    scale = (1 + luminance / np.float32((EXPOSURE * WHITE) ** 2)) / (1 + luminance)
    mapped = np.clip(linear * scale[..., None], 0, 1)
    encoded = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** np.float32(1 / 2.4) - 0.055)
    return np.rint(255 * encoded).astype(np.uint8)


def _pq_light(signal: np.ndarray) -> np.ndarray:
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    power = signal ** np.float32(1 / m2)
    absolute = 10_000 * (np.maximum(power - c1, 0) / (c2 - c3 * power)) ** np.float32(1 / m1)
    return (absolute / np.float32(DIFFUSE_WHITE)).astype(np.float32)


def _hlg_light(signal: np.ndarray) -> np.ndarray:
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    scene = np.where(signal <= 0.5, signal**2 / 3, (np.exp((np.maximum(signal, 0.5) - c) / a) + b) / 12)
    luminance = scene @ np.array([0.2627, 0.6780, 0.0593], np.float32)
    display = PEAK * np.maximum(luminance, 1e-6)[..., None] ** np.float32(0.2) * scene  # system gamma 1.2
    return (display / np.float32(DIFFUSE_WHITE)).astype(np.float32)
