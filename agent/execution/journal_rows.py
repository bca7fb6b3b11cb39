"""Typed rows of the journal, as `agent.execution.journal_reader` returns them.

A field whose name ends in `_text` holds JSON text exactly as written. Some rows also have a property whose name lacks
this ending. The property contains the decoded text, which is decoded when the property is first read.

`run` is the number of a run, counted in the order in which the runs started. `number` is the number of a row in its
database table, counted in the order in which the rows were written.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from agent.execution.stored_json import HINT, stored_json
from drivers.errors import InputError


class _Recorded:
    """Base of the rows that contain a record as JSON text; it is decoded when it is first read."""

    record_text: str

    @cached_property
    def record(self) -> Mapping[str, Any]:
        return _decoded(self.record_text)


@dataclass(frozen=True)
class RunRow:
    """Row of a run in the journal, without the steps and results of the run. `run_id` is the identity of the run.

    `started` and `ended` are UTC times in ISO 8601; `ended` is None before the end of the run. `state` is the text of a
    `RunState`, such as ``measuring``.
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
    """Row of a run, with the number of its measured balls and the number of its touches that have a result."""

    run: RunRow
    balls: int
    touches: int


@dataclass(frozen=True)
class OriginRow(_Recorded):
    """Data stored at the start of a run, from which the run can be rebuilt.

    `begun_s` is the machine time in s, and `begun_at` the UTC time, at which the preflight ended. Both are None until
    then.
    """

    run: int
    run_id: str
    settings_text: str
    record_text: str
    begun_s: float | None
    begun_at: str | None


@dataclass(frozen=True)
class StepRow:
    """Step of a run. `kind` is the name of the step's class, `detail_text` contains its fields, and `result_text` its
    result. `begun_s` and `finished_s` are the machine times in s at which it began and ended.

    `finished_s` and `result_text` are None if the step did not end.
    """

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
        return None if self.result_text is None else stored_json(self.result_text)


@dataclass(frozen=True)
class TouchRow:
    """Touch that is part of the procedure of a run and has a result. `at_s` is the machine time in s at which the touch
    ended.
    """

    ordinal: int
    key: str
    at_s: float
    result_text: str


@dataclass(frozen=True)
class BallRow(_Recorded):
    """Measured ball centre of a run. `ordinal` is its sequence number in the run, and `key` names the measurement."""

    ordinal: int
    key: str
    record_text: str


@dataclass(frozen=True)
class TemperatureRow(_Recorded):
    """Reading of all temperature sensors. `record` maps the name of each sensor to its temperature in °C.

    `minutes` is the machine time in minutes after the start of the first step of the run.
    """

    minutes: float
    record_text: str


@dataclass(frozen=True)
class EventRow(_Recorded):
    """Event of a run, such as a change of state, a note or a fault. `at` is the UTC time of the event in ISO 8601."""

    number: int
    at: str
    kind: str
    record_text: str


@dataclass(frozen=True)
class AlarmRow(_Recorded):
    """Alarm of a run of the kind `run_kind`; `run_id` and `run_kind` are empty if it arose between runs. It was raised
    at the UTC time `at`.

    `until` is the UTC time at which the alarm was acknowledged, the run was resumed or the next run started, whichever
    came first; None if nothing of this is recorded. `kind` is ``alarm`` if the service has recorded the alarm, and
    ``fault`` if only the error that ended the run is known; `record` differs accordingly.
    """

    run_id: str
    run_kind: str
    number: int
    at: str
    until: str | None
    kind: str
    record_text: str


@dataclass(frozen=True)
class DecisionRow(_Recorded):
    """Decision of a run, such as the acceptance of a table. `at` is the UTC time of the decision in ISO 8601."""

    run: int
    run_id: str
    number: int
    at: str
    kind: str
    record_text: str


@dataclass(frozen=True)
class TableRow:
    """Stored compensation table without its corrections. `role` is ``backup`` (read before anything was written),
    ``staged`` or ``restored`` (made active again by the run). `bank` is the number of the table memory of the
    controller.

    If this memory was empty, `crc32` (the checksum of the corrections) and the fields after it are None.
    `origin_mm_text`, `step_mm_text` and `shape_text` are JSON lists exactly as written.
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
    document = stored_json(text)
    if not isinstance(document, dict):
        raise InputError("the journal is damaged: a record is no JSON object", hint=HINT)
    return document
