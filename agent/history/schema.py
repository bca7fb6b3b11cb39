"""Tables of the history of all machines; `machine` and `run_id` identify a run."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import DateTime, Double, ForeignKeyConstraint, Integer, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

SCHEMA_VERSION = 1
NAME, RUN_ID, WORD = String(100), String(40), String(40)


class Base(DeclarativeBase):
    """Base class of the tables; floats have double precision in all databases."""

    type_annotation_map = {float: Double, datetime: DateTime(timezone=True), int: Integer, str: Text}  # noqa: RUF012


class SchemaVersion(Base):
    """Single row with the version of these tables in the database."""

    __tablename__ = "volcal_schema"
    version: Mapped[int] = mapped_column(primary_key=True)


class StoredRun(Base):
    """One run. Lengths in µm, VE and VCE rigidly aligned; None if the run did not reach that point or is of another
    kind.

    `since`, `nights`: run of the last accepted night, and nights since then. `ve_before_um`: estimated without table;
    `ve_after_um`: predicted with its table; `ve_now_um`: expected by a night run with the active table; `acting_um`:
    with the table active at the end. `digest`: hash of all stored values, so that unchanged runs are not written again.
    """

    __tablename__ = "volcal_runs"
    machine: Mapped[str] = mapped_column(NAME, primary_key=True)
    run_id: Mapped[str] = mapped_column(RUN_ID, primary_key=True)
    kind: Mapped[str] = mapped_column(WORD)
    started: Mapped[datetime]
    ended: Mapped[datetime | None]
    state: Mapped[str] = mapped_column(WORD)
    reason: Mapped[str]
    software: Mapped[str] = mapped_column(WORD)
    started_by: Mapped[str]
    artefact: Mapped[str]
    position_set: Mapped[str]
    balls: Mapped[int]
    touches: Mapped[int]
    machine_minutes: Mapped[float]
    predicted_minutes: Mapped[float | None]
    ve_before_um: Mapped[float | None]
    ve_before_sigma_um: Mapped[float | None]
    ve_after_um: Mapped[float | None]
    ve_after_sigma_um: Mapped[float | None]
    ve_now_um: Mapped[float | None]
    acting_um: Mapped[float | None]
    held_out_before_um: Mapped[float | None]
    held_out_after_um: Mapped[float | None]
    held_out_predicted_um: Mapped[float | None]
    accepted: Mapped[bool | None]
    night: Mapped[str | None]
    since: Mapped[str | None] = mapped_column(RUN_ID)
    nights: Mapped[float | None]
    chi2_normalised: Mapped[float | None]
    rank: Mapped[int | None]
    table_bank: Mapped[int | None]
    table_crc32: Mapped[str | None] = mapped_column(String(8))
    settings_sha256: Mapped[str] = mapped_column(String(64))
    digest: Mapped[str] = mapped_column(String(64))

    parameters: Mapped[list[StoredParameter]] = relationship(
        cascade="all, delete-orphan", order_by="StoredParameter.place"
    )
    temperatures: Mapped[list[StoredTemperature]] = relationship(
        cascade="all, delete-orphan", order_by="StoredTemperature.sensor"
    )
    decisions: Mapped[list[StoredDecision]] = relationship(
        cascade="all, delete-orphan", order_by="StoredDecision.place"
    )


def _of_run() -> ForeignKeyConstraint:
    return ForeignKeyConstraint(
        ["machine", "run_id"], ["volcal_runs.machine", "volcal_runs.run_id"], ondelete="CASCADE"
    )


class StoredParameter(Base):
    """A parameter of the error model by its ISO 230-1 name; µm or µrad, standard uncertainty."""

    __tablename__ = "volcal_parameters"
    __table_args__ = (_of_run(),)
    machine: Mapped[str] = mapped_column(NAME, primary_key=True)
    run_id: Mapped[str] = mapped_column(RUN_ID, primary_key=True)
    name: Mapped[str] = mapped_column(WORD, primary_key=True)
    place: Mapped[int]
    value: Mapped[float]
    standard_uncertainty: Mapped[float]
    unit: Mapped[str] = mapped_column(String(8))


class StoredTemperature(Base):
    """One sensor over a run, °C."""

    __tablename__ = "volcal_temperatures"
    __table_args__ = (_of_run(),)
    machine: Mapped[str] = mapped_column(NAME, primary_key=True)
    run_id: Mapped[str] = mapped_column(RUN_ID, primary_key=True)
    sensor: Mapped[str] = mapped_column(NAME, primary_key=True)
    lowest: Mapped[float]
    mean: Mapped[float]
    highest: Mapped[float]


class StoredDecision(Base):
    """Gates, verification, acceptance …; `place`: index in their order; `record`: JSON."""

    __tablename__ = "volcal_decisions"
    __table_args__ = (_of_run(),)
    machine: Mapped[str] = mapped_column(NAME, primary_key=True)
    run_id: Mapped[str] = mapped_column(RUN_ID, primary_key=True)
    place: Mapped[int] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    kind: Mapped[str]
    record: Mapped[str]
