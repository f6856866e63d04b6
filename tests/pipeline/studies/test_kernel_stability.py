"""Kernel stability: every case within its bounds, a random search for worse ones, and errors for invalid arguments.

Bounds are those of pipeline/studies/kernel_stability/cases.py: 1e-3 of full scale in images, 1e-3 of the largest in
gradients, away from discontinuities. A case takes 3 optimiser steps here, and 100 in the study.
"""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.studies.kernel_stability import textbook_formulas
from pipeline.studies.kernel_stability.__main__ import Row, main
from pipeline.studies.kernel_stability.cases import BOUND, CASES, SLOW, VALUES, Case
from pipeline.studies.kernel_stability.instruction_sets import Spread, largest_difference, measure_spread, same_bits
from pipeline.studies.kernel_stability.measure import kernel_indefinite, measure, shown
from pipeline.studies.kernel_stability.scenes import FAMILIES, base_gaussians, base_request
from rasterizer import Gaussians, Request, rasterize
from rasterizer.kernel_loader import available_isas, source_hash
from rasterizer.reference import render as reference
from rasterizer.reference.discontinuities import away_from_discontinuities

KERNEL = partial(rasterize, threads=1)
# Cases that compare no Gaussian, as none is visible or all are next to the cut-off: images and gradients are finite.
EMPTY = {
    *(f"cut_off {part:g}" for part in VALUES["cut_off"] if part > 0.995),
    *(f"outside_the_video {time:g}" for time in VALUES["outside_the_video"]),
    *(f"opacity {logit:g}" for logit in VALUES["opacity"] if logit < -math.log(254)),  # below 1/255
    "stack -100",
    "count 0",
}
FIELDS = ("mean", "log_scale", "quat_left", "quat_right", "opacity_logit", "sh")
PROGRAMS = pytest.mark.parametrize(
    "program, dtype", [(KERNEL, torch.float32), (reference.rasterize, torch.float64)], ids=["kernel", "reference"]
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_case_is_within_its_bounds(case: Case):
    row = Row(
        case,
        {"kernel": measure(KERNEL, kernel_indefinite, *case.scene(), steps=min(3, case.most_steps))},
        measure_spread(*case.scene()),
    )
    assert not row.violations


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_case_compares_gaussians_unless_it_says_so(case: Case):
    """Where none is in view any two programs agree."""
    gaussians, request = case.scene()
    assert (shown(away_from_discontinuities(gaussians, request), request) == 0) == (case.name in EMPTY)


def test_cases_cover_all_families_and_have_unique_names():
    assert {case.family for case in CASES} == set(FAMILIES)
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:  # other bounds have a reason
        assert case.why or (case.image_bound, case.gradient_bound) == (BOUND, BOUND)


@settings(derandomize=True, deadline=None, max_examples=120, database=None)
@given(st.sampled_from([name for name in FAMILIES if name not in SLOW]), st.floats(0, 1), st.integers(0, 999))
def test_search_finds_no_violation(name: str, place: float, seed: int):
    family = FAMILIES[name]
    value = (
        family.low * (family.high / family.low) ** place
        if family.low > 0
        else family.low + (family.high - family.low) * place
    )
    case = Case(name, value, seed=seed)
    assert not Row(case, {"kernel": measure(KERNEL, kernel_indefinite, *case.scene(), steps=0)}).violations


def test_textbook_formulas_violate_the_bounds():
    """Otherwise the cases would show nothing: a needle of thousands of pixels has an indefinite float32 covariance."""
    gaussians, request = Case("long_needle", 1e6).scene()
    request = replace(request, outputs=textbook_formulas.OUTPUTS)
    errors = measure(textbook_formulas.rasterize, textbook_formulas.indefinite, gaussians, request, 0)
    assert errors.image > BOUND and errors.indefinite > 0


def test_textbook_formulas_equal_the_reference_in_float64():
    gaussians, request = base_gaussians(24, 0), replace(base_request(), outputs=textbook_formulas.OUTPUTS)
    errors = measure(textbook_formulas.rasterize, textbook_formulas.indefinite, gaussians, request, 0, torch.float64)
    assert max(errors.image, errors.gradient) < 1e-10 and errors.indefinite == 0


def test_command_writes_tables_and_reports_the_bounds(tmp_path, capsys):
    assert main(["--steps", "1", "--only", "count", "--out", str(tmp_path)]) == 0
    assert "1 of 1 cases are within their bounds, 1 compare nothing" in capsys.readouterr().out
    with open(tmp_path / "kernel_stability.csv", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["value"], row["program"]) for row in rows] == [
        (value, program) for value in ("0", "1") for program in ("kernel", "reference", "textbook")
    ]
    assert [bool(row["isas_image"]) for row in rows] == [True, False, False] * 2
    text = (tmp_path / "kernel_stability.md").read_text(encoding="utf-8")
    assert "| count | number of Gaussians | 1 of 2 |" in text and all(isa in text for isa in available_isas())
    assert f"kernel {source_hash()}" in text


def test_violations_are_named_and_nan_is_one():
    errors = measure(KERNEL, kernel_indefinite, *Case("count", 1).scene(), steps=0)
    case = Case("count", 1, image_bound=0.0)
    assert "image" in Row(case, {"kernel": errors}).violations[0]
    for value in (math.nan, math.inf):
        assert Row(replace(case, steps_bound=math.inf), {"kernel": replace(errors, image=0.0, steps=value)}).violations


def test_instruction_sets_differ_by_rounding_and_threads_do_not():
    """float32 rounds to 6e-8; sums over pixels and the backward pass lose about a hundred times that."""
    spread = measure_spread(*Case("needle", 1).scene())
    assert spread.changed_by_threads == ()
    assert spread.image < 1e-5 and spread.gradient < 1e-4
    if len(available_isas()) > 1:  # exp2 and 1/x differ: equal bits would mean the same kernel twice
        assert spread.image > 0 and spread.gradient > 0


def test_largest_difference_is_over_all_pairs():
    one, two, three = (torch.tensor([1.0, value]) for value in (2.0, 2.5, 1.5))
    assert largest_difference([one, two, three], 4.0) == pytest.approx(0.25)  # (2.5 - 1.5) / 4
    assert largest_difference([one], 4.0) == 0
    assert largest_difference([one, torch.tensor([1.0, math.nan])], 4.0) == math.inf


def test_same_bits_of_nan_and_signed_zero():
    zero, nan = torch.zeros(2), torch.full((2,), math.nan)
    assert same_bits(zero, zero.clone()) and same_bits(nan, nan.clone())
    assert not same_bits(zero, -zero) and not same_bits(zero, nan)


def test_spread_and_thread_dependence_are_violations():
    errors, case = measure(KERNEL, kernel_indefinite, *Case("count", 1).scene(), steps=0), Case("count", 1)
    spread = Spread(1e-6, 1e-6, ())
    assert not Row(case, {"kernel": errors}, spread).violations
    for changes, named in (
        ({"image": 2e-3}, "image between"),
        ({"gradient": math.inf}, "gradient between"),
        ({"changed_by_threads": ("v3",)}, "bits on 2 threads"),
    ):
        violations = Row(case, {"kernel": errors}, replace(spread, **changes)).violations
        assert len(violations) == 1 and named in violations[0]


# ---- Large times ----


def test_times_at_the_epoch_are_distinguished():
    """Two times 0.1 s apart at 1e9 s are equal in float32; their images differ."""
    gaussians = base_gaussians(20, 3)
    gaussians.mean[:, 3], gaussians.log_scale[:, 3] = 1_000_000_000.0, math.log(0.3)  # 1e9 is a float32
    single = replace(gaussians, quat_right=None).to(torch.float32)
    camera = base_request().camera
    images = [rasterize(single, camera, time=1_000_000_000.0 + late).color for late in (0.1, 0.2)]
    assert (images[0] - images[1]).abs().max() > 0.01
    near_zero = replace(single, mean=single.mean * torch.tensor([1.0, 1, 1, 0]))
    torch.testing.assert_close(images[0], rasterize(near_zero, camera, time=0.1).color, rtol=0, atol=1e-5)


# ---- Invalid arguments ----


def error_of(program, gaussians: Gaussians, **arguments) -> str:
    with pytest.raises(ValueError) as error:
        program(gaussians, base_request().camera, **arguments)
    assert "\n" not in str(error.value)
    return str(error.value)


@PROGRAMS
@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_error_names_a_non_finite_parameter_and_its_row(program, dtype, field: str, value: float):
    gaussians = base_gaussians(5, 0).to(dtype)
    getattr(gaussians, field)[3] = value
    message = error_of(program, gaussians)
    assert message.startswith(f"{field}[3") and "must be finite" in message and str(value) in message


@pytest.mark.parametrize("field", FIELDS)
def test_error_names_a_wrong_shape(field: str):
    gaussians = base_gaussians(5, 0)
    with pytest.raises(ValueError, match=rf"^{field if field != 'mean' else 'log_scale'} must be .*, got .*$"):
        replace(gaussians, **{field: getattr(gaussians, field)[:4]})


@pytest.mark.parametrize("field", FIELDS[1:])
def test_error_names_a_wrong_dtype(field: str):
    gaussians = base_gaussians(5, 0)
    with pytest.raises(ValueError, match=rf"^{field} must be torch.float64 as mean is, got torch.float32$"):
        replace(gaussians, **{field: getattr(gaussians, field).float()})


@PROGRAMS
def test_integer_parameters_are_an_error(program, dtype):
    assert error_of(program, base_gaussians(5, 0).to(torch.int32)).startswith("mean must be")


@PROGRAMS
@pytest.mark.parametrize(
    "name, value",
    [
        ("time", math.nan),
        ("time", math.inf),
        ("time", "noon"),
        ("time", None),
        ("duration", 0.0),
        ("duration", -1.0),
        ("duration", math.nan),
        ("duration", 1e-300),
        ("near", -0.1),
        ("near", math.inf),
        ("background", (0.0, 1.0)),
        ("background", 1.0),
        ("background", (0.0, math.nan, 0.0)),
        ("background", (1e300, 0.0, 0.0)),
        ("outputs", ("colour",)),
        ("sh_degree", 4),
        ("fourier_order", -1),
    ],
)
def test_error_names_an_argument_out_of_range(program, dtype, name: str, value):
    assert error_of(program, base_gaussians(5, 0).to(dtype), **{name: value}).startswith(f"{name} must be")


@pytest.mark.parametrize(
    "changes, named",
    [
        ({"width": 0}, "width"),
        ({"height": 2.5}, "height"),
        ({"width": "3"}, "width"),
        ({"fx": 0.0}, "fx"),
        ({"cy": math.nan}, "intrinsics"),
        ({"world_to_cam": np.zeros((4, 4))}, "world_to_cam"),
        ({"world_to_cam": np.full((4, 4), math.inf)}, "world_to_cam"),
        ({"world_to_cam": np.eye(3)}, "world_to_cam"),
    ],
)
def test_invalid_camera_is_an_error(changes: dict, named: str):
    with pytest.raises(ValueError, match=named) as error:
        replace(base_request().camera, **changes)
    assert str(error.value).startswith("camera: ") and "\n" not in str(error.value)


@pytest.mark.parametrize("flow_dt", [None, math.nan, -math.inf, 1e300])
def test_flow_without_flow_dt_is_an_error(flow_dt: float | None):
    with pytest.raises(ValueError, match="^flow_dt must be a number up to"):
        Request(base_request().camera, outputs=("flow",), flow_dt=flow_dt)
