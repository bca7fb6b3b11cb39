"""Assumptions about the true machine, the true artefact and the true conditions of a measurement.

The assumptions include errors that the identified model does not have. The Monte Carlo simulation draws machines
according to the assumptions, and the error budget in closed form computes second moments from the same assumptions. The
results of the two methods can therefore be compared.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError
from twin.machine.deflection import DeflectionGrid
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import Family
from twin.uncertainty.measurement_effects import MeasurementEffect


@dataclass(frozen=True, eq=False)
class TruthAssumptions:
    """Assumed true errors of machine, artefact and measurement conditions.

    `family` is the distribution from which the true machines are drawn; its Legendre order may exceed that of the
    identified model. `deflection` is the deflection that all true machines share. `touch_noise`, `certificate` and
    `cte` switch three errors on or off: the error of a ball centre, the error of the certified ball positions, and the
    error of the artefact's coefficient of thermal expansion (CTE). An error that is switched on varies according to its
    stated uncertainty; an error that is switched off is zero.

    `artefact_temperature_c` is the true temperature of the artefact during the measurement. `thermometer_uncertainty_k`
    is the standard uncertainty of the thermometer of the artefact; the error of the thermometer is constant during a
    run. The machine drifts linearly from the first to the last ball of each position of the artefact, and `drift_mm` is
    the standard deviation of this drift, per direction, at the last ball. `effects` displace the measured ball centres
    in addition; each has a name of its own.
    """

    family: Family
    deflection: DeflectionGrid | None = None
    touch_noise: bool = True
    certificate: bool = True
    cte: bool = True
    artefact_temperature_c: float = 20.0
    thermometer_uncertainty_k: float = 0.0
    drift_mm: float = 0.0
    effects: tuple[MeasurementEffect, ...] = ()

    def __post_init__(self) -> None:
        for name in ("thermometer_uncertainty_k", "drift_mm"):
            if not getattr(self, name) >= 0.0:
                raise DataError(f"{name} must not be negative, not {getattr(self, name)}")
        names = [effect.name for effect in self.effects]
        if len(set(names)) < len(names):
            raise DataError(f"an effect occurs twice: {', '.join(names)}", hint="state each effect once")

    @classmethod
    def as_modelled(cls, machine: MachineDescription) -> TruthAssumptions:
        """Return the assumptions for machines that the identified model can represent.

        There is no deflection, no thermometer error and no drift.
        """
        return cls(machine.family)

    @classmethod
    def of_case(cls, machine: MachineDescription) -> TruthAssumptions:
        """Return the assumptions for machines with the family and the deflection of a machine file."""
        return cls(machine.family, machine.deflection)
