"""Origin of a run (settings, kind and start conditions), as the journal stores it. It contains the data needed to build
an interrupted run again and to detect changed input files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Any

from agent.errors import PlanDiverged
from agent.execution.journal_reader import JournalReader
from agent.execution.stored_json import stored_json
from agent.results.decision_kinds import INPUTS
from agent.results.journal_entries import input_files, sha256_of
from agent.runs.consent import Consent
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.kinds.nightly import Night
from agent.runs.kinds.trial import OneBallTrial
from agent.runs.kinds.verify import Verification
from agent.runs.planned_run import Kind, StartConditions
from agent.settings.load import POSITION_FILES, stored_settings
from agent.settings.schema import Settings
from drivers.errors import InputError
from drivers.roles import Activation, StoreLimits

KINDS = {kind.name: kind for kind in (FullCalibration, Verification, Night, OneBallTrial)}


@dataclass(frozen=True)
class Origin:
    """Settings, kind and start conditions of a run that has passed its preflight.

    `base` is the directory to which relative paths refer. `files` maps the path of each input file to the SHA-256 of
    the file. `begun_s` is the time of the machine's clock in s at the end of the preflight, and `begun_at` is the UTC
    time of that instant. `latencies_from` is the identity of the run that has shown the latencies in `settings`; it is
    empty if they are as stated.
    """

    run_id: str
    settings: Settings
    kind: Kind
    base: Path
    start: StartConditions
    files: Mapping[str, str]
    begun_s: float
    begun_at: str
    latencies_from: str = ""

    def require_unchanged(self) -> None:
        """Raise PlanDiverged if an input file has changed since the run began. The error names the file and the run."""
        for name, digest in digests(self.settings, self.base).items():
            if self.files.get(name) != digest:
                raise PlanDiverged(
                    "the file has changed since the run began, so the run cannot be resumed",
                    hint="restore the former file, or start a new run",
                    file=name,
                    run=self.run_id,
                )


def origin_record(settings: Settings, kind: Kind, base: Path, start: StartConditions) -> dict[str, Any]:
    """Return the origin of a run as a record that `RunJournal.origin`, a method of the journal, can store."""
    options = {f.name: getattr(kind, f.name) for f in fields(kind) if f.name != "name"}  # type: ignore[arg-type]
    return {
        "kind": kind.name,
        "options": {name: value.value if isinstance(value, Enum) else value for name, value in options.items()},
        "base": str(base),
        "at": start.at,
        "start_mm": list(start.start_mm),
        "store": {**vars(start.store), "activation": start.store.activation.value},
        "files": digests(settings, base),
    }


def read_origin(reader: JournalReader, run: int) -> Origin:
    """Return the origin of the run with the number `run`. Raises InputError if the journal does not contain the origin,
    if the run did not pass its preflight, or if this version cannot read its settings."""
    row = reader.origin(run)
    if row is None or row.begun_s is None or row.begun_at is None:
        raise InputError("the journal does not store how this run began", hint="start a new run")
    record = row.record
    x, y, z = record["start_mm"]
    return Origin(
        run_id=row.run_id,
        settings=stored_settings(stored_json(row.settings_text), row.run_id),
        kind=_kind(record["kind"], record["options"]),
        base=Path(record["base"]),
        start=StartConditions(run, record["at"], (x, y, z), _store(record["store"])),
        files=record["files"],
        begun_s=row.begun_s,
        begun_at=row.begun_at,
        latencies_from=_latencies_from(reader, run),
    )


def _latencies_from(reader: JournalReader, run: int) -> str:
    inputs = reader.decision(run, INPUTS)
    return "" if inputs is None else str(inputs.record.get("latencies_from", ""))


def digests(settings: Settings, base: Path) -> dict[str, str]:
    """Return a mapping from the path of each input file of a run to the SHA-256 of the file.

    The input files are the machine file, the artefact file, the files named in these two, and the position file if
    there is one.
    """
    paths = list(input_files(settings.machine, settings.artefact))
    if settings.procedure.position_set.endswith(POSITION_FILES):
        paths.append(base / settings.procedure.position_set)
    return {str(path): sha256_of(path) for path in paths}


def _store(record: Mapping[str, Any]) -> StoreLimits:
    x, y, z = record["max_nodes"]
    banks, activation = tuple(record["banks"]), Activation(record["activation"])
    return StoreLimits(**{**record, "banks": banks, "max_nodes": (x, y, z), "activation": activation})


def _kind(name: str, options: Mapping[str, Any]) -> Kind:
    if name not in KINDS:
        raise InputError(f"this version has no run of kind {name!r}", hint="start a new run")
    values = dict(options)
    if "consent" in values:
        values["consent"] = Consent(values["consent"])
    return KINDS[name](**values)
