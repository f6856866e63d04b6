"""The schedule at the iterations given in docs/method.md 2."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.config.train_schema import LearningRates, ResolutionStep, TrainConfig
from pipeline.training.schedule import Passing, clock_at, is_evaluated, learning_rates, phase, shortened

EXTENT = 4.4


def test_the_rate_of_positions_is_log_linear_and_that_of_time_constant() -> None:
    cfg = LearningRates()
    for now, expected in [(0, 1.6e-4), (15_000, 1.6e-5), (30_000, 1.6e-6), (40_000, 1.6e-6)]:
        x, y, z, t = learning_rates(now, 30_000, cfg, EXTENT)["mean"]
        # 1e-12: thousands of float64 rounding errors
        assert x == y == z == pytest.approx(expected * EXTENT, rel=1e-12)
        assert t == pytest.approx(1.6e-4 * EXTENT, rel=1e-12)


def test_the_rate_of_times_decays_where_that_is_set() -> None:
    cfg = LearningRates(factor=2, time_decay=True, decay_iterations=10_000)
    for now, expected in [(0, 3.2e-4), (5_000, 3.2e-5), (10_000, 3.2e-6), (40_000, 3.2e-6)]:
        assert learning_rates(now, 30_000, cfg, EXTENT)["mean"] == pytest.approx((expected * EXTENT,) * 4, rel=1e-12)


def test_trajectories_reach_as_far_in_a_short_schedule() -> None:
    whole, short = (learning_rates(0, iterations, LearningRates(), EXTENT) for iterations in (2500, 250))
    assert short["trajectories"] == pytest.approx(10 * whole["trajectories"], rel=1e-12)
    assert short["weights"] == pytest.approx(10**0.5 * whole["weights"], rel=1e-12)
    assert learning_rates(0, 5000, LearningRates(), EXTENT)["trajectories"] == whole["trajectories"]


def test_rates_without_decay() -> None:
    r = learning_rates(12_345, 30_000, LearningRates(), EXTENT)
    assert (r["log_scale"], r["quat_left"], r["quat_right"], r["opacity_logit"]) == ((5e-3,) * 4, 1e-3, 1e-3, 5e-2)
    assert r["sh"] == (2.5e-3, 1.25e-4, 1.25e-4, 1.25e-4)


def test_sh_coefficients_of_view_time_and_both_have_their_own_rates() -> None:
    cfg = LearningRates(sh_rest=1e-4, sh_time=1e-3, sh_view_time=3e-5)
    assert learning_rates(1, 100, cfg, EXTENT)["sh"] == (2.5e-3, 1e-4, 1e-3, 3e-5)
    assert learning_rates(1, 100, LearningRates(sh_rest=1e-4), EXTENT)["sh"] == (2.5e-3, 1e-4, 1e-4, 1e-4)


def test_the_final_factor_applies_to_every_rate() -> None:
    plain, decayed = (
        learning_rates(100, 100, LearningRates(), EXTENT),
        learning_rates(100, 100, LearningRates(final_factor=0.1), EXTENT),
    )
    for name, rate in plain.items():
        for a, b in zip(*(r if isinstance(r, tuple) else (r,) for r in (rate, decayed[name]))):
            assert b == pytest.approx(0.1 * a, rel=1e-12), name


@pytest.mark.parametrize("fraction, factor", [(0.0, 1.0), (0.7, 1.0), (0.85, 0.1), (1.0, 0.01)])
def test_rates_are_constant_before_the_decay(fraction: float, factor: float) -> None:
    held = learning_rates(100 * fraction, 100, LearningRates(final_factor=0.01), EXTENT)
    assert held["opacity_logit"] == pytest.approx(factor * 5e-2, rel=1e-12)


@pytest.mark.parametrize(
    "now, degree, order",
    [(1, 0, 0), (999, 0, 0), (1000, 1, 0), (2000, 2, 0), (3000, 3, 0), (3999, 3, 0), (4000, 3, 1), (5000, 3, 2)],
)
def test_sh_degrees_and_fourier_orders_are_activated_in_steps(now: int, degree: int, order: int) -> None:
    found = phase(now, TrainConfig(), EXTENT, 3, 2)
    assert (found.sh_degree, found.fourier_order) == (degree, order)
    limited = phase(now, TrainConfig(), EXTENT, 1, 0)
    assert (limited.sh_degree, limited.fourier_order) == (min(degree, 1), 0)


def test_resolution_steps_are_fractions_of_the_schedule() -> None:
    cfg = TrainConfig(
        iterations=1000, resolution_scale=0.5, resolution_steps=[ResolutionStep(0.15, 0.25), ResolutionStep(0.5, 0.5)]
    )
    found = [phase(now, cfg, 1.0, 3, 2).resolution for now in (1, 149, 150, 499, 500, 1000)]
    assert found == [0.125, 0.125, 0.25, 0.25, 0.5, 0.5]
    assert phase(1, TrainConfig(), 1.0, 3, 2).resolution == 1.0
    throughout = TrainConfig(iterations=1000, resolution_steps=[ResolutionStep(scale=0.5)])
    assert [phase(now, throughout, 1.0, 3, 2).resolution for now in (1, 999, 1000)] == [0.5, 0.5, 0.5]


def test_background_models_are_trained_through_the_given_iteration() -> None:
    trained = {now: phase(now, TrainConfig(), EXTENT, 3, 2) for now in (5000.0, 5001.0, 10_000.0, 10_001.0)}
    assert [found.environment_map for found in trained.values()] == [True, False, False, False]
    assert [found.sphere for found in trained.values()] == [True, True, True, False]


def test_evaluations_begin_on_a_logarithmic_grid() -> None:
    assert [i for i in range(1, 1501) if is_evaluated(i, 500)] == [31, 62, 125, 250, 500, 1000, 1500]
    assert [i for i in range(1, 61) if is_evaluated(i, 20)] == [20, 40, 60]  # none before the 30th iteration


def test_the_clock_is_the_iteration_unless_the_time_budget_ends_first() -> None:
    assert clock_at(123, 1e9, TrainConfig()) == 123.0
    cfg = TrainConfig(iterations=1000, time_budget_s=60)
    assert clock_at(100, 3, cfg) == 100.0, "ahead of its budget"
    assert clock_at(100, 30, cfg) == 500.0, "half of the budget is half of the schedule"
    assert clock_at(100, 90, cfg) == 1000.0


def test_a_part_starts_once_though_the_clock_jumps() -> None:
    with_a_budget = Passing(400)
    passed = [with_a_budget.now(i, clock) for i, clock in ((1, 90.0), (2, 399.0), (3, 520.0), (4, 700.0))]
    assert passed == [False, False, True, False]
    every_iteration = Passing(400)
    assert [i for i in range(1, 1001) if every_iteration.now(i, float(i))] == [400]
    assert Passing(400).now(400, 400.0), "a run that continues after iteration 399"
    assert not Passing(400).now(401, 401.0)


@pytest.mark.parametrize("now", [1, 99, 1000, 3000, 4200, 5001, 12_000, 29_990])
def test_a_shortened_schedule_is_the_whole_one_scaled(now: int) -> None:
    cfg = TrainConfig(resolution_steps=[ResolutionStep(0.15, 0.25), ResolutionStep(0.5, 0.5)], time_budget_s=9.0)
    short = shortened(cfg, 0.1)
    assert (short.iterations, short.time_budget_s) == (3000, None)
    whole, scaled = phase(now, cfg, EXTENT, 3, 2), phase(0.1 * now, short, EXTENT, 3, 2)
    assert whole.lr["mean"] == pytest.approx(scaled.lr["mean"], rel=1e-12)  # a few float64 operations
    assert whole.depth_decay == pytest.approx(scaled.depth_decay, rel=1e-12)  # likewise
    # Background models freeze after the same number of iterations.
    same = {"lr": {}, "clock": 0.0, "depth_decay": 0.0, "sphere": True, "environment_map": True}
    assert replace(whole, **same) == replace(scaled, **same)
    assert (short.densify.start, short.densify.stop, short.densify.every) == (50, 1500, cfg.densify.every)
    # What is added by error is removed by pruning only: both keep their pace.
    assert short.densify.add_by_error_every == cfg.densify.add_by_error_every
    assert short.densify.prune_sensitivity_every == cfg.densify.prune_sensitivity_every


def test_shortening_to_1_changes_nothing() -> None:
    assert shortened(TrainConfig(), 1.0) == TrainConfig()
