"""The work–precision diagram: its truth, its front, its builds. How fast anything is, is no test."""

from __future__ import annotations

import csv
import fcntl
import io
import math
from dataclasses import asdict, replace
from types import ModuleType

import pytest
import torch
from builders import generator, off_centre_camera, outputs_of, random_gaussians, render_and_gradients

from pipeline.studies.kernel_precision import build
from pipeline.studies.kernel_precision.build import BuildError, load_variants
from pipeline.studies.kernel_precision.measure import UNTIMED, Errors, Point, render_kernel, time_kernels, without
from pipeline.studies.kernel_precision.narrowed import Narrowed
from pipeline.studies.kernel_precision.pareto import on_front
from pipeline.studies.kernel_precision.plot import draw
from pipeline.studies.kernel_precision.table import comma_separated, markdown, verdicts
from pipeline.studies.kernel_precision.truth import Rendered, render_reference
from pipeline.studies.kernel_precision.variants import DEFAULT, TRADES, Choices, all_variants, by_name
from rasterizer import Gradients, Rasterizer, Request
from rasterizer.gaussians import Motion
from rasterizer.kernel import kernel
from rasterizer.reference import render as reference
from rasterizer.reference.blend import Thresholds
from rasterizer.timing.workloads import Workload, make_workload

NONE = Thresholds(0, 0, 0)


def small_workload(seed: int = 0) -> Workload:
    gaussians = random_gaussians(60, "full", generator(seed)).to(torch.float32)
    return Workload(gaussians, off_centre_camera(), time=0.4, duration=1.0)


# ---- The choices -------------------------------------------------------------------------------------------


def test_the_kernel_is_built_with_the_methods_numbers() -> None:
    spec = {"min_presence": 0.05, "min_alpha": 1 / 255, "min_transmittance": 1e-4}
    assert kernel.choices == spec | {
        "exp_degree": 4,
        "exact_culling": True,
        "block_masks": True,
        "float64": False,
        "sh_type": "scalar",
    }
    assert kernel.choices == asdict(Choices())


def test_the_twin_has_the_same_numbers() -> None:
    assert Choices().thresholds() == Thresholds() == Thresholds(0.05, 1 / 255, 1e-4)
    assert Choices().definitions() == []


def test_every_trade_off_has_the_default_among_its_values_and_names_mean_one_thing() -> None:
    variants = all_variants()
    assert {v.trade for v in variants if v.name == DEFAULT} == set(TRADES)
    others = [v.name for v in variants if v.name != DEFAULT]
    assert len(others) == len(set(others)) and all(name.isidentifier() for name in others)
    assert by_name("min_presence_0_0001").choices.definitions() == ["RASTERIZER_MIN_PRESENCE=0.0001"]
    assert by_name("masks_01").choices.definitions() == ["RASTERIZER_EXACT_CULLING=0"]


# ---- The truth ---------------------------------------------------------------------------------------------


def test_bands_give_the_twins_image_and_gradients() -> None:
    workload = small_workload()
    d_color = workload.image_gradient()
    found = render_reference(workload, d_color, Thresholds())
    out, gradients = render_and_gradients(
        reference.rasterize, workload.gaussians.to(torch.float64), workload.request(), {"color": d_color.double()}
    )
    torch.testing.assert_close(found.color, out.color, rtol=0, atol=1e-14)
    for name, gradient in gradients.items():  # sums in another order
        largest = gradient.abs().max().item()
        torch.testing.assert_close(found.gradients[name], gradient, rtol=1e-10, atol=1e-10 * largest)


def test_without_thresholds_everything_in_front_counts() -> None:
    """Against the sum written out: no cut-offs, over all Gaussians, one after another."""
    workload = small_workload(1)
    splats = reference.make_splats(workload.gaussians.to(torch.float64), workload.request(), min_marginal=0)
    camera = workload.camera
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    light = torch.ones(camera.height, camera.width, dtype=torch.float64)
    image = torch.zeros(3, camera.height, camera.width, dtype=torch.float64)
    for center, (k, v, c), opacity, color in zip(splats.center, splats.ellipse, splats.opacity, splats.features):
        dx, dy = columns.double() + 0.5 - center[0], rows.double() + 0.5 - center[1]
        alpha = (opacity * torch.exp(-0.5 * ((dx + k * dy) ** 2 / v + dy * dy / c))).clamp(max=0.99)
        image += color[:, None, None] * alpha * light
        light *= 1 - alpha
    found = render_reference(workload, workload.image_gradient(), NONE).color
    torch.testing.assert_close(found, image, rtol=0, atol=1e-13)


def test_errors_are_those_of_their_definition() -> None:
    truth = Rendered(torch.zeros(3, 2, 2), {"mean": torch.tensor([3.0, 4.0]), "sh": torch.zeros(2)})
    found = Rendered(torch.full((3, 2, 2), 0.1), {"mean": torch.tensor([3.0, 4.5]), "sh": torch.ones(2)})
    errors = Errors.of(found, truth)
    assert errors.image_max == errors.image_rms == pytest.approx(0.1) and errors.psnr == pytest.approx(20)
    assert errors.gradient_rms == pytest.approx(0.1)  # 0.5 / 5; sh, on which the loss does not depend, is left out
    assert errors.gradient_max == pytest.approx(0.125)  # 0.5 / 4
    assert Errors.of(truth, truth).psnr == math.inf


# ---- Builds ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def kernels() -> dict[str, ModuleType | Narrowed]:
    """All that are built here, side by side: a compiler takes a minute for one."""
    names = (DEFAULT, "min_presence_0_0001", "sh_float16", "sh_bfloat16", "float64")
    (build.SOURCE / "build").mkdir(exist_ok=True)
    with open(build.SOURCE / "build" / ".variants.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # tests of this file may run in several processes
        return load_variants([by_name(name) for name in names])


def test_a_later_temporal_cut_off_takes_more_gaussians_and_errs_less(kernels) -> None:
    variant = by_name("min_presence_0_0001")
    built = {name: kernels[name] for name in (variant.name, DEFAULT)}
    assert built[DEFAULT] is kernel and built[variant.name].choices["min_presence"] == 1e-4
    workload = make_workload("W1").cropped(24)
    d_color = workload.image_gradient()
    truth, same = (
        render_reference(workload, d_color, thresholds) for thresholds in (NONE, variant.choices.thresholds())
    )
    later, default = (render_kernel(built[name], workload, d_color) for name in (variant.name, DEFAULT))
    assert Errors.of(later, truth).image_rms < Errors.of(default, truth).image_rms
    assert Errors.of(later, truth).gradient_rms < Errors.of(default, truth).gradient_rms
    assert Errors.of(later, same).image_rms < 1e-5  # it does what the twin does with that cut-off: float32 apart
    alive = {}
    for name, module in built.items():
        frame = Rasterizer(1, module)
        frame.render(workload.gaussians, workload.request())
        alive[name] = frame.alive
    # p(t) >= c keeps |t - μt| <= σt √(-2 ln c), and W1's moments are uniform beyond both ends
    assert alive[variant.name] > 1.1 * alive[DEFAULT]
    times = time_kernels(built, workload, rounds=1)
    assert {name: timing.alive for name, timing in times.items()} == alive
    assert all(timing.milliseconds >= timing.forward_ms > 0 for timing in times.values())


@pytest.mark.parametrize(
    "name, stored, narrow", [("sh_float16", "Float16", torch.float16), ("sh_bfloat16", "Bfloat16", torch.bfloat16)]
)
def test_a_kernel_with_narrow_coefficients_reads_them_exactly(
    kernels, name: str, stored: str, narrow: torch.dtype
) -> None:
    """Every 16-bit number is a float32: the same bits as the kernel's own of coefficients rounded beforehand."""
    built = kernels[name]
    assert built.choices == kernel.choices | {"sh_type": stored}
    for degree in (3, 1):  # rows of whole registers, and of less than one
        rng = generator(3)
        gaussians = random_gaussians(60, "full", rng, sh_degree=degree).to(torch.float32)
        gaussians.sh[:20] *= 1e-6  # denormal in float16, where some become zero
        rounded = replace(gaussians, sh=gaussians.sh.to(narrow).float())
        assert not torch.equal(rounded.sh, gaussians.sh)
        given, same = (Workload(g, off_centre_camera(), time=0.4, duration=1.0) for g in (gaussians, rounded))
        d_color = given.image_gradient()
        found, expected = render_kernel(built, given, d_color), render_kernel(kernel, same, d_color)
        assert torch.equal(found.color, expected.color)
        for field, gradient in expected.gradients.items():
            assert torch.equal(found.gradients[field], gradient), field


@pytest.mark.parametrize("motion", ["static", "separable", "full"])
def test_the_float64_kernel_is_the_float64_twin(kernels, motion: Motion) -> None:
    """In every output. Doubles round to 1e-16; sums over pixels and the way back to parameters cost a few digits."""
    built = kernels["float64"]
    assert built.choices == kernel.choices | {"float64": True}
    rng, outputs = generator(4), outputs_of(motion)
    gaussians = random_gaussians(60, motion, rng)
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


def test_no_compiler_is_said_in_one_line(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("CXX", str(tmp_path / "no_such_compiler"))
    with pytest.raises(BuildError) as error:
        load_variants([by_name("exp_degree_5")], tmp_path)
    assert "no_such_compiler" in str(error.value) and "\n" not in str(error.value)


def test_no_cmake_is_said_in_one_line(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda *_, **__: None)
    with pytest.raises(BuildError, match="^work-precision: expected cmake .* found none") as error:
        load_variants([by_name("exp_degree_5")], tmp_path)
    assert "\n" not in str(error.value)


# ---- The front and what is written of it -------------------------------------------------------------------


def test_the_front_is_what_no_other_point_beats() -> None:
    rng = generator(5)
    for n in (1, 2, 7, 40):
        points = torch.randint(0, 6, (n, 2), generator=rng).tolist()  # with ties
        expected = [
            not any(c <= cost and e <= error and (c < cost or e < error) for c, e in points) for cost, error in points
        ]
        assert on_front(*zip(*points)) == expected and any(expected)
    assert on_front([1.0, math.nan, 3.0], [2.0, 1.0, 1.0]) == [True, False, True]
    assert on_front([1.0, 1.0], [2.0, 2.0]) == [True, True]


def test_what_differs_by_less_than_the_margin_is_equal() -> None:
    cost, error = [100.0, 99.0, 101.0, 90.0], [1.0, 1.005, 0.5, 2.0]
    assert on_front(cost, error) == [True, True, True, True]
    assert on_front(cost, error, (0.03, 0.01)) == [False, False, True, True]  # half the error in as much time
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


def test_verdicts_follow_from_the_numbers() -> None:
    noise, together, alpha, degree = verdicts(POINTS)
    assert "2.0 %" in noise
    assert alpha == (
        "Alpha cut-off: the default is on the front of time and maximum image error; "
        "on the front of time and gradient error."
    )
    assert degree.startswith(
        'Exp degree: the default is not on the front of time and maximum image error: "label of '
        'better" takes 25.0 % less time, its error is 4.0e-02 against 5.0e-02'
    )
    assert "not on the front" in together
    again = [*POINTS, point("again", "built again", 18.0, 0.05)]
    assert "10.0 %" in verdicts(again)[0]
    level = point("level", "exp degree", 19.9, 0.0498)
    assert " not " not in verdicts([p if p.name != "better" else level for p in POINTS])[3]  # noise is 2 %


def test_tables_hold_every_point_and_leave_unmeasured_times_empty() -> None:
    rows = list(csv.DictReader(io.StringIO(comma_separated(POINTS))))
    assert [row["name"] for row in rows] == [p.name for p in POINTS]
    assert rows[-1]["milliseconds"] == "" and float(rows[0]["errors_image_max"]) == 0.1
    assert [row["on_image_front"] for row in rows] == ["1", "0", "0", "1", "0"]
    text = markdown(POINTS, "where and when")
    assert "where and when" in text and text.count("\n| ") == 1 + len(POINTS) and "n/a" in text


def test_the_same_numbers_draw_the_same_plot() -> None:
    first = draw(POINTS, "title")
    assert first == draw(POINTS, "title") and "Pareto front" in first and "narrow" not in first


def test_thresholds_of_a_trade_off_are_set_to_zero_and_the_others_kept() -> None:
    assert without(Thresholds(0.1, 0.2, 0.3), TRADES["alpha cut-off"]) == Thresholds(0.1, 0, 0.3)
    assert without(Thresholds(0.1, 0.2, 0.3), TRADES["several at once"]) == NONE
