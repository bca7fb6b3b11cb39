"""Temperature readings. They are taken with every ball that is measured, and therefore each ball centre has its own
temperature and time."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from agent.errors import MeasurementFault
from twin.units import REFERENCE_TEMPERATURE_C

ARTEFACT, MACHINE = "artefact", "machine"


@dataclass(frozen=True)
class Thermometers:
    """Names of the thermometers on the artefact and on the machine. The readings of several thermometers on one body
    are averaged.

    `declared_artefact_c` is the temperature in °C that is assumed for an artefact without a thermometer.
    """

    artefact: tuple[str, ...] = (ARTEFACT,)
    machine: tuple[str, ...] = (MACHINE,)
    declared_artefact_c: float | None = None

    def artefact_c(self, readings_c: Mapping[str, float]) -> float:
        """Return the artefact's temperature in °C: the declared temperature if there is one, else the mean of its
        thermometers. Raises MeasurementFault if no temperature is declared and a thermometer of the artefact gives no
        reading."""
        if self.declared_artefact_c is not None:
            return self.declared_artefact_c
        missing = [name for name in self.artefact if name not in readings_c]
        if missing:
            raise MeasurementFault(
                f"the artefact's temperature is not known: no reading of {', '.join(missing)}; "
                f"readings: {', '.join(readings_c) or 'none'}",
                hint="check its sensor and the names in the thermometer's settings, or declare "
                "temperature.declared_artefact_c with its uncertainty",
            )
        return math.fsum(readings_c[name] for name in self.artefact) / len(self.artefact)

    def machine_c(self, readings_c: Mapping[str, float]) -> float | None:
        """Return the mean in °C over those thermometers of the machine that give a reading; None if there is no
        reading."""
        known = [readings_c[name] for name in self.machine if name in readings_c]
        return math.fsum(known) / len(known) if known else None


@dataclass(frozen=True)
class Conditions:
    """Temperatures of artefact and machine at the time `instant_s` of the run's clock. `machine_c` is None if no
    thermometer of the machine gave a reading."""

    instant_s: float
    artefact_c: float
    machine_c: float | None = None

    @property
    def departure_k(self) -> float:
        """Difference in K of the artefact's temperature from the reference temperature of 20 °C."""
        return self.artefact_c - REFERENCE_TEMPERATURE_C


def conditions_of(thermometers: Thermometers, readings_c: Mapping[str, float], instant_s: float) -> Conditions:
    """Return the temperatures of artefact and machine that the readings in °C at the machine time `instant_s` give.
    Raises MeasurementFault if a thermometer of the artefact gives no reading."""
    return Conditions(instant_s, thermometers.artefact_c(readings_c), thermometers.machine_c(readings_c))


def rate_k_per_h(trace: Sequence[Conditions]) -> float | None:
    """Return the rate of change of the artefact's temperature in K/h: the least-squares slope of the readings in
    `trace`. The rate is None if the readings span no time."""
    if len(trace) < 2:
        return None
    middle_s = math.fsum(one.instant_s for one in trace) / len(trace)
    middle_c = math.fsum(one.artefact_c for one in trace) / len(trace)
    # Slope of the regression line: Σ(t − t̄)(T − T̄) / Σ(t − t̄)².
    square = math.fsum((one.instant_s - middle_s) ** 2 for one in trace)
    if square == 0.0:
        return None
    product = math.fsum((one.instant_s - middle_s) * (one.artefact_c - middle_c) for one in trace)
    return 3600.0 * product / square


def machine_change_k(conditions: Collection[Conditions], declared_k: float) -> float:
    """Return the range (largest minus smallest value) in K of the machine's temperature readings. If there are no
    readings, return `declared_k`."""
    readings_c = [one.machine_c for one in conditions if one.machine_c is not None]
    return max(readings_c) - min(readings_c) if readings_c else declared_k
