"""Metrics against their definitions, written out naively."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import convolve1d

from pipeline.evaluation import image_metrics, metrics
from pipeline.evaluation.metrics import MeasuredView

# float64 sums of a few thousand terms in different orders.
EXACT = 1e-9
# pytorch-msssim works in float32.
FLOAT32 = 1e-5


def noisy_pair(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A smooth image and the same with noise, (H, W, 3) float32 in [0, 1]."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    truth = np.stack([0.5 + 0.4 * np.sin(x / 7 + c) * np.cos(y / (5 + c)) for c in range(3)], axis=-1)
    image = np.clip(truth + 0.1 * rng.standard_normal(truth.shape), 0, 1)
    return image.astype(np.float32), truth.astype(np.float32)


def window() -> np.ndarray:
    """(11,) Gaussian of σ 1.5, sum 1."""
    weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    return weights / weights.sum()


def blurred(image: np.ndarray) -> np.ndarray:
    """Convolution with the window, for pixels whose window is inside the image."""
    for axis in (0, 1):
        image = convolve1d(image, window(), axis=axis)
    return image[5:-5, 5:-5]


def naive_ssim_parts(a: np.ndarray, b: np.ndarray, data_range: float) -> tuple[np.ndarray, np.ndarray]:
    """(luminance × structure, structure) maps of Wang et al. 2004 with C = (0.01 L)², (0.03 L)²."""
    a, b = a.astype(np.float64), b.astype(np.float64)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    mean_a, mean_b = blurred(a), blurred(b)
    var_a, var_b = blurred(a * a) - mean_a**2, blurred(b * b) - mean_b**2
    covariance = blurred(a * b) - mean_a * mean_b
    structure = (2 * covariance + c2) / (var_a + var_b + c2)
    return structure * (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1), structure


def test_psnr_of_a_constant_error() -> None:
    truth = np.full((4, 5, 3), 0.25, np.float32)
    assert image_metrics.psnr(truth + np.float32(0.125), truth) == pytest.approx(-20 * np.log10(0.125), abs=EXACT)


def test_psnr_of_equal_images_is_100_db() -> None:
    truth = np.zeros((4, 5, 3), np.float32)
    assert image_metrics.psnr(truth, truth) == 100.0


@pytest.mark.parametrize("data_range", [1.0, 2.0])
def test_ssim_equals_its_definition(data_range: float) -> None:
    image, truth = noisy_pair(24, 31)
    expected = naive_ssim_parts(image, truth, data_range)[0].mean()
    # scikit-image keeps float32 images in float32.
    assert image_metrics.ssim(image, truth, data_range) == pytest.approx(expected, abs=FLOAT32)


def test_dssim_with_both_data_ranges() -> None:
    image, truth = noisy_pair(24, 31)
    found = metrics.measure(MeasuredView(image, truth))
    for key, data_range in (("dssim1", 1.0), ("dssim2", 2.0)):
        expected = (1 - naive_ssim_parts(image, truth, data_range)[0].mean()) / 2
        assert found[key] == pytest.approx(expected, abs=FLOAT32)
    assert found["dssim2"] < found["dssim1"]


def test_ms_ssim_equals_its_definition() -> None:
    image, truth = noisy_pair(176, 176)
    expected = np.ones(3)
    for scale, weight in enumerate((0.0448, 0.2856, 0.3001, 0.2363, 0.1333)):
        side = 176 // 2**scale  # every scale halves evenly: 176, 88, 44, 22, 11
        a, b = (x.reshape(side, 2**scale, side, 2**scale, 3).mean(axis=(1, 3)) for x in (image, truth))
        full, structure = naive_ssim_parts(a, b, 1.0)
        expected *= (full if scale == 4 else structure).mean(axis=(0, 1)) ** weight
    assert image_metrics.ms_ssim(image, truth) == pytest.approx(expected.mean(), abs=FLOAT32)


def test_ms_ssim_of_small_images_is_none() -> None:
    assert image_metrics.ms_ssim(*noisy_pair(160, 400)) is None
    assert image_metrics.ms_ssim(*noisy_pair(161, 161)) is not None


def test_a_view_has_every_metric_of_two_images() -> None:
    image, truth = noisy_pair(170, 170)
    found = metrics.measure(MeasuredView(image, truth))
    assert found["psnr"] == image_metrics.psnr(image, truth) and found["ssim"] == image_metrics.ssim(image, truth)
    assert found["dssim"] == pytest.approx((1 - image_metrics.ms_ssim(image, truth)) / 2)
    assert {key for key, value in found.items() if value is not None} == {
        "psnr", "psnr_channels", "ssim", "ms_ssim", "dssim", "dssim1", "dssim2"}  # fmt: skip


@pytest.mark.parametrize("shape", [(24, 30, 3), (24, 31), (24, 31, 4)])
def test_measure_refuses_images_of_different_shapes(shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="expected two images"):
        MeasuredView(np.zeros(shape, np.float32), np.zeros((24, 31, 3), np.float32))


def test_measure_refuses_nan() -> None:
    image, truth = noisy_pair(24, 31)
    image[3, 4, 1] = np.nan
    with pytest.raises(ValueError, match="NaN or Inf in the render"):
        MeasuredView(image, truth)


def test_a_mean_with_missing_values_is_none() -> None:
    assert metrics.mean([{"a": 1.0}, {"a": 2.0}], "a") == 1.5
    assert metrics.mean([{"a": 1.0}, {"a": None}], "a") is None
    assert metrics.mean([], "a") is None
    assert metrics.mean([{"a": 1.0}, {"a": None}], "a", partial=True) == 1.0
    assert metrics.mean([{"a": None}], "a", partial=True) is None
