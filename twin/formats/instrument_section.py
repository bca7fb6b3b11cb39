"""Section of an estimate file about the instruments whose readings were evaluated with the ball centres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pydantic import Field

from twin.formats.toml_reading import StrictModel
from twin.identification.instruments.check_result import InstrumentCheck, LargestResidual
from twin.identification.instruments.readings import InstrumentKind
from twin.units import MICRO_UNITS


class LargestDifferenceSection(StrictModel):
    """Reading that differs most from what all others say: its row in the file, the difference in its own standard
    uncertainties, and its size in `unit`."""

    row: int
    sigmas: float
    size: float
    unit: Literal["µm", "µrad"]


class InstrumentSection(StrictModel):
    """Test of one instrument against the ball centres and the other instruments. `joined` is True if its readings are
    part of the estimate."""

    name: str
    kind: InstrumentKind
    readings: int
    chi2: float = Field(ge=0.0)
    degrees_of_freedom: int
    false_alarm: float = Field(ge=0.0, le=1.0)
    largest: LargestDifferenceSection
    contradicts: bool
    joined: bool

    @property
    def check(self) -> InstrumentCheck:
        """The result of the test as it was stored."""
        unit, factor = next(
            (name, factor) for name, (micro, factor) in MICRO_UNITS.items() if micro == self.largest.unit
        )
        largest = LargestResidual(self.largest.row, self.largest.sigmas, self.largest.size / factor, unit)
        return InstrumentCheck(
            self.name,
            self.kind,
            self.readings,
            self.chi2,
            self.degrees_of_freedom,
            self.false_alarm,
            largest,
            self.contradicts,
            self.joined,
        )


def instrument_documents(checks: Sequence[InstrumentCheck]) -> list[dict[str, Any]]:
    """Return the tests of the instruments as JSON objects, one for each instrument."""
    found = []
    for check in checks:
        size, unit = check.largest.micro
        largest = {"row": check.largest.line, "sigmas": check.largest.sigmas, "size": size, "unit": unit}
        found.append({**vars(check), "largest": largest})
    return found
