"""What a run began from. Everything that it decided by the day, by the journal or by where the machine stood is decided
by this, so that a run that is gone on with decides the same again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from agent.execution.steps import Point
from agent.planning.preflight import unwatched


@dataclass(frozen=True)
class Outset:
    """`run`: its number in the journal, earlier ones are what it knows; `at` UTC, ISO 8601; `start_mm` axis
    positions. `watch`: called all the while the run is prepared, raises to break off; nothing is decided by it."""

    run: int
    at: str
    start_mm: Point
    watch: Callable[[], None] = field(default=unwatched, compare=False)
