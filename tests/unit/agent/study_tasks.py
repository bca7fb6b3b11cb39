"""Tasks that worker processes import by name, since a lambda cannot be pickled."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agent.studies.workers import generator
from twin.errors import SingularSet


@dataclass(frozen=True, eq=False)
class Sums:
    """Task with a large array of its own, whose result depends on the last bit of every number in it."""

    matrix: np.ndarray
    seed: int

    def __call__(self, number: int) -> np.ndarray:
        drawn = generator(self.seed, number).standard_normal(len(self.matrix))
        return np.linalg.solve(self.matrix.T @ self.matrix + np.eye(len(drawn)), drawn)


def squared(number: int) -> int:
    return number * number


def undefined(number: int) -> float:
    return 1.0 / (number - 5)


def unseen(number: int) -> int:
    if number == 5:
        raise SingularSet("nothing can be seen", hint="measure more", file="set.csv")
    return number


def deadly(number: int) -> int:
    if number == 5:
        os._exit(3)
    return number


@dataclass(frozen=True)
class SlowAgain:
    """Write the process id to the file `first`; on a repetition, create the file `again` and wait a second before."""

    directory: str

    def __call__(self, number: int) -> int:
        first = Path(self.directory) / "first"
        if first.exists():
            (first.parent / "again").touch()
            threading.Event().wait(1.0)
        first.write_text(str(os.getpid()))
        return number


def interrupting(number: int) -> int:
    """Let item 3 send the keyboard interrupt to the parent and then run forever."""
    if number == 3:
        os.kill(os.getppid(), signal.SIGINT)
        threading.Event().wait(600.0)
    return number


def endless_but_first(number: int) -> int:
    if number > 0:
        threading.Event().wait(600.0)
    return number
