"""Case of the run that is interrupted: a small position set on the machine of the case study, with a compensation table
from an earlier run (the former table) active.

All data of the run are kept in memory.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.execution.journal_reader import JournalReader
from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.roles import TableImage
from simulators.scenario import read_scenario
from simulators.world.world import World

FORMER_BANK = 1
FORMER_TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 650.0, 750.0), 1e-4, np.full((3, 3, 3, 3), 7, dtype=np.int32))
"""Constant correction, active before the run. It must be active again afterwards. Its bank is not 0, because bank 0
means no table.
"""
POSITIONS = "station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n1,90,45\n"
LENIENT: dict[str, dict[str, Any]] = {
    "verification": {
        "stations": [1],
        "positions_deg": [(20.0, 25.0)],
        "max_chi2": 1e3,
    },
    "gates": {
        "min_degrees_of_freedom": 1,
        "max_unmeasured_fraction": 10.0,
        "max_chi2": 1e3,
        "max_correction_um": 1e3,
    },
    "table": {"step_mm": (500.0, 325.0, 500.0)},
}
"""Settings of a run of few positions: one held-out position, gates that few measurements can pass, a coarse table."""
SCALE = 4.0
"""Scale of the machine's errors.

The new table then reduces the errors so much, and the gates are so wide, that every uninterrupted run is accepted.
"""


def prepare_case(directory: Path, **sections: dict[str, Any]) -> Job:
    """Return a job with three measured positions at one station and one held-out position, whose measurement tests the
    result.

    The settings do not say at which station the artefact stands, so the run asks the operator for it.
    """
    listed = directory / "three-positions.csv"
    listed.write_text(POSITIONS)
    document = load_settings(CASE_STUDY).model_dump()
    changes: dict[str, dict[str, Any]] = {
        "procedure": {"position_set": str(listed), "stations": [1]},
        "stations": {"standing_at": None},
        **LENIENT,
    }
    for name in {*changes, *sections}:
        document[name] = {**document[name], **changes.get(name, {}), **sections.get(name, {})}
    settings = Settings.model_validate(document).model_copy(update={"state_directory": directory / "state"})
    return prepare_job(settings, SHIPPED_CONFIGURATION)


def build_case_world() -> World:
    """Return a simulated world with the machine of the case study and larger errors. The controller holds a
    compensation table from an earlier run (the former table), which is active.
    """
    shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
    truth = shipped.settings.truth.model_copy(update={"scale": SCALE})
    world = World(replace(shipped, settings=shipped.settings.model_copy(update={"truth": truth})))
    world.controller.write_bank(FORMER_BANK, FORMER_TABLE)
    world.controller.activate(FORMER_BANK)
    return world


@dataclass
class InMemoryDatabase:
    """Single in-memory database for all SQLite connections of this process. A forked process has its own copy of the
    data.
    """

    connection: sqlite3.Connection
    connect: Callable[..., sqlite3.Connection]

    @classmethod
    def replace_files(cls) -> InMemoryDatabase:
        """Make `sqlite3.connect` always open the one database in memory, regardless of the requested file."""
        real, address = sqlite3.connect, "file:volcal-aborts?mode=memory&cache=shared"

        def connect(_: object, **options: Any) -> sqlite3.Connection:
            opened: sqlite3.Connection = real(address, **{**options, "uri": True})
            return opened

        sqlite3.connect = connect  # type: ignore[assignment]
        return cls(real(address, uri=True, isolation_level=None), real)

    def fill(self) -> None:
        """Simulate a full disk: from now on SQLite refuses every statement for which the database would
        have to grow.
        """
        [pages] = self.connection.execute("PRAGMA page_count").fetchone()
        self.connection.execute(f"PRAGMA max_page_count = {pages}")

    @property
    def journal(self) -> JournalReader:
        return JournalReader(self.connection)

    def restore_files(self) -> None:
        """Make `sqlite3.connect` open the requested files again, as before `replace_files`, and close the database in
        memory.
        """
        sqlite3.connect = self.connect  # type: ignore[assignment]
        self.connection.close()
