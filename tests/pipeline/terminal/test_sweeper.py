"""Which runs a sweep has, in which order and folder; and that a failed run stops no other."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from threading import Timer

import pytest
from hydra import initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import DictConfig

from datasets.files.claim import Busy
from pipeline import cli
from pipeline.config.compose import CONFIG_DIR, options, register_schema, to_config
from pipeline.runs.run_folder import RunFolder
from pipeline.terminal.sweeper import PlannedRun, combinations, planned_runs

register_schema()


@functools.cache
def planned(*arguments: str) -> dict[str, PlannedRun]:
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        sweep = loader.load_configuration("config", list(arguments), RunMode.MULTIRUN)
        return planned_runs(loader, sweep, [word for word in arguments if not word.lstrip("+").startswith("hydra.")])


def test_combinations_are_in_the_order_of_the_keys_and_the_last_value_counts() -> None:
    assert combinations(["a=1,2", "b=x", "c=range(2)"]) == [
        ["a=1", "b=x", "c=0"],
        ["a=1", "b=x", "c=1"],
        ["a=2", "b=x", "c=0"],
        ["a=2", "b=x", "c=1"],
    ]
    assert combinations(["a=1,2", "b=3", "a=[4,5]"]) == [["a=[4,5]", "b=3"]]


def test_lines_are_crossed_with_params_and_the_command_line_wins() -> None:
    runs = planned(
        "experiment=smoke",  # scene=synthetic/wheel, all ablations
        "hydra.sweeper.runs=['ablation=full seed=1,2', 'scene=synthetic/lamp ablation=static,full']",
        "+hydra.sweeper.params.seed='7,8'",
        "ablation=no_4dsh,full",
    )
    assert [out.removeprefix("results/runs/synthetic/") for out in runs] == [
        f"{scene}/{ablation}/smoke/seed{seed}"
        for scene, seeds in (("wheel", (1, 2)), ("lamp", (7, 8)))
        for ablation in ("no_4dsh", "full")
        for seed in seeds
    ]
    run = runs["results/runs/synthetic/lamp/full/smoke/seed8"]
    assert (run.cfg.scene.name, run.cfg.ablation.name, run.cfg.seed) == ("synthetic/lamp", "full", 8)
    assert set(run.overrides) == {"experiment=smoke", "scene=synthetic/lamp", "ablation=full", "seed=8"}


def test_a_repeated_run_is_one() -> None:
    runs = planned("experiment=smoke", "hydra.sweeper.runs=['ablation=full', 'ablation=static,full seed=0,1']")
    assert [out.removeprefix("results/runs/synthetic/wheel/") for out in runs] == [
        "full/smoke/seed0",
        "static/smoke/seed0",
        "static/smoke/seed1",
        "full/smoke/seed1",
    ]


def test_two_runs_of_a_sweep_in_one_folder_are_refused() -> None:
    swept = ("scene=synthetic/wheel", "train=smoke", "train.batch=2,4", "seed=0,1")
    with pytest.raises(ValueError, match="synthetic/wheel/full/smoke/seed0 for two that differ in .*batch=2.*batch=4"):
        planned(*swept)
    assert list(planned(*swept, "out=x/${train.batch}/${seed}")) == ["x/2/0", "x/2/1", "x/4/0", "x/4/1"]


@pytest.mark.parametrize("experiment", options("experiment"))
def test_every_run_of_an_experiment_has_a_valid_configuration_and_a_folder(
    experiment: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the first of its scenes, seeds …: composing takes a tenth of a second."""
    monkeypatch.setenv("DATA_DIR", "data")
    file = CONFIG_DIR / "experiment" / f"{experiment}.yaml"
    command = f"python -m pipeline experiment={experiment}"
    assert file.read_text().splitlines()[1].partition("# ")[2].removeprefix("DATA_DIR=/path/to/data ") == command
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        hydra = loader.load_configuration("config", [f"experiment={experiment}"], RunMode.MULTIRUN).hydra
    first = {key: str(values).split(",")[0] for key, values in hydra.sweeper.params.items()}
    if not any("scene=" in line for line in hydra.sweeper.runs or []):  # else its runs name their scenes
        first.setdefault("scene", "synthetic/wheel")
    runs = planned(f"experiment={experiment}", *(f"{key}={value}" for key, value in first.items()), "seed=0")
    assert len(runs) >= (len(hydra.sweeper.runs or [""]) if "scene" in first else 1)
    for out, run in runs.items():
        cfg = to_config(run.cfg)
        assert cfg.out == out and out.startswith("results/runs/") and out.endswith("seed0")
        assert cfg.scene.name == first.get("scene", cfg.scene.name)


def test_reproduce_is_each_scene_each_ablation_on_its_own_scene_and_the_rest_of_table_3() -> None:
    runs = planned("experiment=reproduce")
    scenes = ["counter", "street", "wheel", "lamp", "burst", "still"]  # the longest first, as others run beside it
    assert [out.removeprefix("results/runs/synthetic/") for out in runs] == [
        *(f"{scene}/full/short/seed0" for scene in scenes),
        *(
            f"{scene}/{ablation}/short/seed{seed}"
            for scene, seeds, *parts in (
                ("wheel", 5, "no_4drot"),
                ("lamp", 5, "no_4dsh"),
                ("burst", 3, "no_time_split", "no_error_guided"),
            )
            for ablation in ("full", *parts)
            for seed in range(seeds)
            if (ablation, seed) != ("full", 0)
        ),
        *(
            f"{scene}/{ablation}/short/seed0"
            for scene, own in (("wheel", "no_4drot"), ("lamp", "no_4dsh"), ("burst", "no_time_split"))
            for ablation in ("no_4drot", "no_4dsh", "no_time_split")
            if ablation != own
        ),
    ]
    counter, street, wheel = (runs[f"results/runs/synthetic/{scene}/full/short/seed0"] for scene in scenes[:3])
    assert counter.work / wheel.work == pytest.approx(240**2 / 200**2)
    assert wheel.cfg.threads == 1, "runs side by side"


# --- launched ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """`python -m pipeline` in this process, with a function in place of a run; returns the exit status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    monkeypatch.setenv("PIPELINE_TRACEBACK", "0")

    def run(task: Callable[[DictConfig], bool], *arguments: str) -> int:
        monkeypatch.setattr(cli, "run_one", task)
        monkeypatch.setattr("sys.argv", ["pipeline", *arguments])
        try:
            cli.main()
        except SystemExit as ended:
            return int(ended.code or 0)
        return 0

    return run


def test_a_failed_run_stops_no_other(command: Callable[..., int], tmp_path: Path) -> None:
    begun: list[tuple[str, int]] = []

    def ends_well(cfg: DictConfig) -> bool:
        begun.append((cfg.ablation.name, cfg.seed))
        return True

    def fails(cfg: DictConfig) -> bool:
        return ends_well(cfg) and cfg.ablation.name != "full"

    for task, status in ((ends_well, 0), (fails, 1)):
        begun.clear()
        assert command(task, "experiment=smoke", "ablation=full,no_4dsh", "seed=0,3,0") == status
        assert begun == [("full", 0), ("full", 3), ("no_4dsh", 0), ("no_4dsh", 3)]
    assert list(tmp_path.iterdir()) == []  # Hydra writes nothing of its own


def test_a_run_that_another_process_does_is_waited_for(command: Callable[..., int], tmp_path: Path) -> None:
    """As the same sweep in another shell: its run ends a moment after all others were looked at."""
    theirs = RunFolder(tmp_path / "results/runs/synthetic/wheel/full/smoke/seed0")
    begun: list[int] = []

    def task(cfg: DictConfig) -> bool | None:
        begun.append(cfg.seed)
        try:
            with RunFolder(Path(cfg.out)):
                return True
        except Busy:
            Timer(0.2, theirs.__exit__).start()
            return None

    assert command(task, "-m", "scene=synthetic/wheel", "train=smoke", "seed=0,1") == 0
    assert begun == [0, 1, 0]


def test_without_a_sweep_there_is_one_run(command: Callable[..., int]) -> None:
    begun: list[str] = []
    assert command(lambda cfg: begun.append(cfg.out) or True, "scene=synthetic/wheel", "train=smoke") == 0
    assert begun == ["results/runs/synthetic/wheel/full/smoke/seed0"]


def test_an_interrupted_sweep_says_what_is_kept(
    command: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(cfg: DictConfig) -> bool:
        raise KeyboardInterrupt

    assert command(interrupted, "experiment=smoke") == 130
    said = capsys.readouterr().err
    assert said == "error: interrupted; finished runs are kept, and the same command goes on with the others\n"


def test_a_wrong_key_of_an_experiment_is_named(command: Callable[..., int], capsys: pytest.CaptureFixture[str]) -> None:
    assert command(lambda cfg: True, "experiment=smoke", "train.iteratons=3") == 1
    assert capsys.readouterr().err == "error: train.iteratons: no such key; did you mean train.iterations?\n"


def test_a_bug_in_a_run_is_a_traceback(command: Callable[..., int]) -> None:
    def broken(cfg: DictConfig) -> bool:
        raise AssertionError("a bug")

    with pytest.raises(AssertionError, match="a bug"):
        command(broken, "experiment=smoke", "ablation=full,static")
