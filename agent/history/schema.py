"""Tables of the database that stores the runs of all machines (the history). The columns `machine` and `run_id`
together identify a run.

The columns of a table are derived from the fields of a Python class that represents its rows. These row classes are
plain dataclasses, and the tables use SQLAlchemy Core. The object-relational mapper of SQLAlchemy is not used, because
it would add about 0.2 s to the start of `volcal history list`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields
from datetime import UTC, datetime
from functools import cached_property
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin, get_type_hints

from sqlalchemy import (
    Boolean,
    Column,
    DateTime,
    Double,
    ForeignKeyConstraint,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)

from agent.results.run_verdict import RunVerdict, verdict_of

if TYPE_CHECKING:
    from twin.arrays import Array

SCHEMA_VERSION = 1
_TYPES = {float: Double(), datetime: DateTime(timezone=True), int: Integer(), str: Text(), bool: Boolean()}
"""SQL type for each Python type. Floats have double precision in all databases."""

Name = Annotated[str, String(100)]
RunId = Annotated[str, String(40)]
Word = Annotated[str, String(40)]
Unit = Annotated[str, String(8)]
Crc32 = Annotated[str, String(8)]
Sha256 = Annotated[str, String(64)]


@dataclass(frozen=True)
class StoredParameter:
    """Estimated parameter of the machine's error model, with its ISO 230-1 name, its value and its standard
    uncertainty.

    `unit` is the unit of the value and of the standard uncertainty, either µm or µrad. `place` is the index of the
    parameter in the error model.
    """

    machine: Name
    run_id: RunId
    name: Word
    place: int
    value: float
    standard_uncertainty: float
    unit: Unit


@dataclass(frozen=True, eq=False)
class ParameterArrays:
    """Estimated parameters of a run: their names, their `values` and their standard uncertainties `sigmas`, each with
    the shape (n_parameters,), in the units of the rows."""

    names: tuple[str, ...]
    values: Array
    sigmas: Array


@dataclass(frozen=True)
class StoredTemperature:
    """Lowest, mean and highest temperature of one sensor during a run, in °C."""

    machine: Name
    run_id: RunId
    sensor: Name
    lowest: float
    mean: float
    highest: float


@dataclass(frozen=True)
class StoredDecision:
    """Decision of a run, such as the check of an estimate against its limits, a verification, or the acceptance of a
    table.

    `place` is the index of the decision among the stored decisions of the run. `record` is the content of the decision
    as JSON text.
    """

    machine: Name
    run_id: RunId
    place: int
    at: datetime
    kind: str
    record: str


@dataclass(frozen=True)
class StoredRun:
    """Run of a machine, as stored in the history database.

    Lengths are in µm. Volumetric errors (VE) are rigidly aligned, that is, computed after the best-fitting rigid motion
    is removed. A value is None if the run ended before the value was known, or if runs of this kind do not have the
    value.

    `since` is the identity of the last run whose result was accepted as reference before this run, and `nights` is the
    number of nights since that run. `ve_before_um` is the VE estimated without a compensation table. `ve_after_um` is
    the VE predicted with the new table. `ve_now_um` is the VE that a verify or nightly run expects with the table that
    was active at the start of the run. `acting_um` is the VE with the table that is active at the end of the run.

    `digest` is a hash of all stored values. An unchanged run is recognised by its digest and is not written again.
    `parameters`, `temperatures` and `decisions` contain the rows of the run in other tables of the database; they are
    not columns.
    """

    machine: Name
    run_id: RunId
    kind: Word
    started: datetime
    ended: datetime | None
    state: Word
    reason: str
    software: Word
    started_by: str
    artefact: str
    position_set: str
    balls: int
    touches: int
    machine_minutes: float
    predicted_minutes: float | None
    ve_before_um: float | None
    ve_before_sigma_um: float | None
    ve_after_um: float | None
    ve_after_sigma_um: float | None
    ve_now_um: float | None
    acting_um: float | None
    held_out_before_um: float | None
    held_out_after_um: float | None
    held_out_predicted_um: float | None
    accepted: bool | None
    night: str | None
    since: RunId | None
    nights: float | None
    chi2_normalised: float | None
    rank: int | None
    table_bank: int | None
    table_crc32: Crc32 | None
    settings_sha256: Sha256
    digest: Sha256

    parameters: list[StoredParameter] = field(default_factory=list)
    temperatures: list[StoredTemperature] = field(default_factory=list)
    decisions: list[StoredDecision] = field(default_factory=list)

    @cached_property
    def parameter_arrays(self) -> ParameterArrays:
        """The parameters as arrays. They are made once, since the series of all runs are made again after each run."""
        import numpy as np  # noqa: PLC0415  the list of runs needs no mathematics

        values = np.array([one.value for one in self.parameters])
        sigmas = np.array([one.standard_uncertainty for one in self.parameters])
        return ParameterArrays(tuple(one.name for one in self.parameters), values, sigmas)

    @property
    def verdict(self) -> RunVerdict:
        return verdict_of(
            self.kind, self.state, ended=self.ended is not None, accepted=self.accepted, decision=self.night
        )


def utc_time(time: datetime) -> datetime:
    """Return a stored time in UTC. A time without zone, as SQLite returns it, is already in UTC."""
    return time.replace(tzinfo=UTC) if time.tzinfo is None else time.astimezone(UTC)


def utc_text(time: datetime) -> str:
    """Return a stored time as the text of an instant in UTC, to the millisecond."""
    return utc_time(time).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _columns(row: type, keys: tuple[str, ...]) -> Iterator[Column[Any]]:
    """Yield a column for each field of `row` that has no default. The fields in `keys` form the primary key."""
    hints = get_type_hints(row, include_extras=True)
    for name in (one.name for one in fields(row) if one.default_factory is MISSING):
        parts = get_args(hints[name]) if get_origin(hints[name]) in (Union, UnionType) else (hints[name],)
        (kind,) = (part for part in parts if part is not NoneType)
        sql_type: Any = get_args(kind)[1] if get_origin(kind) is Annotated else _TYPES[kind]
        yield Column(name, sql_type, primary_key=name in keys, nullable=NoneType in parts)


def _child(name: str, row: type, key: str) -> Table:
    parent = ForeignKeyConstraint(
        ["machine", "run_id"], ["volcal_runs.machine", "volcal_runs.run_id"], ondelete="CASCADE"
    )
    return Table(name, METADATA, *_columns(row, ("machine", "run_id", key)), parent)


METADATA = MetaData()
VERSIONS = Table("volcal_schema", METADATA, Column("version", Integer, primary_key=True))
"""Table whose only row contains the schema version of the database."""
RUNS = Table("volcal_runs", METADATA, *_columns(StoredRun, ("machine", "run_id")))
RUNS_BY_START = Index("volcal_runs_by_start", RUNS.c.machine, RUNS.c.started)
"""Index for the latest runs of each machine. It is not part of the schema version: a program that does not know it
reads and writes the same tables."""
PARAMETERS = _child("volcal_parameters", StoredParameter, "name")
TEMPERATURES = _child("volcal_temperatures", StoredTemperature, "sensor")
DECISIONS = _child("volcal_decisions", StoredDecision, "place")
