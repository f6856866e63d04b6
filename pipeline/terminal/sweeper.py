"""Hydra's sweeper for this program: the runs of a sweep, each once, as one list for the launcher."""

from __future__ import annotations

import shlex
import sys
from copy import deepcopy
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.config_loader import ConfigLoader
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, flag_override

from datasets.files.claim import wait_until_free
from pipeline.terminal import sweep_progress
from pipeline.terminal.command_line import quiet_on_closed_pipe


def register_sweeper(sweeper: type[Sweeper]) -> None:
    """What the `_target_` of conf/hydra/sweeper/runs.yaml is to Hydra, which takes plugins of that package only."""
    Plugins.instance().class_name_to_class["hydra_plugins.pipeline.RunSweeper"] = sweeper


# Of what launchers raise where a worker died: joblib's, Ray's, submitit's.
_DIED = {"BrokenProcessPool", "RayError", "UncompletedJobError"}
_DEATHS = 3


class RunSweeper(Sweeper):
    """Launches the runs of a sweep. A failed run stops no other; then the exit status is 1.

    Runs that another process is at work on, as the same sweep in another shell, are waited for and looked at again. All
    are launched again where the launcher lost a worker: finished ones are found done, others go on.
    """

    def __init__(self, **params: Any) -> None:
        """params: of conf/hydra/sweeper/runs.yaml; `setup` gets them too."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        """task_function: returns whether the run ended well; None: another process is at work in its folder."""
        self._loader, self._config = hydra_context.config_loader, config
        self._launcher = Plugins.instance().instantiate_launcher(
            hydra_context=hydra_context, task_function=task_function, config=config
        )

    def sweep(self, arguments: list[str]) -> None:
        """arguments: of the command line. Raises what `planned_runs` raises, before anything is launched."""
        runs = planned_runs(self._loader, self._config, arguments)
        left, failed, deaths = dict(runs), False, 0
        with sweep_progress.sweep({out: run.work for out, run in runs.items()}):
            while left:
                try:
                    results = self._launcher.launch([run.overrides for run in left.values()], initial_job_idx=0)
                except Exception as error:
                    if not _DIED & {base.__name__ for base in type(error).__mro__}:
                        raise
                    deaths += 1
                    if deaths == _DEATHS:
                        raise ChildProcessError(
                            f"sweep: expected its workers to live, found that one died, {deaths} times; the same "
                            f"command goes on with what is left ({str(error).strip().splitlines()[0]})"
                        ) from error
                    continue
                values = [result.return_value for result in results]
                failed |= False in values
                left = {out: run for (out, run), value in zip(left.items(), values) if value is None}
                for out in left:
                    wait_until_free(Path(out))
        if failed:
            raise SystemExit(1)


class RunList(RunSweeper):
    """Prints the command of each run of a sweep, a line each, for other programs to run; it launches nothing."""

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        self._loader, self._config = hydra_context.config_loader, config

    @quiet_on_closed_pipe()
    def sweep(self, arguments: list[str]) -> None:
        for run in planned_runs(self._loader, self._config, arguments).values():
            # --run: an experiment that is given alone would be its whole sweep
            print(shlex.join([sys.executable, "-m", "pipeline", "--run", *run.overrides]))


@dataclass(frozen=True)
class PlannedRun:
    overrides: list[str]  # of the command line, as if the run were given alone
    cfg: DictConfig  # without Hydra's own part

    @property
    def work(self) -> float:
        """In any unit, the same for all runs."""
        return float(self.cfg.train.iterations * self.cfg.train.batch * self.cfg.scene.size**2)


def planned_runs(loader: ConfigLoader, sweep: DictConfig, arguments: list[str]) -> dict[str, PlannedRun]:
    """Run folder -> run, in the order in which they are launched; a repeated run once.

    sweep: the command's configuration, with params and runs in `hydra.sweeper`. arguments: of the command line, without
    Hydra's own. Raises ValueError where two runs have one folder, and what Hydra raises.
    """
    swept = [f"{key}={values}" for key, values in sweep.hydra.sweeper.params.items()]
    runs: dict[str, PlannedRun] = {}
    composed: dict[tuple[str, ...], DictConfig] = {}  # of all seeds: composing takes a tenth of a second
    for line in sweep.hydra.sweeper.runs or [""]:
        for overrides in combinations([*swept, *shlex.split(line), *arguments], loader):
            seeds = [override for override in overrides if override.startswith("seed=")]
            others = tuple(override for override in overrides if override not in seeds)
            if others not in composed:
                composed[others] = cfg = loader.load_sweep_config(sweep, list(others))
                with flag_override(cfg, ["struct", "readonly"], False):
                    del cfg["hydra"]
            cfg = deepcopy(composed[others])
            if seeds:
                cfg.seed = seeds[0].removeprefix("seed=")
            first = runs.setdefault(cfg.out, PlannedRun(overrides, cfg))
            if first.cfg != cfg:
                raise ValueError(
                    f"out: expected a folder for each run of the sweep, found {cfg.out} for two that differ in "
                    f"{', '.join(sorted(set(overrides) ^ set(first.overrides)))}; name what differs, as "
                    "out='results/runs/${scene.name}/${train.batch}'"
                )
    return runs


def combinations(arguments: list[str], loader: ConfigLoader | None = None) -> list[list[str]]:
    """The command lines of all runs: `a=1,2 b=3` is a=1 b=3 and a=2 b=3. Of a key given twice, the last counts."""
    values: dict[str, list[str]] = {}
    for override in OverridesParser.create(loader).parse_overrides(arguments):
        swept, key = override.is_sweep_override(), override.get_key_element()
        found = override.sweep_string_iterator() if swept else [override.get_value_element_as_str()]
        values[key] = [f"{key}={value}" for value in found]
    return [list(run) for run in product(*values.values())]
