"""Heartbeats of the processes of LinuxCNC: its task, its motion (the servo thread) and its tool and e-stop I/O.

LinuxCNC's Python module shows the last status that the task wrote, however old it is: a task that no longer runs seems
to move for ever. The module has no member for the heartbeats, hence they are observed where they are written:

- task: it writes the status buffer, a System V shared memory, in every cycle, with counters in it;
- motion: the servo thread publishes its period and its run time as HAL pins in every cycle;
- tool and e-stop I/O: it writes nothing while nothing changes, so its process is looked at.

The module runs in the Python interpreter of the Linux distribution.
"""

from __future__ import annotations

import ctypes
import subprocess
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Union

import hal

Beat = Union[int, "tuple[Any, ...]"]  # the distribution may have Python 3.9
LIMIT_S = 1.0
"""Time without a heartbeat after which a process counts as stopped, until volcal sets another."""
GRACE_S = 0.1
POLL_S = 0.001
HALCMD_WITHIN_S = 2.0
STATUS_BUFFER = "emcStatus"
MOTION_PINS = ("motion-controller.time", "motion.servo.last-period")
PROCESSES = {"task": "inihal", "tool and e-stop I/O": "iocontrol"}
"""HAL components that tell the process ids: `inihal` belongs to the task."""
SHM_RDONLY = 0o10000
FAILED = ctypes.c_void_p(-1).value


class ProcessStoppedError(Exception):
    """Raised if a process of LinuxCNC has ended or has stopped; `part` names it, `reason` says what is the matter."""

    def __init__(self, part: str, reason: str) -> None:
        super().__init__(f"LinuxCNC's {part} {reason}")
        self.part, self.reason = part, reason


class _Process(NamedTuple):
    """Process, identified by its start time as well, because process ids are used again."""

    pid: int
    started: str


class ProcessMonitor:
    """Monitor of LinuxCNC's processes by their heartbeats; the calling process must have a HAL component.

    `nml_file` describes LinuxCNC's shared buffers. Processes whose heartbeat this version of
    LinuxCNC does not publish are not monitored; `watched` names the monitored ones.
    """

    def __init__(self, nml_file: str) -> None:
        self.limit_s = LIMIT_S
        self._beats: dict[str, Callable[[], Beat]] = {}
        status = _attach(*_status_buffer(Path(nml_file)))
        if status is not None:
            self._beats["task"] = status
        if all(_readable(pin) for pin in MOTION_PINS):
            self._beats["motion"] = lambda: tuple(hal.get_value(pin) for pin in MOTION_PINS)
        self._processes = _processes()
        self._seen = {part: (read(), time.monotonic()) for part, read in self._beats.items()}

    @property
    def watched(self) -> list[str]:
        return sorted({*self._beats, *self._processes})

    def require_alive(self, *, surely: bool = False) -> None:
        """Raise ProcessStoppedError if a part of LinuxCNC has ended or has given no heartbeat for `limit_s`.

        With `surely`, the call waits until each part has given a heartbeat since the previous call, which takes one
        cycle of the task, or until its time is over.
        """
        for part, process in self._processes.items():
            reason = _dead(process)
            if reason:
                raise ProcessStoppedError(part, reason)
        for part in self._beats:
            while not self._has_beaten(part) and surely:
                time.sleep(POLL_S)

    def _has_beaten(self, part: str) -> bool:
        """Return True if the part has given a heartbeat since the last one observed.

        Raises ProcessStoppedError if that was longer ago than `limit_s`.
        """
        now_s = time.monotonic()
        beat, seen_s = self._beats[part](), self._seen[part][1]
        if beat != self._seen[part][0]:
            self._seen[part] = (beat, now_s)
            return True
        if now_s - seen_s > self.limit_s:
            self._require_beat_now(part, now_s - seen_s)
        return False

    def _require_beat_now(self, part: str, silent_s: float) -> None:
        """Raise ProcessStoppedError unless the part gives a heartbeat at once.

        Time in which this process did not run itself, as in a suspended computer, is no silence of the part.
        """
        ends_s = time.monotonic() + GRACE_S
        while self._beats[part]() == self._seen[part][0]:
            if time.monotonic() > ends_s:
                raise ProcessStoppedError(part, f"has stopped: no heartbeat for {silent_s:.1f} s")
            time.sleep(POLL_S)


def buffer_of(nml_text: str) -> tuple[int, int]:
    """Return the key and the size in bytes of the status buffer in an NML file; (0, 0) if it has none in memory.

    A line is `B name SHMEM host size neut old number mp key …`.
    """
    for line in nml_text.splitlines():
        words = line.split()
        if len(words) >= 10 and words[:3] == ["B", STATUS_BUFFER, "SHMEM"]:
            try:
                return int(words[9]), int(words[4])
            except ValueError:
                break
    return 0, 0


def _status_buffer(nml_file: Path) -> tuple[int, int]:
    try:
        return buffer_of(nml_file.read_text(encoding="utf-8", errors="replace"))
    except OSError:
        return 0, 0


def _attach(key: int, size: int) -> Callable[[], int] | None:
    """Attach a shared memory for reading, and return a function that gives the CRC-32 of its contents."""
    if key == 0:
        return None
    libc = ctypes.CDLL(None, use_errno=True)
    libc.shmat.restype = ctypes.c_void_p
    libc.shmat.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_int]
    number = libc.shmget(key, 0, 0)
    address = libc.shmat(number, None, SHM_RDONLY) if number >= 0 else None
    if address is None or address == FAILED:
        return None
    return lambda: zlib.crc32(ctypes.string_at(address, size))


def _readable(pin: str) -> bool:
    try:
        hal.get_value(pin)
    except (RuntimeError, TypeError):
        return False
    return True


def _processes() -> dict[str, _Process]:
    """Return the processes to which the HAL components of `PROCESSES` belong."""
    found = {}
    for part, component in PROCESSES.items():
        for words in map(str.split, halcmd("-s", "show", "comp", component).splitlines()):
            if len(words) >= 4 and words[1:3] == ["User", component] and words[3].isdigit():
                fields = _stat(int(words[3]))
                if fields:
                    found[part] = _Process(int(words[3]), fields[-1])
    return found


def _dead(process: _Process) -> str:
    """Return why a process no longer works, or an empty string if it works."""
    fields = _stat(process.pid)
    if not fields or fields[-1] != process.started or fields[0] in "ZX":
        return "has ended"
    return "has been stopped by a signal" if fields[0] in "Tt" else ""


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat from the state to the start time; an empty list without such a process."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return []
    return text.rpartition(")")[2].split()[:20]


def halcmd(*words: str) -> str:
    """Run halcmd and return its output, which is empty if it failed."""
    try:
        done = subprocess.run(  # noqa: S603  fixed program, no shell
            ["/usr/bin/halcmd", *words], capture_output=True, text=True, timeout=HALCMD_WITHIN_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return ""
    return done.stdout if done.returncode == 0 else ""
