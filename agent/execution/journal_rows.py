"""Typed rows of the journal, as `agent.execution.journal_reader` returns them.

Fields `*_text` hold JSON exactly as written; the property of the same name without the suffix decodes it on first use.
`run` is the number of a run, counted in the order started; `number` is the number of a row in its database table,
counted in the order written.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any


class _Recorded:
    """Base of the rows that contain a record as JSON text; it is decoded when it is first read."""

    record_text: str

    @cached_property
    def record(self) -> Mapping[str, Any]:
        return _decoded(self.record_text)


@dataclass(frozen=True)
class RunRow:
    """A run.

    `started` and `ended` are UTC times in ISO 8601; `ended` is None before the end of the run. `state` is the value of
    a `RunState`.
    """

    run: int
    run_id: str
    kind: str
    started: str
    ended: str | None
    state: str
    reason: str | None
    software: str


@dataclass(frozen=True)
class RunCounts:
    """A run with the number of its measured balls and the number of its touches that have a result."""

    run: RunRow
    balls: int
    touches: int


@dataclass(frozen=True)
class OriginRow(_Recorded):
    """Start of a run.

    `begun_s` and `begun_at` are the machine seconds and the UTC time at the end of the preflight; they are None before
    it.
    """

    run: int
    run_id: str
    settings_text: str
    record_text: str
    begun_s: float | None
    begun_at: str | None


@dataclass(frozen=True)
class StepRow:
    """A step of a run. Times are machine seconds; `finished_s` and `result_text` are None if the step did not end."""

    ordinal: int
    key: str
    kind: str
    detail_text: str
    begun_s: float
    finished_s: float | None
    result_text: str | None
    error: str | None

    @cached_property
    def detail(self) -> Mapping[str, Any]:
        return _decoded(self.detail_text)

    @cached_property
    def result(self) -> Any:
        return None if self.result_text is None else json.loads(self.result_text)


@dataclass(frozen=True)
class TouchRow:
    """A touch of the procedure that has a result. `at_s` is its machine time in s."""

    ordinal: int
    key: str
    at_s: float
    result_text: str


@dataclass(frozen=True)
class BallRow(_Recorded):
    """A measured ball centre."""

    ordinal: int
    key: str
    record_text: str


@dataclass(frozen=True)
class TemperatureRow(_Recorded):
    """A reading of all sensors (name → °C) at `minutes` of machine time after the first step of the run."""

    minutes: float
    record_text: str


@dataclass(frozen=True)
class EventRow(_Recorded):
    """An event of a run. `at` is its UTC time in ISO 8601."""

    number: int
    at: str
    kind: str
    record_text: str


@dataclass(frozen=True)
class DecisionRow(_Recorded):
    """A decision of a run. `at` is its UTC time in ISO 8601."""

    run: int
    run_id: str
    number: int
    at: str
    kind: str
    record_text: str


@dataclass(frozen=True)
class TableRow:
    """A stored compensation table without its counts. `role` is backup, staged or restored.

    `crc32` and the fields after it are None for an empty bank. Origin, step and shape are JSON lists as written.
    """

    run: int
    run_id: str
    number: int
    at: str
    role: str
    bank: int
    crc32: int | None
    origin_mm_text: str | None
    step_mm_text: str | None
    resolution_mm: float | None
    shape_text: str | None


def _decoded(text: str) -> Mapping[str, Any]:
    document: dict[str, Any] = json.loads(text)
    return document
