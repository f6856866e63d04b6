"""Ctrl-C that is not lost.

Python raises KeyboardInterrupt wherever the main thread happens to be. Where nanobind converts a tensor for the kernel,
it discards any exception and converts another way: the run would go on.
"""

from __future__ import annotations

import signal
from types import FrameType

_interrupted = False


def watch() -> None:
    """Remember Ctrl-C from now on, in the main thread, besides raising KeyboardInterrupt. Not where it is ignored."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _on_interrupt)


def raise_if_lost() -> None:
    """Raise the KeyboardInterrupt of a Ctrl-C that did not end the process."""
    if _interrupted:
        raise KeyboardInterrupt


def _on_interrupt(signum: int, frame: FrameType | None) -> None:
    global _interrupted
    _interrupted = True
    raise KeyboardInterrupt
