"""A folder's claim: one process at a time is at work in it, among all machines that see the folder.

The claim is a file, `.claim-<number>`. Who creates the next number holds the folder; numbers only rise, so that of two
processes that find a dead claim one succeeds it. The holder renews the file's time every BEAT_S seconds, and a claim
that is EXPIRES_S old is a dead process's. Both times are the file server's, since machines' clocks differ. On the
holder's own machine `flock` tells at once whether it lives.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

NAME, _PROBE = ".claim-", ".now-"
HIDDEN = (NAME, _PROBE)  # beginnings of the names of files that a claim leaves
BEAT_S = 5.0
EXPIRES_S = 120.0  # NFS clients may show a file's time from a cache, up to 60 s old


class Busy(ValueError):
    """Another process is at work in a folder. One line."""


class Lost(ValueError):
    """Another process has taken over the folder of this one, which had stood still. One line."""


class Claim:
    """A folder's claim, held until `release`; a context manager. The folder exists.

    Raises Busy where another process holds it. Of a holder on another machine it waits for a sign of life, or for the
    claim to expire.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._number, self._file = _take(folder)
        self._looked, self._lost = time.time(), False
        self._released, self._closing = threading.Event(), threading.Lock()
        threading.Thread(target=self._renew, name=f"claim of {folder}", daemon=True).start()

    def __enter__(self) -> Claim:
        return self

    def __exit__(self, *exception: Any) -> None:
        self.release()

    def release(self) -> None:
        with self._closing:
            if not self._released.is_set():
                self._released.set()
                with suppress(OSError):
                    os.utime(self._file, (0, 0))  # expired; the number stays taken
                os.close(self._file)

    def check(self) -> None:
        """Raises Lost where another process took the folder over, as after hours of a suspended machine."""
        if time.time() - self._looked > EXPIRES_S / 2:
            self._look()
        if self._lost:
            raise Lost(
                f"{self._folder}: expected to be alone in it, found another process, which took it over after this one "
                f"had stood still for {EXPIRES_S:.0f} s; it goes on with the run"
            )

    def _renew(self) -> None:
        while not self._released.wait(BEAT_S):
            with self._closing:
                if not self._released.is_set():
                    self._look()

    def _look(self) -> None:
        with suppress(OSError):  # a file server that is away, or a folder that was deleted
            self._lost = self._lost or _newest(self._folder) > self._number
            os.utime(self._file)  # None: the file server's now
        self._looked = time.time()


def claimed(folder: Path, on_wait: Callable[[], None]) -> Claim:
    """The folder's claim; on_wait: called once if another process holds it, which is then waited for."""
    try:
        return Claim(folder)
    except Busy:
        on_wait()
    while True:
        wait_until_free(folder)
        with suppress(Busy):
            return Claim(folder)


def wait_until_free(folder: Path) -> None:
    """Returns when no process holds the folder's claim."""
    while folder.is_dir() and _holder(folder, _newest(folder)) is not None:
        time.sleep(BEAT_S / 10)


def _take(folder: Path) -> tuple[int, int]:
    """(number, open file) of a new claim."""
    while True:
        number = _newest(folder)
        if (holder := _holder(folder, number)) is not None:
            raise Busy(f"{folder}: expected a free run folder, found another process at work in it ({holder})")
        path = folder / f"{NAME}{number + 1}"
        try:
            file = os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o666)
        except FileExistsError:
            continue
        try:
            with suppress(OSError):  # some file systems have no flock
                fcntl.flock(file, fcntl.LOCK_EX)
            os.write(file, f"{_this_machine()}\n{socket.gethostname()}, process {os.getpid()}".encode())
            os.utime(file)
            if _newest(folder) == number + 1:  # not where claims have come and gone since the look
                for old in _numbers(folder):
                    if old <= number:
                        (folder / f"{NAME}{old}").unlink(missing_ok=True)
                return number + 1, os.dup(file)
            path.unlink(missing_ok=True)
        finally:
            os.close(file)


def _holder(folder: Path, number: int) -> str | None:
    """The living process that holds this claim; None where it is released, its process is dead, or there is none."""
    seen = None
    while True:
        try:
            with open(folder / f"{NAME}{number}") as file:  # opened anew: NFS then asks the server for its time
                machine, _, process = file.read().partition("\n")
                renewed = os.fstat(file.fileno()).st_mtime
                if renewed > 0 and machine == _this_machine() and (locked := _is_locked(file.fileno())) is not None:
                    return process if locked else None
        except FileNotFoundError:
            return None
        if _now_at(folder) - renewed > EXPIRES_S:
            return None
        if seen is not None and renewed != seen:
            return process or "which has just begun"
        seen = renewed
        time.sleep(BEAT_S / 2)


def _is_locked(file: int) -> bool | None:
    """None: the file system has no flock."""
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return True if error.errno == errno.EWOULDBLOCK else None
    return False


def _now_at(folder: Path) -> float:
    """Seconds since 1970 by the clock of the folder's file server."""
    probe = folder / f"{_PROBE}{uuid.uuid4().hex}"
    try:
        with open(probe, "w") as file:
            return os.fstat(file.fileno()).st_mtime
    finally:
        probe.unlink(missing_ok=True)


def _newest(folder: Path) -> int:
    return max(_numbers(folder), default=0)


def _numbers(folder: Path) -> list[int]:
    names = (name.removeprefix(NAME) for name in os.listdir(folder) if name.startswith(NAME))
    return [int(name) for name in names if name.isdecimal()]


def _this_machine() -> str:
    """Of this start of this machine; containers share it, as they share its flock."""
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:  # not Linux
        return socket.gethostname()
