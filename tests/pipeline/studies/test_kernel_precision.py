"""Kernel precision: reference renderings, variant builds, Pareto front, tables. Speed itself is not tested."""

from __future__ import annotations

import csv
import fcntl
import io
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from types import ModuleType

import pytest
import torch
from builders import generator, off_centre_camera, outputs_of, random_gaussians, render_and_gradients
from torch import Tensor

from pipeline.studies.kernel_precision import build
from pipeline.studies.kernel_precision.build import BuildError, HalfPrecisionSH, load_variants
from pipeline.studies.kernel_precision.measure import (
    UNTIMED,
    Errors,
    Point,
    render_kernel,
    time_kernels,
    without_varied,
)
from pipeline.studies.kernel_precision.plot import draw
from pipeline.studies.kernel_precision.reference_rendering import Rendered, render_reference
from pipeline.studies.kernel_precision.table import comma_separated, margins_of, markdown, on_front, verdicts
from pipeline.studies.kernel_precision.variants import DEFAULT, TRADES, NumericalChoices, Variant, all_variants
from rasterizer import Gradients, Rasterizer, Request
from rasterizer.bench.workloads import Workload, make_workload
from rasterizer.gaussians import Motion
from rasterizer.kernel_loader import kernel
from rasterizer.reference import render as reference
from rasterizer.reference.blend import Thresholds
from rasterizer.reference.discontinuities import away_from_discontinuities, smooth_pixels

NONE = Thresholds(0, 0, 0)
VARIANTS = {variant.name: variant for variant in all_variants()}
FINE = 1e-4  # a minimum of p(t)
FINE_FLOAT64 = Variant("fine_float64", "several at once", "", NumericalChoices(min_marginal=FINE, float64=True))
HALF = {"sh_float16": ("Float16", torch.float16), "sh_bfloat16": ("Bfloat16", torch.bfloat16)}  # C++ and torch types


def small_workload(seed: int = 0) -> Workload:
    gaussians = random_gaussians(60, "full", generator(seed)).to(torch.float32)
    return Workload(gaussians, off_centre_camera(), time=0.4, duration=1.0)


# ---- Numerical choices ----


def test_kernel_has_the_default_choices() -> None:
    thresholds = {"min_marginal": 0.05, "min_alpha": 1 / 255, "min_transmittance": 1e-4}
    assert kernel.choices == thresholds | {
        "exp_degree": 4,
        "exact_culling": True,
        "block_masks": True,
        "float64": False,
        "sh_type": "scalar",
    }
    assert kernel.choices == asdict(NumericalChoices())


def test_reference_implementation_has_the_same_thresholds() -> None:
    assert NumericalChoices().thresholds() == Thresholds() == Thresholds(0.05, 1 / 255, 1e-4)
    assert NumericalChoices().flags() == []


def test_every_trade_off_contains_the_default_and_names_are_unique() -> None:
    variants = all_variants()
    assert {v.trade for v in variants if v.name == DEFAULT} == set(TRADES)
    others = [v.name for v in variants if v.name != DEFAULT]
    assert len(others) == len(set(others)) and all(name.isidentifier() for name in others)
    assert VARIANTS["min_marginal_0_0001"].choices.flags() == ["-DRASTERIZER_MIN_MARGINAL=0.0001"]
    assert VARIANTS["masks_01"].choices.flags() == ["-DRASTERIZER_EXACT_CULLING=0"]


# ---- Reference renderings ----


def test_rendering_in_bands_equals_the_reference_implementation() -> None:
    workload = small_workload()
    d_color = workload.image_gradient()
    found = render_reference(workload, d_color, Thresholds())
    out, gradients = render_and_gradients(
        reference.rasterize, workload.gaussians.to(torch.float64), workload.request(), {"color": d_color.double()}
    )
    torch.testing.assert_close(found.color, out.color, rtol=0, atol=1e-14)
    for name, gradient in gradients.items():  # sums in a different order
        largest = gradient.abs().max().item()
        torch.testing.assert_close(found.gradients[name], gradient, rtol=1e-10, atol=1e-10 * largest)


def test_rendering_without_thresholds_sums_all_gaussians() -> None:
    """Against a plain loop over all Gaussians."""
    workload = small_workload(1)
    splats = reference.make_splats(workload.gaussians.to(torch.float64), workload.request(), min_marginal=0)
    camera = workload.camera
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    transmittance = torch.ones(camera.height, camera.width, dtype=torch.float64)
    image = torch.zeros(3, camera.height, camera.width, dtype=torch.float64)
    for center, (k, v, c), opacity, color in zip(splats.center, splats.ellipse, splats.opacity, splats.features):
        dx, dy = columns.double() + 0.5 - center[0], rows.double() + 0.5 - center[1]
        alpha = (opacity * torch.exp(-0.5 * ((dx + k * dy) ** 2 / v + dy * dy / c))).clamp(max=0.99)
        image += color[:, None, None] * alpha * transmittance
        transmittance *= 1 - alpha
    found = render_reference(workload, workload.image_gradient(), NONE).color
    torch.testing.assert_close(found, image, rtol=0, atol=1e-13)


def test_errors_by_definition() -> None:
    truth = Rendered(torch.zeros(3, 2, 2), {"mean": torch.tensor([3.0, 4.0]), "sh": torch.zeros(2)})
    found = Rendered(torch.full((3, 2, 2), 0.1), {"mean": torch.tensor([3.0, 4.5]), "sh": torch.ones(2)})
    errors = Errors.of(found, truth)
    assert errors.image_max == errors.image_rms == pytest.approx(0.1) and errors.psnr == pytest.approx(20)
    assert errors.gradient_rms == pytest.approx(0.1)  # 0.5 / 5; sh has no gradient and does not count
    assert errors.gradient_max == pytest.approx(0.125)  # 0.5 / 4
    assert Errors.of(truth, truth).psnr == math.inf


# ---- Builds ----


@pytest.fixture(scope="module")
def kernels() -> dict[str, ModuleType | HalfPrecisionSH]:
    """All variants of this file, compiled in a quarter of the time with -O0."""
    variants = [VARIANTS[DEFAULT], FINE_FLOAT64, *(VARIANTS[name] for name in HALF)]
    (build.SOURCE / "build").mkdir(exist_ok=True)
    with open(build.SOURCE / "build" / ".variants.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests of this file may run in several processes at once
        return load_variants(variants, flags=["-O0"])


def test_lower_min_marginal_has_more_active_gaussians_and_less_error(kernels) -> None:
    built = {name: kernels[name] for name in (FINE_FLOAT64.name, DEFAULT)}
    assert built[DEFAULT] is kernel and built[FINE_FLOAT64.name].choices["min_marginal"] == FINE
    workload = make_workload("W1").cropped(24)
    d_color = workload.image_gradient()
    truth, same = (
        render_reference(workload, d_color, thresholds) for thresholds in (NONE, FINE_FLOAT64.choices.thresholds())
    )
    lower, default = (render_kernel(built[name], workload, d_color) for name in (FINE_FLOAT64.name, DEFAULT))
    assert Errors.of(lower, truth).image_rms < Errors.of(default, truth).image_rms
    assert Errors.of(lower, truth).gradient_rms < Errors.of(default, truth).gradient_rms
    assert Errors.of(lower, same).image_rms < 1e-10  # float64 rounding only
    alive = {}
    for name, module in built.items():
        frame = Rasterizer(1, module)
        frame.render(workload.gaussians.to(frame.dtype), workload.request())
        alive[name] = frame.alive
    # p(t) >= c is |t - μt| <= σt √(-2 ln c), and W1's μt are uniform beyond both ends of the video
    assert alive[FINE_FLOAT64.name] > 1.1 * alive[DEFAULT]
    times = time_kernels(built, workload, rounds=1)
    assert {name: timing.alive for name, timing in times.items()} == alive
    assert all(timing.milliseconds >= timing.forward_ms > 0 for timing in times.values())


def with_sh(degree: int, rounding: Callable[[Tensor], Tensor]) -> Workload:
    """60 Gaussians with rounded coefficients, a third of them so small that they are subnormal or zero in float16."""
    gaussians = random_gaussians(60, "full", generator(3), sh_degree=degree).to(torch.float32)
    gaussians.sh[:20] *= 1e-6
    rounded = rounding(gaussians.sh)
    assert not torch.equal(rounded, gaussians.sh)
    return Workload(replace(gaussians, sh=rounded), off_centre_camera(), time=0.4, duration=1.0)


@pytest.mark.parametrize("degree", [3, 1])  # rows of several vectors, and of less than one
@pytest.mark.parametrize("name", HALF)
def test_half_precision_sh_equals_the_reference(kernels, name: str, degree: int) -> None:
    """Every 16-bit number is a float64. Tolerances are those of float32 (test_kernel_vs_reference.py)."""
    stored, dtype = HALF[name]
    assert kernels[name].choices == kernel.choices | {"sh_type": stored}
    workload = with_sh(degree, lambda sh: sh.to(dtype).float())
    gaussians = away_from_discontinuities(workload.gaussians.to(torch.float64), workload.request())
    smooth = smooth_pixels(gaussians, workload.request())
    assert len(gaussians) > 50 and smooth.float().mean() > 0.9
    weights = torch.randn(3, *smooth.shape, generator=generator(4), dtype=torch.float64) * smooth
    found = render_kernel(kernels[name], replace(workload, gaussians=gaussians.to(torch.float32)), weights.float())
    expected, truth = render_and_gradients(reference.rasterize, gaussians, workload.request(), {"color": weights})
    assert ((found.color - expected.color).abs() * smooth).max() <= 3e-5 * expected.color.max()
    for field, gradient in truth.items():
        assert (found.gradients[field] - gradient).abs().max() <= 1e-4 * gradient.abs().max(), field


@pytest.mark.parametrize("degree", [3, 1])
def test_numbers_of_both_half_precisions_give_the_same_bits(kernels, degree: int) -> None:
    def in_both(sh: Tensor) -> Tensor:
        once = sh.to(torch.bfloat16).to(torch.float16)
        return torch.where(once.to(torch.bfloat16).float() == once.float(), once.float(), 0.0)

    workload = with_sh(degree, in_both)
    assert 0 < workload.gaussians.sh[:20].abs().max() < 6e-5  # subnormal in float16
    one, other = (render_kernel(kernels[name], workload, workload.image_gradient()) for name in HALF)
    assert torch.equal(one.color, other.color)
    for field, gradient in one.gradients.items():
        assert torch.equal(gradient, other.gradients[field]), field


@pytest.mark.parametrize("motion", ["static", "separable", "full"])
def test_float64_kernel_equals_the_float64_reference(kernels, motion: Motion) -> None:
    """All outputs. float64 rounds to 1e-16; sums over pixels and the backward pass lose a few digits."""
    built = kernels[FINE_FLOAT64.name]
    assert built.choices == kernel.choices | {"float64": True, "min_marginal": FINE}
    rng, outputs = generator(4), outputs_of(motion)
    gaussians = random_gaussians(60, motion, rng)
    if motion != "static":
        gaussians.log_scale[:, 3] = 0.0  # p(t) is above either minimum
    request = Request(off_centre_camera(), time=0.4, outputs=outputs, flow_dt=0.01)
    frame, gradients = Rasterizer(1, built), Gradients.zeros_like(gaussians)
    images = frame.render(gaussians, request)
    weights = {name: torch.randn(getattr(images, name).shape, generator=rng, dtype=torch.float64) for name in outputs}
    frame.backward(gradients, **{f"d_{name}": weight for name, weight in weights.items()})
    expected, expected_gradients = render_and_gradients(reference.rasterize, gaussians, request, weights)
    for name in outputs:
        torch.testing.assert_close(getattr(images, name), getattr(expected, name), rtol=0, atol=1e-13)
    found = gradients.dense() | {"sh": gradients.sh(kernel=built)}
    for field, gradient in expected_gradients.items():
        torch.testing.assert_close(found[field], gradient, rtol=0, atol=1e-13 * gradient.abs().max().item())


def test_missing_compiler_is_a_one_line_error(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("CXX", "/no_such_compiler")  # short: a long message is cut
    with pytest.raises(BuildError) as error:
        load_variants([VARIANTS["exp_degree_5"]], tmp_path)
    assert "no_such_compiler" in str(error.value) and "\n" not in str(error.value)


def test_missing_cmake_is_a_one_line_error(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda *_, **__: None)
    with pytest.raises(BuildError, match="^kernel_precision: expected cmake .* found none") as error:
        load_variants([VARIANTS["exp_degree_5"]], tmp_path)
    assert "\n" not in str(error.value)


# ---- Pareto front and tables ----


def test_front_is_the_set_of_undominated_points() -> None:
    rng = generator(5)
    for n in (1, 2, 7, 40):
        points = torch.randint(0, 6, (n, 2), generator=rng).tolist()  # with ties
        expected = [
            not any(c <= cost and e <= error and (c < cost or e < error) for c, e in points) for cost, error in points
        ]
        assert on_front(*zip(*points)) == expected and any(expected)
    assert on_front([1.0, math.nan, 3.0], [2.0, 1.0, 1.0]) == [True, False, True]
    assert on_front([1.0, 1.0], [2.0, 2.0]) == [True, True]


def test_differences_within_the_margins_count_as_equal() -> None:
    cost, error = [100.0, 99.0, 101.0, 90.0], [1.0, 1.005, 0.5, 2.0]
    assert on_front(cost, error) == [True, True, True, True]
    assert on_front(cost, error, (0.03, 0.01)) == [False, False, True, True]  # half the error in equal time
    assert on_front([100.0, 99.0], [1.0, 1.0], (0.02, 0.01)) == [True, True]


def point(name: str, trade: str, ms: float, error: float) -> Point:
    errors = Errors(error, error / 5, 40.0, 2 * error, 3 * error)
    timing = vars(UNTIMED) | {"milliseconds": ms, "forward_ms": ms / 2, "noise": 0.02}
    return Point(name, trade, f"label of {name}", **timing, errors=errors, own=errors, rounding=errors)


POINTS = [
    point("coarse", "alpha cut-off", 10, 0.1),
    point(DEFAULT, "alpha cut-off", 20, 0.05),
    point(DEFAULT, "exp degree", 20, 0.05),
    point("better", "exp degree", 15, 0.04),
    point("narrow", "SH precision", math.nan, 0.01),
]


def test_verdicts() -> None:
    assert margins_of(POINTS)[0] == pytest.approx(0.02)  # the noise
    found = verdicts(POINTS)
    assert found["alpha cut-off"] == ["nothing", "nothing"]
    assert found["exp degree"] == [
        "label of better: 25.0% less time, error 4.0e-02",
        "label of better: 25.0% less time, error 8.0e-02",
    ]
    assert "nothing" not in found["all choices together"]
    again = [*POINTS, point("again", "built again", 18.0, 0.05)]
    assert margins_of(again)[0] == pytest.approx(0.1)
    level = point("level", "exp degree", 19.9, 0.0498)  # within the noise
    assert verdicts([p if p.name != "better" else level for p in POINTS])["exp degree"] == ["nothing", "nothing"]


def test_tables_hold_all_points_and_empty_cells_for_unmeasured_times() -> None:
    rows = list(csv.DictReader(io.StringIO(comma_separated(POINTS))))
    assert [row["name"] for row in rows] == [p.name for p in POINTS]
    assert rows[-1]["milliseconds"] == "" and float(rows[0]["errors_image_max"]) == 0.1
    assert ["I" in row["front"] for row in rows] == [True, False, False, True, False]
    text = markdown(POINTS, "heading")
    assert "heading" in text and text.count("\n| label of ") == len(POINTS) and "n/a" in text


def test_plot_is_reproducible_and_omits_untimed_points() -> None:
    first = draw(POINTS, "title")
    assert first == draw(POINTS, "title") and "Pareto front" in first and "narrow" not in first


def test_without_varied_zeroes_only_the_thresholds_of_the_trade_off() -> None:
    assert without_varied(Thresholds(0.1, 0.2, 0.3), TRADES["alpha cut-off"]) == Thresholds(0.1, 0, 0.3)
    assert without_varied(Thresholds(0.1, 0.2, 0.3), TRADES["several at once"]) == NONE
