"""Result of the test of an instrument against the ball centres and the other instruments."""

from __future__ import annotations

from dataclasses import dataclass

from twin.units import MICRO_UNITS


@dataclass(frozen=True)
class LargestResidual:
    """Reading that differs most from what all others say, in its own standard uncertainties `sigmas`.

    `line` is its number in the file of the instrument. `size` is the difference in `unit`, mm or rad.
    """

    line: int
    sigmas: float
    size: float
    unit: str

    @property
    def micro(self) -> tuple[float, str]:
        """Difference in µm or µrad, and this unit."""
        unit, factor = MICRO_UNITS[self.unit]
        return factor * self.size, unit

    @property
    def text(self) -> str:
        """Place and size of the difference, such as `row 7: 3.9 sigma, 8.1 µm`."""
        size, unit = self.micro
        return f"row {self.line}: {abs(self.sigmas):.1f} sigma, {size:.1f} {unit}"


@dataclass(frozen=True)
class InstrumentCheck:
    """Result of the test of one instrument, the file `name`, against the rest.

    `chi2` has `degrees_of_freedom`. `false_alarm` is at most the probability of such a χ² or such a largest difference
    if the instrument and the estimate are right. `contradicts` is True if that is less than the limit, and `joined` is
    True if the readings are part of the estimate.
    """

    name: str
    kind: str
    readings: int
    chi2: float
    degrees_of_freedom: int
    false_alarm: float
    largest: LargestResidual
    contradicts: bool
    joined: bool
