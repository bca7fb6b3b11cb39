"""Faults of the computer on which the run works, and requests to end the run."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.random import Generator

from campaigns.faults.fault_scene import FaultScene

ABORT_REASON = "a person walks in"


def disk_full(scene: FaultScene, _: Generator) -> None:
    """Fill the disk: the journal cannot grow."""
    memory = scene.memory
    assert memory is not None
    [most] = memory.connection.execute("PRAGMA max_page_count").fetchone()
    memory.fill()
    scene.journal_writable = False
    scene.repairs.append(lambda: memory.connection.execute(f"PRAGMA max_page_count = {most}"))


def read_only(scene: FaultScene, _: Generator) -> None:
    """Make the journal read-only, as a file system does after an error of its disk."""
    scene.journal_writable = False
    scene.tell_connections("PRAGMA query_only = 1")
    scene.repairs.append(lambda: scene.tell_connections("PRAGMA query_only = 0"))


def calendar_jumps(scene: FaultScene, rng: Generator) -> None:
    """Set the date and time of the computer forwards or back."""
    by_s = float(np.exp(rng.uniform(0.0, np.log(1e8))) * rng.choice([-1.0, 1.0]))
    scene.size = f"{by_s:+.0f} s"
    real = time.time

    def jumped() -> float:
        return real() + by_s

    time.time = jumped
    scene.repairs.append(lambda: setattr(time, "time", real))


def starved(scene: FaultScene, rng: Generator) -> None:
    """Let the process not run for some time at each of its next waits, while the machine goes on."""
    lasts_s, left = float(np.exp(rng.uniform(np.log(0.2), np.log(600.0)))), int(rng.integers(1, 20))
    scene.size = f"{left} times {lasts_s:.1f} s"
    clock = scene.clock

    def stall(_: float, after_s: float) -> None:
        nonlocal left
        left -= 1
        watch, clock.watch = clock.watch, None
        clock.advance_to(after_s + lasts_s)
        clock.watch = watch if left > 0 else None

    clock.watch = stall


def abort(scene: FaultScene, _: Generator) -> None:
    """Let a person abort the run."""
    assert scene.supervisor is not None
    scene.note_abort()
    scene.supervisor.request_abort(ABORT_REASON)


def interruption(scene: FaultScene, _: Generator) -> None:
    """Ask the program to end, as systemd does at a shutdown."""
    assert scene.supervisor is not None
    scene.note_abort()
    scene.supervisor.request_interruption("SIGTERM")


def hold(scene: FaultScene, rng: Generator) -> None:
    """Let a person hold the run, and resume or abort it later."""
    assert scene.supervisor is not None
    supervisor: Any = scene.supervisor
    lasts_s, aborted = float(np.exp(rng.uniform(np.log(0.2), np.log(600.0)))), bool(rng.integers(2))
    scene.size = f"{lasts_s:.1f} s, then {'aborted' if aborted else 'resumed'}"
    supervisor.request_hold()

    def end() -> None:
        if aborted:
            scene.note_abort()
            supervisor.request_abort(ABORT_REASON)
        else:
            supervisor.request_resume()

    scene.clock.at(scene.clock.now() + lasts_s, end)
