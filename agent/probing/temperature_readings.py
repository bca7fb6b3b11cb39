"""How warm it is and when: read with every ball, so that a ball's centre carries its own temperature and instant."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from agent.errors import MeasurementFault
from agent.execution.steps import Plan, ReadClock, ReadTemperatures
from twin.artefact.artefact import REFERENCE_TEMPERATURE_C

ARTEFACT, MACHINE = "artefact", "machine"


@dataclass(frozen=True)
class Thermometers:
    """Which of the names that the thermometer tells stand on what; several are averaged.

    `declared_artefact_c`: where no thermometer is on the artefact, what it is taken to have.
    """

    artefact: tuple[str, ...] = (ARTEFACT,)
    machine: tuple[str, ...] = (MACHINE,)
    declared_artefact_c: float | None = None

    def artefact_c(self, told: Mapping[str, float]) -> float:
        """Mean of the artefact's thermometers. MeasurementFault where one of them says nothing."""
        if self.declared_artefact_c is not None:
            return self.declared_artefact_c
        silent = [name for name in self.artefact if name not in told]
        if silent:
            raise MeasurementFault(
                f"the artefact's temperature is not known: nothing is told of {', '.join(silent)}; "
                f"there are: {', '.join(told) or 'none'}",
                hint="check its sensor and the names in the thermometer's settings, or declare "
                "temperature.declared_artefact_c with its uncertainty",
            )
        return math.fsum(told[name] for name in self.artefact) / len(self.artefact)

    def machine_c(self, told: Mapping[str, float]) -> float | None:
        """Mean of those of the machine's thermometers that tell anything; None where none does."""
        known = [told[name] for name in self.machine if name in told]
        return math.fsum(known) / len(known) if known else None


@dataclass(frozen=True)
class Conditions:
    """At one instant (seconds of the run's clock)."""

    instant_s: float
    artefact_c: float
    machine_c: float | None = None

    @property
    def departure_k(self) -> float:
        """Of the artefact from the reference temperature."""
        return self.artefact_c - REFERENCE_TEMPERATURE_C


def read_conditions(key: str, thermometers: Thermometers) -> Plan[Conditions]:
    """Conditions now; nothing moves."""
    told = yield ReadTemperatures(f"{key}/temperatures")
    instant_s = yield ReadClock(f"{key}/instant")
    return Conditions(instant_s, thermometers.artefact_c(told), thermometers.machine_c(told))


def rate_k_per_h(trace: Sequence[Conditions]) -> float | None:
    """Slope of the artefact's temperature by least squares; None where the readings lie too near together to tell."""
    if len(trace) < 2:
        return None
    middle_s = math.fsum(one.instant_s for one in trace) / len(trace)
    middle_c = math.fsum(one.artefact_c for one in trace) / len(trace)
    square = math.fsum((one.instant_s - middle_s) ** 2 for one in trace)
    if square == 0.0:
        return None
    product = math.fsum((one.instant_s - middle_s) * (one.artefact_c - middle_c) for one in trace)
    return 3600.0 * product / square
