"""Several sweeps as one: their runs are one list, so that a core which has finished one sweep begins with the next."""

from __future__ import annotations

from collections.abc import Sequence

from hydra import initialize_config_dir
from hydra._internal.callbacks import Callbacks
from hydra.core.global_hydra import GlobalHydra
from hydra.core.plugins import Plugins
from hydra.core.utils import JobStatus
from hydra.types import HydraContext, RunMode, TaskFunction

from pipeline.config.compose import CONFIG_DIR
from pipeline.config.sweep_plan import MULTIRUN, PlannedRun


def can_be_one(commands: Sequence[Sequence[str]], sweeps: Sequence[dict[str, PlannedRun]]) -> bool:
    """Whether there are several commands, all of them sweeps with the same launcher and with folders of their own."""
    launchers = {run.launcher for sweep in sweeps for run in sweep.values()}
    given_folder = any(argument.startswith("out=") for command in commands for argument in command)
    return len(commands) > 1 and all(sweeps) and len(launchers) == 1 and not given_folder


def launch(command: Sequence[str], runs: Sequence[PlannedRun], task: TaskFunction) -> bool:
    """Launches all runs, in this order, with the launcher of the command; True if every one ended well.

    command: of one of the sweeps, such as ["experiment=synthetic_suite"]. task: takes a run's composed configuration.
    """
    with initialize_config_dir(str(CONFIG_DIR), version_base="1.3"):
        loader = GlobalHydra.instance().config_loader()
        overrides = [argument for argument in command if argument not in MULTIRUN]
        config = loader.load_configuration("config", overrides, RunMode.MULTIRUN)
        context = HydraContext(config_loader=loader, callbacks=Callbacks())
        launcher = Plugins.instance().instantiate_launcher(hydra_context=context, task_function=task, config=config)
        results = launcher.launch([list(run.overrides) for run in runs], initial_job_idx=0)
    return all(result.status == JobStatus.COMPLETED for result in results)
