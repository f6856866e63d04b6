"""Every file under conf/ composes to a valid configuration, and what a user gets wrong is named in one line."""

from __future__ import annotations

import functools
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from shell import Shell

from pipeline.config.compose import CONFIG_DIR, known_keys, one_line, options, register_schema, to_config
from pipeline.config.schema import Config

# Of these the released program's settings are known.
SCENES_OF_THE_RELEASE = [scene for scene in options("scene") if scene.startswith(("dnerf/", "plenoptic/"))]
register_schema()


SCHEDULE = {"video": "fast", "auto": "fast"}  # of scenes that no paper trained; the others' is `paper`


@functools.cache
def config_of(*overrides: str) -> Config:
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return to_config(compose("config", overrides=list(overrides)))


def complaint(*overrides: str) -> str:
    with pytest.raises(Exception) as caught:
        config_of(*overrides)
    line = one_line(caught.value)
    assert "\n" not in line
    return line


@pytest.mark.parametrize("scene", options("scene"))
def test_every_scene(scene: str) -> None:
    cfg = config_of(f"scene={scene}")
    assert cfg.scene.name == scene
    assert cfg.out == f"results/runs/{scene}/full/{SCHEDULE.get(scene, 'paper')}/seed0"


@pytest.mark.parametrize("family", ["dnerf", "plenoptic", "video"])
@pytest.mark.parametrize(
    "path, folder",
    [("/data/jug", "jug"), ("jug/", "jug"), ("a/../b c", "b c"), (".hidden", "hidden"), ("/data/Küche", "Küche")],
)
def test_a_scene_is_named_after_its_folder(family: str, path: str, folder: str) -> None:
    cfg = config_of(f"scene={family}", f'scene.path="{path}"')
    assert cfg.scene.name == f"{family}/{folder}"
    assert cfg.out == f"results/runs/{family}/{folder}/full/{SCHEDULE.get(family, 'paper')}/seed0"
    assert config_of(f"scene={family}", f'scene.path="{path}"', "scene.name=mine").scene.name == "mine"


@pytest.mark.parametrize("train", options("train"))
def test_every_schedule(train: str) -> None:
    cfg = config_of("scene=dnerf", f"train={train}")
    assert cfg.train.name == train
    assert cfg.train.densify.stop <= cfg.train.iterations
    assert all(at <= cfg.train.iterations for at in cfg.train.orders_at)


@pytest.mark.parametrize("ablation", options("ablation"))
def test_every_ablation(ablation: str) -> None:
    assert config_of("scene=dnerf", f"ablation={ablation}").ablation.name == ablation


@pytest.mark.parametrize("scene", SCENES_OF_THE_RELEASE)
def test_every_scene_of_the_release(scene: str) -> None:
    cfg = config_of(f"scene={scene}", "train=release")
    assert (cfg.train.name, cfg.scene.name) == ("release", scene)
    seconds = 1 if scene.startswith("dnerf") else 10
    assert cfg.train.init_time_scale == pytest.approx((seconds / 5) ** 0.5 / seconds)


@pytest.mark.parametrize("launcher", ["local", "joblib"])
def test_launchers(launcher: str) -> None:
    assert config_of("scene=dnerf", f"launcher={launcher}").threads == (1 if launcher == "joblib" else 0)


def test_slurm_launcher() -> None:
    assert config_of("scene=dnerf", "launcher=slurm").threads == 0  # a job has its cores to itself


def test_a_launcher_whose_package_is_missing() -> None:
    line = complaint("scene=dnerf", "hydra/launcher=ray")  # Hydra has such a plugin; it is not installed here
    assert "ray: no such option; is its package installed?" in line


def test_defaults_are_the_papers() -> None:
    cfg = config_of("scene=dnerf")  # numbers: docs/method.md 2, the last column
    assert (cfg.train.iterations, cfg.train.batch, cfg.train.init_points) == (30_000, 4, 100_000)
    assert cfg.train == Config().train


@pytest.mark.parametrize(
    "scene, batch, points",
    [  # docs/method.md 2.1
        ("bouncingballs", 2, 100_000),
        ("hellwarrior", 1, 100_000),
        ("hook", 8, 300_000),
        ("jumpingjacks", 16, 300_000),
        ("lego", 2, 100_000),
        ("mutant", 8, 300_000),
        ("standup", 8, 300_000),
        ("trex", 24, 300_000),
    ],
)
def test_release_differs_from_scene_to_scene(scene: str, batch: int, points: int) -> None:
    cfg = config_of(f"scene=dnerf/{scene}", "train=release")
    train = cfg.train
    assert (train.batch, train.init_points) == (batch, points)
    assert train.regularization.rigid_released == (1.0 if scene == "lego" else 0.0)
    schedule = (train.iterations, train.lr.decay_iterations, train.densify.every, train.densify.stop)
    assert schedule == ((20_000, 15_000, 200, 10_000) if scene == "bouncingballs" else (30_000, None, 100, 15_000))
    assert cfg.scene.init_box == [-1.3, 1.3] and not train.densify.use_time_gradient


def test_the_command_line_wins_over_every_file() -> None:
    assert config_of("scene=dnerf/trex", "train=release", "train.batch=3").train.batch == 3


@pytest.mark.parametrize(
    "override, expected",
    [
        ("train.iteratons=5", "train.iteratons: no such key; did you mean train.iterations?"),
        ("+train.iteratons=5", "train.iteratons: no such key; did you mean train.iterations?"),
        ("train.lr.facto=5", "train.lr.facto: no such key; did you mean train.lr.factor?"),
        ("trian=fast", "trian: no such key; did you mean train?"),
        ("train=fats", "train=fats: no such option; there are best, fast, "),
        ("scene=dnerf/legs", "scene=dnerf/legs: no such option; there are auto, dnerf, "),
        ("train.iterations=many", "train.iterations: Value 'many' of type 'str' could not be converted to Integer"),
        ("train.iterations=null", "train.iterations: field 'train.iterations' is not Optional"),
        ("train.iterations=[1", "train.iterations=[1: not a key=value that Hydra can read"),
        ("train.iterations=0", "train.iterations: expected at least 1, found 0"),
        ("train.batch=-2", "train.batch: expected at least 1, found -2"),
        ("train.mse_weight=nan", "train.mse_weight: expected >= 0, found nan"),
        ("train.optimiser=best", "train.optimiser: expected adam or sparse_adam, found 'best'"),
        ("train.resolution_steps=[{until: 2}]", "train.resolution_steps.until: expected in (0, 1], found 2.0"),
        ("scene.offsets=[0,1]", "scene.offsets: expected nothing without scene.sync=given, where it is used, found"),
        ("train.densify.space_gradient=0", "train.densify.space_gradient: expected > 0, found 0.0"),
        ("train.lr.decay_iterations=0", "train.lr.decay_iterations: expected at least 1, found 0"),
        ("train.lr.factor=-1", "train.lr.factor: expected >= 0, found -1.0"),
        (
            "scene.background=[0, 0]",
            "scene.background: expected auto, black, white or three values in [0, 1], found [0, 0]",
        ),
        (
            "scene.background=grey",
            "scene.background: expected auto, black, white or three values in [0, 1], found 'grey'",
        ),
        (
            "scene.background=[0, 0, 2]",
            "scene.background: expected auto, black, white or three values in [0, 1], found [0, 0",
        ),
        ("scene.init_box=[1, -1]", "scene.init_box: expected [low, high] with low < high, found [1.0, -1.0]"),
        ("ablation.fourier_order=3", "ablation.fourier_order: expected 0 to 2, found 3"),
        ("evaluate.renders=-5", "evaluate.renders: expected >= -1 (-1: all), found -5"),
        ("threads=-1", "threads: expected >= 0 (0: all), found -1"),
        ("seed=-1", "seed: expected in 0..9223372036854775807, found -1"),
    ],
)
def test_mistakes_are_named_in_one_line(override: str, expected: str) -> None:
    scene = [] if override.startswith("scene=") else ["scene=dnerf"]
    assert complaint(*scene, override).startswith(expected)


def test_an_ablated_part_is_not_trained_under_the_name_of_its_ablation() -> None:
    line = complaint("scene=dnerf", "ablation=no_shared_motion", "train.motion=trajectories")
    assert line.startswith("train.motion: expected other than trajectories under ablation.shared_motion=false")


def test_no_scene() -> None:
    assert complaint().startswith("scene: must be given; there are auto, dnerf, ")


def test_a_typo_in_a_file_names_file_and_key(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / "mine.yaml").write_text("iteratons: 5\n")
    line = complaint("scene=dnerf", "train=mine", f"hydra.searchpath=[file://{tmp_path}]")
    assert line == "conf/train/mine.yaml: train.iteratons: no such key; did you mean train.iterations?"


def test_known_keys_are_the_schemas() -> None:
    keys = known_keys()
    assert {"scene.path", "train.lr.final_factor", "train.densify.stop", "evaluate.lpips", "out"} <= set(keys)
    assert len(keys) == len(set(keys))


@pytest.mark.parametrize("arguments", [["scene=dnerf", "train.iteratons=5"], ["scene=dnerf", "scene.path=not/there"]])
def test_a_failing_command(arguments: list[str], tmp_path: Path) -> None:
    _, err = Shell(tmp_path)(*arguments, status=1)
    assert err.startswith("error: ") and err.count("\n") == 1
    assert "Traceback" not in err
    assert sorted(tmp_path.glob("*")) in ([], [tmp_path / "results"])  # at most our own run folder
