"""The runs of a sweep before it starts: their overrides, their folders and how much work each is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.types import RunMode
from omegaconf import DictConfig

from pipeline.config.compose import CONFIG_DIR

MULTIRUN = ("-m", "--multirun")


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep."""

    overrides: tuple[str, ...]  # of the command line, as if the run were given alone
    launcher: str  # the choice of its experiment
    work: float  # in any unit, the same for all runs


def one_per_experiment(arguments: Sequence[str]) -> list[list[str]]:
    """`experiment=a,b …` as two commands, `experiment=a …` and `experiment=b …`; any other command as it is."""
    for place, argument in enumerate(arguments):
        key, _, names = argument.partition("=")
        if key == "experiment" and "," in names:
            return [[*arguments[:place], f"experiment={name}", *arguments[place + 1 :]] for name in names.split(",")]
    return [list(arguments)]


def planned_sweeps(commands: Sequence[Sequence[str]]) -> list[dict[str, PlannedRun]]:
    """For each command: run folder -> run, in the sweep's order; nothing for what is no sweep. Raises what Hydra
    raises, and ValueError where two runs of a sweep have one folder."""
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        return [
            _runs_of(command) if all(argument in MULTIRUN or argument[:1] != "-" for argument in command) else {}
            for command in commands
        ]


def merged(sweeps: Sequence[dict[str, PlannedRun]]) -> dict[str, PlannedRun]:
    """Run folder -> run, of all sweeps in their order; a run that two have is the first's."""
    runs: dict[str, PlannedRun] = {}
    for sweep in sweeps:
        runs |= {out: run for out, run in sweep.items() if out not in runs}
    return runs


def _runs_of(command: Sequence[str]) -> dict[str, PlannedRun]:
    overrides = [argument for argument in command if argument not in MULTIRUN]
    if len(overrides) == len(command) and not any(override.startswith("experiment=") for override in overrides):
        return {}
    loader = GlobalHydra.instance().config_loader()
    hydra = loader.load_configuration("config", overrides, RunMode.MULTIRUN).hydra
    if len(overrides) == len(command) and hydra.mode != RunMode.MULTIRUN:
        return {}
    swept = [f"{key}={values}" for key, values in (hydra.sweeper.params or {}).items()]
    jobs = BasicSweeper.split_arguments(OverridesParser.create().parse_overrides([*swept, *overrides]), None)[0]
    runs: dict[str, PlannedRun] = {}
    composed: dict[tuple[str, ...], DictConfig] = {}  # of all seeds: composing takes a tenth of a second
    for job in jobs:
        others = tuple(override for override in job if not override.startswith("seed="))
        cfg = composed[others] = composed.get(others) or compose("config", list(job), return_hydra_config=True)
        cfg.seed = next((int(override[5:]) for override in job if override.startswith("seed=")), cfg.seed)
        work = float(cfg.train.iterations * cfg.train.batch * cfg.scene.size**2)
        with _choices_of(cfg):
            run, out = PlannedRun(tuple(job), hydra.runtime.choices.launcher, work), cfg.out
        if runs.setdefault(out, run).overrides != run.overrides:
            differing = sorted(set(run.overrides) ^ set(runs[out].overrides))
            raise ValueError(
                f"out: expected a folder for each run of the sweep, found {out} for two that differ in "
                f"{', '.join(differing)}; name what differs, as out='results/runs/${{scene.name}}/${{train.batch}}'"
            )
    return runs


@contextmanager
def _choices_of(cfg: DictConfig) -> Iterator[None]:
    """Interpolations such as ${hydra:runtime.choices.variant} are those of `cfg`, composed with Hydra's own part."""
    state, before = HydraConfig.instance(), HydraConfig.instance().cfg
    state.set_config(cfg)
    try:
        yield
    finally:
        state.cfg = before
