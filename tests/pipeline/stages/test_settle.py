"""The settled configuration: the scene's kind chooses the schedule's file, the command line stays on top."""

from __future__ import annotations

from dataclasses import asdict, replace

import pytest
from tiny import tiny_scene
from tiny_film import unsynchronised_film

from datasets.scene import Scene
from pipeline.config.compose import Command
from pipeline.data.prepare import Prepared
from pipeline.runs.run_identity import flat
from pipeline.stages.settle import changes, decide, for_scene, scaling, schedule_kind

WHEEL = ("scene=synthetic/wheel", "train=fast")
MOVING, STATIC = tiny_scene(), tiny_scene(static=True)
FILM, CLIP = (replace(MOVING, capture=capture) for capture in ("multi_view", "clip"))


def settled(scene: Scene, *overrides: str, decided: dict | None = None) -> dict:
    return flat(asdict(for_scene(Command((*WHEEL, *overrides)), Prepared(scene, None, None), decided or {})))


def differing(one: dict, other: dict) -> set[str]:
    return {key for key in one if one[key] != other[key]}


@pytest.mark.parametrize(
    "scene, kind",
    [
        (MOVING, "unknown"),
        (STATIC, "static"),
        (FILM, "multi_view"),
        (CLIP, "clip"),
        (unsynchronised_film(), "multi_view"),
    ],
)
def test_the_scene_chooses_the_file_of_its_kind(scene: Scene, kind: str) -> None:
    order = Command(WHEEL)
    assert schedule_kind(order.config(), scene) == kind
    assert for_scene(order, Prepared(scene, None, None)).train == order.config(kind).train


def test_each_kind_has_its_own_settings_and_nothing_else_changes() -> None:
    base = settled(MOVING)
    assert settled(STATIC)["train.init_points"] == 60_000 != base["train.init_points"]
    assert (settled(FILM)["train.regularization.opacity"], settled(CLIP)["train.regularization.flow"]) == (0.01, 5.0)
    for scene in (STATIC, FILM, CLIP):
        found = {key for key in differing(settled(scene), base) if not key.startswith("train.")}
        assert found <= {"ablation.static", "ablation.fourier_order"}, "a static model has neither"


def test_the_model_decides_not_the_data() -> None:
    assert settled(MOVING, "ablation=static")["train.init_points"] == 60_000
    assert settled(STATIC, "ablation.static=false")["train.init_points"] == 20_000


@pytest.mark.parametrize("scene", [MOVING, STATIC, FILM, CLIP])
def test_the_command_line_wins_on_every_kind_of_scene(scene: Scene) -> None:
    given = settled(scene, "train.regularization.opacity=0.5", "train.lr={sh_rest: 0.25}")
    assert (given["train.regularization.opacity"], given["train.lr.sh_rest"]) == (0.5, 0.25)
    assert differing(given, settled(scene)) == {"train.regularization.opacity", "train.lr.sh_rest"}


def test_nothing_is_left_to_decide() -> None:
    for scene, static in ((MOVING, False), (STATIC, True)):
        found = settled(scene, "scene.may_be_static=true")
        assert found["ablation.static"] is static and found["scene.background"] == [0.0, 0.0, 0.0]
        assert found["init.source"] == "random"
        assert not found["scene.may_be_static"] and not found["train.select"]


def test_validation_takes_its_part_out() -> None:
    assert settled(MOVING, decided={"fourier_order": 0})["ablation.fourier_order"] == 0
    found = settled(CLIP, decided={"static": True})
    assert found["ablation.static"] is True and found["ablation.fourier_order"] == 0
    assert (found["train.init_points"], found["train.regularization.flow"]) == (60_000, 5.0)  # static, of a clip


@pytest.mark.parametrize(
    "overrides, found",
    [
        ((), {}),
        (("seed=3", "threads=2", "out=x", "evaluate.lpips=false", "ablation=no_4dsh"), {}),
        (("train.batch=2", "scene.size=48"), {"train.batch": 2, "scene.size": 48}),
        (("train.batch=4",), {}),  # as it is anyway
        (("train.name=mine", "ablation.sh_degree=1"), {"ablation.sh_degree": 1}),
    ],
)
def test_a_run_says_what_its_command_changed(overrides: tuple[str, ...], found: dict) -> None:
    assert changes(Command((*WHEEL, *overrides)), MOVING) == found


def test_shared_motion_has_a_file_of_its_own() -> None:
    found = settled(MOVING, decided={"shared_motion": True})
    assert (found["train.motion"], found["train.regularization.rigid"]) == ("trajectories", 0.02)
    assert settled(MOVING)["train.motion"] == "tracks"
    for scene in (FILM, CLIP, STATIC):  # it is not compared there
        assert settled(scene)["train.motion"] != "trajectories"
    assert settled(MOVING, "train.iterations=77", decided={"shared_motion": True})["train.iterations"] == 77


def test_fewer_iterations_take_the_schedule_with_them() -> None:
    """`fast`: 5000 iterations, densification from 300 to 3500."""
    found = settled(MOVING, "train.iterations=500", "train.orders_at=[1,2,3,7,8]", "train.densify={start: 33}")
    assert found["train.densify.stop"] == 350
    assert (found["train.orders_at"], found["train.densify.start"]) == ([1, 2, 3, 7, 8], 33), "what is given stays"
    assert found["train.densify.every"] == 100, "intervals stay"
    more = settled(MOVING, "train.iterations=10000", decided={"shared_motion": True})
    assert more["train.densify.stop"] == 4 * 1750
    in_preset = settled(MOVING, "train.iterations=5000")
    assert in_preset == settled(MOVING)


def test_what_was_scaled_is_said_in_a_line_and_is_no_change_of_the_command() -> None:
    command = Command((*WHEEL, "train.iterations=500", "train.orders_at=[1,2,3,7,8]"))
    line = scaling(command, MOVING, {})
    assert line is not None and line.startswith("train.iterations=500 of 5000: scaled with it are ")
    assert "train.densify.stop=350" in line and "orders_at" not in line
    assert changes(command, MOVING) == {"train.iterations": 500, "train.orders_at": [1, 2, 3, 7, 8]}
    assert scaling(Command(WHEEL), MOVING, {}) is None


def test_a_time_budget_says_that_nothing_is_compared() -> None:
    lines: list[str] = []
    found = decide(Command((*WHEEL, "train.time_budget_s=9")), Prepared(MOVING, None, None), lines.append)
    assert found == {"decided": {}, "compared": {}, "seconds": 0, "cpu_seconds": 0}
    assert lines == ["settle: nothing is compared, as all of train.time_budget_s is for the schedule"]
