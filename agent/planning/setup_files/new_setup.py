"""All files of a new machine, written and checked together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job, reached_balls
from agent.planning.setup_files.artefact_text import artefact_text
from agent.planning.setup_files.machine_text import machine_text
from agent.planning.setup_files.scenario_text import scenario_text
from agent.planning.setup_files.settings_text import settings_text
from agent.planning.setup_proposal.artefact_setup import ArtefactSetup
from agent.planning.setup_proposal.controller_setup import ControllerSetup
from agent.planning.setup_proposal.machine_setup import MachineSetup
from agent.planning.setup_proposal.station_setup import FULL_ELEVATION_DEG, StationSetup, positions_of
from agent.settings.load import load_settings
from twin.design.procedure import MIN_BALLS
from twin.formats.position_set_file import format_positions

MACHINE_FILE = "machine.toml"
ARTEFACT_FILE = "artefact.toml"
SETTINGS_FILE = "volcal.toml"
SCENARIO_FILE = "simulator.toml"
POSITIONS_FILE = "positions.csv"
"""Names of the files in the directory of a machine. The file of positions exists only if no named set is proposed."""


@dataclass(frozen=True)
class Effort:
    """Measurements of a run: a named position set, where one suits the machine, and the touches of each ball."""

    named_set: str
    touches_per_ball: int


EFFORTS = (Effort("S1+S3", 5), Effort("S1+S2+S3", 5), Effort("S1+S2+S3", 9))
"""Proposed efforts, in ascending order. The first that is expected to pass all gates with a margin suffices."""
LAST_EFFORT = Effort("S1+S2+S3", 25)
"""Effort if the others are not expected to pass all gates: hours, for little more."""


@dataclass(frozen=True)
class NewSetup:
    """Everything that is stated, read or proposed about a new machine.

    `artefact_files` maps the names of existing files to their texts if they replace the file of a nominal artefact;
    `artefact` then contains the dimensions of that one. `position_set` is a set or file named by a person, None for the
    proposed one, which follows from `effort`. `touches_per_ball` is the number stated
    by a person, None for that of `effort`. `held_out_positions` is their number, None for the default.
    """

    machine: MachineSetup
    controller: ControllerSetup
    artefact: ArtefactSetup
    stations: StationSetup
    artefact_files: Mapping[str, str] | None = None
    position_set: str | None = None
    touches_per_ball: int | None = None
    effort: Effort = EFFORTS[0]
    held_out_positions: int | None = None

    @property
    def named_set(self) -> str | None:
        """Position set that needs no file: the one that a person named, else the proposed one if it exists by name."""
        if self.position_set is not None:
            return self.position_set
        suits = self.artefact.is_bar and self.stations.elevation_deg == FULL_ELEVATION_DEG
        return self.effort.named_set if suits else None

    @property
    def efforts(self) -> tuple[Effort, ...]:
        """Efforts among which to choose, without those that differ only in what a person stated."""
        by_meaning = {
            (
                replace(self, effort=effort).named_set,
                self.touches_per_ball or effort.touches_per_ball,
            ): effort
            for effort in reversed((*EFFORTS, LAST_EFFORT))
        }
        return tuple(reversed(by_meaning.values()))

    def texts(self, position_set: str) -> dict[str, str]:
        """Return the texts of machine, artefact, settings and scenario file by file name."""
        names = {"machine_file": MACHINE_FILE, "artefact_file": ARTEFACT_FILE}
        return {
            MACHINE_FILE: machine_text(self.machine),
            **(self.artefact_files or {ARTEFACT_FILE: artefact_text(self.artefact, self.machine.spindle)}),
            SETTINGS_FILE: settings_text(
                self.machine,
                self.controller,
                self.stations,
                position_set=position_set,
                touches_per_ball=self.touches_per_ball or self.effort.touches_per_ball,
                held_out_positions=self.held_out_positions,
                **names,
            ),
            SCENARIO_FILE: scenario_text(self.machine, self.stations, **names),
        }


def checked_files(setup: NewSetup, directory: Path) -> tuple[Mapping[str, str], Job]:
    """Write the files of a new machine into the empty scratch `directory`, check them as `volcal config check` does,
    and return their texts by file name, and the job that they describe.

    Without a named set, a position file with the orientations that the probe can measure is among the files. Raises
    ConfigurationError if the files contradict each other, for example because no ball is within reach.
    """
    named = setup.named_set
    texts = setup.texts(named or LAST_EFFORT.named_set)
    job = _written(texts, directory)
    if named is not None:
        return texts, job
    measurable = [
        position
        for position in positions_of(setup.stations, setup.machine.spindle, is_bar=setup.artefact.is_bar)
        if reached_balls(job, position) >= MIN_BALLS
    ]
    texts = {**setup.texts(POSITIONS_FILE), POSITIONS_FILE: format_positions(measurable)}
    return texts, _written(texts, directory)


def _written(texts: Mapping[str, str], directory: Path) -> Job:
    for name, text in texts.items():
        (directory / name).write_text(text, encoding="utf-8")
    return prepare_job(load_settings(directory / SETTINGS_FILE), directory)
