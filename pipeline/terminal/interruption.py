"""Ctrl-C that is not lost, and the signals by which a batch system ends a job.

Python raises KeyboardInterrupt wherever the main thread happens to be. Where nanobind converts a tensor for the kernel,
it discards any exception and converts another way: the run would go on. OmegaConf tidies up half a node, and fails.

SIGTERM and SIGUSR2 end a run too: a machine is wanted back, or its time is over. Training only notes them, to save a
checkpoint first.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

STOPPING = (signal.SIGTERM, signal.SIGUSR2)
AGAIN = os.EX_TEMPFAIL  # 75, the exit status where the same command is to be given again

_interrupted = False
_stopped_by: int | None = None
_noting = False
_before: dict[int, Callable] = {}  # what others had set for a signal: submitit requeues its job


class Stopped(KeyboardInterrupt):
    """A batch system ends the process."""


def watch() -> None:
    """Remember Ctrl-C from now on, besides raising KeyboardInterrupt, and raise Stopped for STOPPING. In the main
    thread only, and not where Ctrl-C is ignored."""
    if threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _on_interrupt)
    for signum in STOPPING:
        before = signal.signal(signum, _on_stop)
        if callable(before) and before is not _on_stop:
            _before[signum] = before


def raise_if_lost() -> None:
    """Raise the KeyboardInterrupt of a signal that did not end the process."""
    if _interrupted:
        raise KeyboardInterrupt
    if _stopped_by and not _noting:
        raise Stopped


@contextmanager
def not_replaced() -> Iterator[None]:
    """Within, an error that a library met on its way out of an interruption does not take the interruption's place."""
    try:
        yield
    except Exception:
        raise_if_lost()
        raise


@contextmanager
def stops_noted() -> Iterator[None]:
    """Within, STOPPING raise nothing but make `stop_noted` true; Stopped is raised at the end."""
    global _noting
    _noting = True
    try:
        yield
    finally:
        _noting = False
    raise_if_lost()


def stop_noted() -> bool:
    return _stopped_by is not None


def requeue() -> None:
    """Gives the run back to the engine that started this process; does not return where there is one.

    A job that submitit started, and that Slurm has not ended itself, goes back into the queue. A task of Ray ends its
    process, as Ray repeats tasks of workers that died but not interrupted ones.
    """
    ray = sys.modules.get("ray")
    if ray and ray.is_initialized() and ray.get_runtime_context().get_task_id():
        os._exit(AGAIN)
    handler = _before.get(signal.SIGUSR2)
    if handler and (_stopped_by == signal.SIGUSR2 or _is_running(os.environ.get("SLURM_JOB_ID", ""))):
        handler(signal.SIGUSR2, None)


def _is_running(job: str) -> bool:
    """Not a job that was cancelled or preempted, which has got SIGTERM too."""
    told = subprocess.run(["scontrol", "show", "job", "--oneliner", job], capture_output=True, text=True)
    return "JobState=RUNNING" in told.stdout


def _on_interrupt(signum: int, frame: FrameType | None) -> None:
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt


def _on_stop(signum: int, frame: FrameType | None) -> None:
    global _stopped_by
    _stopped_by = signum
    if not _noting:
        raise Stopped
