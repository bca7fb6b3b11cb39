"""Everything that is stated, read or proposed about a new machine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from agent.planning.new_machine.artefact_setup import ArtefactSetup
from agent.planning.new_machine.controller_setup import ControllerSetup
from agent.planning.new_machine.machine_setup import MachineSetup
from agent.planning.new_machine.station_setup import FULL_ELEVATION_DEG, StationSetup

MACHINE_FILE = "machine.toml"
ARTEFACT_FILE = "artefact.toml"
SETTINGS_FILE = "volcal.toml"
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
        """Name of a position set that needs no file: the one chosen by a person, else the proposed one if it has a
        name."""
        if self.position_set is not None:
            return self.position_set
        suits = self.artefact.is_bar and not self.stations.by_hand and self.stations.elevation_deg == FULL_ELEVATION_DEG
        return self.effort.named_set if suits else None

    @property
    def touches(self) -> int:
        """Touches of each ball."""
        return self.touches_per_ball or self.effort.touches_per_ball

    @property
    def efforts(self) -> tuple[Effort, ...]:
        """Efforts among which to choose, without those that differ only in what a person stated."""
        by_meaning = {}
        for effort in reversed((*EFFORTS, LAST_EFFORT)):
            changed = replace(self, effort=effort)
            by_meaning[changed.named_set, changed.touches] = effort
        return tuple(reversed(by_meaning.values()))
