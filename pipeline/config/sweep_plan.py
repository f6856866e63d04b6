"""The runs of a sweep before it starts: their folders and how much work each is."""

from __future__ import annotations

from collections.abc import Sequence

from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig

from pipeline.config.compose import CONFIG_DIR

MULTIRUN = ("-m", "--multirun")


def one_per_experiment(arguments: Sequence[str]) -> list[list[str]]:
    """`experiment=a,b …` as two commands, `experiment=a …` and `experiment=b …`; any other command as it is."""
    for place, argument in enumerate(arguments):
        key, _, names = argument.partition("=")
        if key == "experiment" and "," in names:
            return [[*arguments[:place], f"experiment={name}", *arguments[place + 1 :]] for name in names.split(",")]
    return [list(arguments)]


def planned_work(commands: Sequence[Sequence[str]]) -> dict[str, float]:
    """Run folder -> work, of all runs of all sweeps among the commands. Raises what Hydra raises."""
    work: dict[str, float] = {}
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        for command in commands:
            if all(argument in MULTIRUN or not argument.startswith("-") for argument in command):
                work |= _work_of(command)
    return work


def _work_of(command: Sequence[str]) -> dict[str, float]:
    overrides = [argument for argument in command if argument not in MULTIRUN]
    if len(overrides) == len(command) and not any(override.startswith("experiment=") for override in overrides):
        return {}
    loader = GlobalHydra.instance().config_loader()
    hydra = loader.load_configuration("config", overrides, RunMode.MULTIRUN).hydra
    if len(overrides) == len(command) and hydra.mode != RunMode.MULTIRUN:
        return {}
    swept = [f"{key}={values}" for key, values in (hydra.sweeper.params or {}).items()]
    jobs = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides([*swept, *overrides]), None)[0]
    work: dict[str, float] = {}
    composed: dict[tuple[str, ...], DictConfig] = {}  # of all seeds: composing takes a tenth of a second
    for job in jobs:
        others = tuple(override for override in job if not override.startswith("seed="))
        cfg = composed[others] = composed.get(others) or compose("config", list(job))
        cfg.seed = next((int(override[5:]) for override in job if override.startswith("seed=")), cfg.seed)
        work[cfg.out] = float(cfg.train.iterations * cfg.train.batch * cfg.scene.size**2)
    return work
