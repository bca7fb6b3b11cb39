"""Tables of the history of all machines; `machine` and `run_id` identify a run.

The columns of a table are derived from the fields of its row class. The rows are plain values and the tables those of
SQLAlchemy Core, because its object-relational mapper adds about 0.2 s to the start of `volcal history list`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import MISSING, dataclass, field, fields
from datetime import datetime
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from sqlalchemy import (
    Boolean,
    Column,
    DateTime,
    Double,
    ForeignKeyConstraint,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)

SCHEMA_VERSION = 1
_TYPES = {float: Double(), datetime: DateTime(timezone=True), int: Integer(), str: Text(), bool: Boolean()}
"""Floats have double precision in all databases."""

Name = Annotated[str, String(100)]
RunId = Annotated[str, String(40)]
Word = Annotated[str, String(40)]
Unit = Annotated[str, String(8)]
Crc32 = Annotated[str, String(8)]
Sha256 = Annotated[str, String(64)]


@dataclass(frozen=True)
class StoredParameter:
    """A parameter of the error model by its ISO 230-1 name; µm or µrad, standard uncertainty."""

    machine: Name
    run_id: RunId
    name: Word
    place: int
    value: float
    standard_uncertainty: float
    unit: Unit


@dataclass(frozen=True)
class StoredTemperature:
    """One sensor over a run, °C."""

    machine: Name
    run_id: RunId
    sensor: Name
    lowest: float
    mean: float
    highest: float


@dataclass(frozen=True)
class StoredDecision:
    """Gates, verification, acceptance …; `place`: index in their order; `record`: JSON."""

    machine: Name
    run_id: RunId
    place: int
    at: datetime
    kind: str
    record: str


@dataclass(frozen=True)
class StoredRun:
    """One run. Lengths in µm, VE and VCE rigidly aligned; None if the run did not reach that point or is of another
    kind.

    `since`, `nights`: run of the last accepted night, and nights since then. `ve_before_um`: estimated without table;
    `ve_after_um`: predicted with its table; `ve_now_um`: expected by a night run with the active table; `acting_um`:
    with the table active at the end. `digest`: hash of all stored values, so that unchanged runs are not written again.
    The lists hold the run's rows of the other tables; they are not columns.
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


def _columns(row: type, keys: tuple[str, ...]) -> Iterator[Column[Any]]:
    """Yield a column for each field without a default; `keys` form the primary key."""
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
"""Single row with the version of these tables in the database."""
RUNS = Table("volcal_runs", METADATA, *_columns(StoredRun, ("machine", "run_id")))
PARAMETERS = _child("volcal_parameters", StoredParameter, "name")
TEMPERATURES = _child("volcal_temperatures", StoredTemperature, "sensor")
DECISIONS = _child("volcal_decisions", StoredDecision, "place")
