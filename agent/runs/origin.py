"""How a run began, as the journal keeps it: enough to build it again, and to notice that something has changed."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Any

from agent.errors import PlanDiverged
from agent.results.journal_entries import input_files, sha256_of
from agent.runs.consent import Consent
from agent.runs.kinds.kind import FullCalibration, Kind
from agent.runs.kinds.nightly import Night
from agent.runs.kinds.verify import Verification
from agent.runs.start_conditions import Outset
from agent.settings.load import POSITION_FILES
from agent.settings.schema import Settings
from drivers.errors import InputError
from twin.formats.toml_reading import with_current_keys

KINDS = {kind.name: kind for kind in (FullCalibration, Verification, Night)}


@dataclass(frozen=True)
class Origin:
    """`begun_s`, `begun_at`: machine seconds and UTC at which the preflight was over; `files` path → SHA-256."""

    run_id: str
    settings: Settings
    kind: Kind
    base: Path
    outset: Outset
    files: Mapping[str, str]
    begun_s: float
    begun_at: str

    def require_unchanged(self) -> None:
        """PlanDiverged, naming the file, where one is not what it was when the run began."""
        for name, digest in digests(self.settings, self.base).items():
            if self.files.get(name) != digest:
                raise PlanDiverged(
                    "the file has changed since the run began, so the run cannot be gone on with",
                    hint="put the former file back, or start a new run",
                    file=name,
                    run=self.run_id,
                )


def origin_record(settings: Settings, kind: Kind, base: Path, outset: Outset) -> dict[str, Any]:
    """For `RunJournal.origin`."""
    options = {f.name: getattr(kind, f.name) for f in fields(kind) if f.name != "name"}  # type: ignore[arg-type]
    return {
        "kind": kind.name,
        "options": {name: value.value if isinstance(value, Enum) else value for name, value in options.items()},
        "base": str(base),
        "at": outset.at,
        "start_mm": list(outset.start_mm),
        "files": digests(settings, base),
    }


def read_origin(connection: sqlite3.Connection, run: int) -> Origin:
    """InputError where the journal does not tell how the run began."""
    row = connection.execute(
        "SELECT run_id, settings, record, begun_s, begun_at FROM runs JOIN origins USING (run) WHERE run = ?", (run,)
    ).fetchone()
    if row is None or row[3] is None:
        raise InputError("the journal does not tell how this run began", hint="start a new run")
    run_id, settings, text, begun_s, begun_at = row
    record = json.loads(text)
    x, y, z = record["start_mm"]
    return Origin(
        run_id=run_id,
        settings=Settings.model_validate(with_current_keys(json.loads(settings), Settings)),
        kind=_kind(record["kind"], record["options"]),
        base=Path(record["base"]),
        outset=Outset(run, record["at"], (x, y, z)),
        files=record["files"],
        begun_s=begun_s,
        begun_at=begun_at,
    )


def digests(settings: Settings, base: Path) -> dict[str, str]:
    """Machine, artefact, what they name, and the position file."""
    paths = list(input_files(settings))
    if settings.procedure.position_set.endswith(POSITION_FILES):
        paths.append(base / settings.procedure.position_set)
    return {str(path): sha256_of(path) for path in paths}


def _kind(name: str, options: Mapping[str, Any]) -> Kind:
    if name not in KINDS:
        raise InputError(f"this version knows no run of kind {name!r}", hint="start a new run")
    values = dict(options)
    if "consent" in values:
        values["consent"] = Consent(values["consent"])
    return KINDS[name](**values)
