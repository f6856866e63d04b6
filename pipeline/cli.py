"""The command line: Hydra composes a configuration, stages/ runs it, and whatever goes wrong ends in one line.

Exit status 0 only if every run ended well; 75 where the same command is to be given again: a batch system ended it, or
another process is at work in the run folder. HYDRA_FULL_ERROR=1 shows tracebacks instead of lines.
"""

from __future__ import annotations

import gc
import os
import platform
import shlex
import sys
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException
from rich.console import Console
from rich.table import Table

from datasets.files.claim import Busy, Lost
from pipeline.config.compose import CONFIG_DIR, Command, Composed, one_line, options, quote_text, register_schema
from pipeline.config.schema import Config
from pipeline.terminal import interruption
from pipeline.terminal.command_line import quiet_on_closed_pipe
from pipeline.terminal.help_page import help_page
from pipeline.terminal.streams import keep_printing
from pipeline.terminal.sweep_progress import SweepRun
from pipeline.terminal.sweeper import RunList, RunSweeper, register_sweeper

# What a user can cause, by a wrong key, bad data, a full disk or a training that diverges. Anything else is a bug of
# the program and shows its traceback.
EXPECTED = (ValueError, OSError, ArithmeticError, MemoryError, HydraException, OmegaConfBaseException)

_FULL_ERROR = "HYDRA_FULL_ERROR"


def main() -> None:
    keep_printing()
    if {"--help", "-h", "--version"} & set(sys.argv[1:]):
        with quiet_on_closed_pipe():
            print(_version() if "--version" in sys.argv[1:] else help_page().rstrip())
        return
    traceback_wanted = os.environ.get(_FULL_ERROR) == "1"
    os.environ[_FULL_ERROR] = "1"  # so that Hydra raises and does not print: what is printed is decided here
    os.environ.setdefault("PIPELINE_TRACEBACK", "1" if traceback_wanted else "0")  # for the workers of a sweep
    register_schema()
    listed = "--list" in sys.argv
    sys.argv[1:] = [word for word in sys.argv[1:] if word != "--list"]
    register_sweeper(RunList if listed else RunSweeper)
    options_given = any(word[:1] == "-" for word in sys.argv)
    if not options_given and (listed or any(word.startswith("experiment=") for word in sys.argv)):
        sys.argv.append("--multirun")  # an experiment is a sweep
    sys.argv[1:] = quote_text(sys.argv[1:], sweep=bool({"-m", "--multirun"} & set(sys.argv)))
    interruption.watch()
    try:
        with interruption.not_replaced():
            hydra.main(config_path=str(CONFIG_DIR), config_name="config", version_base="1.3")(run_one)()
    except KeyboardInterrupt as interrupt:
        _complain(
            f"interrupted; {str(interrupt) or 'finished runs are kept, and the same command goes on with the others'}"
        )
        sys.exit(interruption.AGAIN if isinstance(interrupt, interruption.Stopped) else 130)
    except EXPECTED as error:
        if traceback_wanted:
            raise
        _refuse(one_line(error))


def run_one(composed: DictConfig) -> bool | None:
    """One run of the command line's. A failure ends a single run with exit status 1; in a sweep it returns False, and
    None where another process does the run."""
    job = HydraConfig.get()
    command = shlex.join(["python", "-m", "pipeline", *job.overrides.task])
    cfg: Config | None = None
    sweep: SweepRun | None = None
    keep_printing()  # in the workers of a sweep, too
    interruption.watch()
    try:
        with interruption.not_replaced():
            _work_in(job.runtime.cwd)
            sweep = SweepRun.joined(composed.out)
            order = Command(
                tuple(job.overrides.task), compositions={None: Composed(composed, dict(job.runtime.choices))}
            )
            cfg = order.config()
            _hint_at_settings(cfg, job.runtime.choices.get("scene"))
            import torch  # these late: a typo on the command line need not wait for them

            from pipeline.stages.run import run
            from rasterizer.cores import keep_freed_memory

            keep_freed_memory()
            if gc.get_freeze_count() == 0:  # once for all runs of a process
                gc.freeze()  # collections pass over what was imported, which stays anyway
            torch.set_num_threads(1)  # the heavy work is the kernel's, which has threads of its own (cfg.threads)
            if cfg.estimate:
                from pipeline.stages.estimate import estimate

                print("\n  ".join([f"{_title(cfg)} would take", *estimate(cfg).lines(cfg)]), flush=True)
                return True
            metrics = run(order, log=_say if sweep is None else _say_nothing)
            line = _result_line(cfg, metrics) if metrics else f"{_title(cfg)}: {cfg.out} is ready for what comes after"
            if sweep is not None:
                sweep.finished(line)
            elif metrics is None or job.mode == RunMode.MULTIRUN:
                _say(line)
            else:
                _report(cfg, metrics)
            return True
    except KeyboardInterrupt as interrupt:
        if isinstance(interrupt, interruption.Stopped):
            interruption.requeue()
        raise type(interrupt)(_kept_progress(cfg)) from None
    except EXPECTED as error:
        if os.environ.get("PIPELINE_TRACEBACK") == "1":
            raise
        line = one_line(error)
        if isinstance(error, BrokenPipeError):
            line = f"standard output was closed; {_kept_progress(cfg)}"
        if job.mode == RunMode.MULTIRUN:
            if isinstance(error, (Busy, Lost)):
                _say(f"{composed.out}: another process is at work in it; waited for when the others are done")
                return None
            if sweep is not None:
                sweep.failed()
            _complain(f"{line}  [{command}]")
            return False
        _complain(line)
        sys.exit(interruption.AGAIN if isinstance(error, (Busy, Lost)) else 1)


def _work_in(folder: str) -> None:
    """Where the command was given, which its paths are relative to; Ray's workers begin elsewhere."""
    if not os.path.isdir(folder):
        raise ValueError(f"{folder}: expected on every machine of a sweep, not found on {platform.node()}")
    os.chdir(folder)


def _kept_progress(cfg: Config | None) -> str:
    from pipeline.stages.run import NOTHING_KEPT, kept_progress

    return NOTHING_KEPT if cfg is None else kept_progress(cfg)


def _hint_at_settings(cfg: Config, chosen: str | None) -> None:
    """A line where scene=dnerf reads a folder that conf/scene/dnerf has settings for: lego is tested on val."""
    if chosen == cfg.scene.reader and cfg.scene.name != chosen and cfg.scene.name in options("scene"):
        print(f"scene={cfg.scene.name} has settings made for this scene; scene={chosen} does not take them", flush=True)


def _refuse(line: str) -> None:
    """Ends the command with the error; without a scene the help page comes first, and with --cfg a hint instead."""
    if line.startswith("scene: must be given"):
        with quiet_on_closed_pipe():
            print(help_page(), end="")
        if {"--cfg", "-c"} & set(sys.argv[1:]):
            print(
                "\n--cfg job prints the configuration of a command that names a scene: "
                "python -m pipeline scene=synthetic/wheel --cfg job"
            )
            return
    _complain(line)
    sys.exit(1)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    from pipeline.runs.provenance import git_commit

    try:
        number = version("gaussians-4d")
    except PackageNotFoundError:  # run from a checkout that is not installed
        number = "(not installed)"
    return f"gaussians-4d {number}, commit {git_commit()}"


def _complain(line: str) -> None:
    print(f"error: {' '.join(line.split())}", file=sys.stderr, flush=True)


def _report(cfg: Config, metrics: dict) -> None:
    """The run's numbers, where they are, and what to do next."""
    console = Console(highlight=False, soft_wrap=True)
    final, best = metrics["final"], metrics["best_on_test"] or {}
    console.print(_title(cfg, metrics), style="bold")
    from pipeline.evaluation.metrics import quality_table  # late, as it imports the metrics' libraries

    table = Table("", "final", "best on test")
    for row in quality_table(final, best):
        table.add_row(*row)
    table.add_row("iteration", str(metrics["iterations"]), str(best.get("iteration", "–")))
    console.print(table)
    if metrics.get("test_split"):
        console.print(f"held out: {metrics['test_split']}")
    console.print(
        f"{metrics['n_gaussians']} Gaussians, {metrics['n_alive_mean']:.0f} alive a frame; "
        f"{metrics['train_seconds']:.0f} s of training; {metrics['model_mb']:.1f} MB; "
        f"peak memory {metrics['peak_rss_mb']:.0f} MB"
    )
    if metrics["note"]:
        console.print(f"– : {metrics['note']}")
    console.print(f"written to {cfg.out}; {Path(cfg.out) / 'viewer.html'} plays it in a browser")
    root = next((parent for parent in Path(cfg.out).parents if parent.name == "runs"), Path(cfg.out))
    console.print(f"tables and plots of all runs: python -m pipeline.report {root}")
    if metrics.get("doubt"):
        console.print(f"doubtful: {metrics['doubt']}")


def _result_line(cfg: Config, metrics: dict) -> str:
    """One run of a sweep."""
    from pipeline.evaluation.metrics import METRICS  # late, as it imports the metrics' libraries

    psnr, ssim = (METRICS[key].text(metrics["final"][key]) for key in ("psnr", "ssim"))
    return (
        f"{_title(cfg, metrics)}: PSNR {psnr}, SSIM {ssim}, "
        f"{metrics['n_gaussians']} Gaussians, {metrics['train_seconds']:.0f} s of training; written to {cfg.out}"
        + (f"; doubtful: {metrics['doubt']}" if metrics.get("doubt") else "")
    )


def _say(text: str) -> None:
    print(text, flush=True)


def _say_nothing(text: str) -> None:
    """In a sweep, whose line says how far it is."""


def _title(cfg: Config, metrics: dict | None = None) -> str:
    """Scene, model, schedule and seed in one line. metrics: of the finished run, for what validation decided."""
    decided = (metrics or {}).get("decided", {})
    found = " (static, as validation found)" if decided.get("static") else ""
    return f"{cfg.scene.name} · {cfg.ablation.name}{found} · {cfg.train.name} · seed {cfg.seed}"
