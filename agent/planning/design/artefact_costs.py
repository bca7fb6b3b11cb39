"""Costs of an artefact and its mount: a file that the user can change, the purchase, and the cost of a calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field

from agent.files import read_text, translated
from agent.planning.case_file import SHIPPED_CONFIGURATION
from drivers.errors import ConfigurationError
from twin.formats.toml_reading import StrictModel, read_toml

SHIPPED_COSTS = SHIPPED_CONFIGURATION / "costs" / "artefact.toml"
"""Cost file that is used if the user names none. Its values are assumed."""

Euro = Annotated[float, Field(ge=0.0, le=1e7)]
Runs = Annotated[float, Field(ge=1.0, le=1e6)]
_MIN_PER_H = 60.0


class BarCosts(StrictModel):
    """Section `[bar]` of a cost file: price of the bar without balls."""

    euro: Euro
    euro_per_mm: Euro


class BallCosts(StrictModel):
    """Section `[ball]` of a cost file: price of each ball with its holder."""

    euro: Euro


class CalibrationCosts(StrictModel):
    """Section `[calibration]` of a cost file: price of a calibration of the artefact, the number of calibrations of the
    machine `runs` after which it is due again, and the uncertainty (k = 1) that it states.

    The standard uncertainty of a ball centre at the distance L from the middle of the bar consists of
    `standard_uncertainty_um` for each coordinate, independent, and of a common part that is L times
    `length_standard_uncertainty_ppm`.
    """

    euro: Euro
    euro_per_ball: Euro
    runs: Runs
    standard_uncertainty_um: Annotated[float, Field(gt=0.0, le=1000.0)]
    length_standard_uncertainty_ppm: Annotated[float, Field(ge=0.0, le=1000.0)]


class MountCosts(StrictModel):
    """Section `[mount]` of a cost file: price of the mount. `fork_euro` is added if the rotation centre is in the
    middle of the bar."""

    euro: Euro
    euro_per_mm_of_shaft: Euro
    euro_per_mm_of_pedestal: Euro
    fork_euro: Euro


class StationCosts(StrictModel):
    """Section `[station]` of a cost file: price of each station."""

    euro: Euro


class UseCosts(StrictModel):
    """Section `[use]` of a cost file: calibrations in the life of artefact and mount, and prices of an hour of the
    machine and of the operator who carries the mount."""

    runs: Runs
    machine_euro_per_hour: Euro
    operator_euro_per_hour: Euro


@dataclass(frozen=True)
class Equipment:
    """Quantities that determine the purchase of an artefact and its mount. Lengths are in mm: `shaft_mm` is the
    distance between rotation centre and bar, and `pedestal_mm` that between table and rotation centre. `fork` is True
    if the rotation centre is in the middle of the bar."""

    length_mm: float
    balls: int
    shaft_mm: float
    pedestal_mm: float
    fork: bool
    stations: int


class ArtefactCosts(StrictModel):
    """Cost file (TOML): prices in euro."""

    bar: BarCosts
    ball: BallCosts
    calibration: CalibrationCosts
    mount: MountCosts
    station: StationCosts
    use: UseCosts

    def purchase(self, equipment: Equipment) -> dict[str, float]:
        """Return the purchase in euro by part: bar, balls, the first calibration, mount and stations."""
        mount, one = self.mount, equipment
        return {
            "bar": self.bar.euro + self.bar.euro_per_mm * one.length_mm,
            "balls": self.ball.euro * one.balls,
            "calibration": self.recalibration_euro(one),
            "mount": mount.euro
            + mount.euro_per_mm_of_shaft * one.shaft_mm
            + mount.euro_per_mm_of_pedestal * one.pedestal_mm
            + (mount.fork_euro if one.fork else 0.0),
            "stations": self.station.euro * one.stations,
        }

    def purchase_euro(self, equipment: Equipment) -> float:
        """Return the purchase in euro, the first calibration of the artefact included."""
        return sum(self.purchase(equipment).values())

    def recalibration_euro(self, equipment: Equipment) -> float:
        """Return the price in euro of one calibration of the artefact."""
        return self.calibration.euro + self.calibration.euro_per_ball * equipment.balls

    def run_euro(self, equipment: Equipment, machine_minutes: float, carrying_minutes: float) -> float:
        """Return the cost in euro of one calibration of the machine that takes `machine_minutes`, of which an operator
        carries the mount for `carrying_minutes`.

        It consists of the purchase spread over the calibrations of the life, the calibration of the artefact spread
        over those until it is due again, the machine and the operator.
        """
        use = self.use
        hours = machine_minutes * use.machine_euro_per_hour + carrying_minutes * use.operator_euro_per_hour
        bought_once = self.purchase_euro(equipment) - self.recalibration_euro(equipment)
        return (
            bought_once / use.runs
            + self.recalibration_euro(equipment) / min(self.calibration.runs, use.runs)
            + hours / _MIN_PER_H
        )


def load_costs(path: Path) -> ArtefactCosts:
    """Return the costs of a cost file. Raises ConfigurationError, which names the file and the key, if it cannot be
    used."""
    text = read_text(path, error=ConfigurationError)
    with translated(ConfigurationError, file=str(path)):
        return read_toml(text, str(path), ArtefactCosts)
