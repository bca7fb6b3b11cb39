"""Assumptions about the true machine, the true artefact and the true conditions of a measurement. They include errors
that the identified model does not have.

The simulation draws machines according to these assumptions, and the closed form computes second moments from them, so
the results of both can be compared.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError
from twin.machine.deflection import DeflectionGrid
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import Family


@dataclass(frozen=True, eq=False)
class TruthAssumptions:
    """True errors of machine, artefact and conditions that affect a procedure.

    `family` is the family of the true machines, whose Legendre order may exceed that of the identified model.
    `deflection` is common to all true machines. `touch_noise`, `certificate` and `cte` state for three errors whether
    they occur: those of a ball centre, of the certified ball positions, and of the artefact's coefficient of thermal
    expansion (CTE). If true, the error varies within its stated uncertainty; if false, it is zero.

    `artefact_temperature_c` is the true temperature of the artefact during the measurement. `thermometer_uncertainty_k`
    is the standard uncertainty of its thermometer, whose error is constant during a run. `drift_mm` is the standard
    deviation, per direction, of the machine's drift from the first to the last ball of a position; the drift is linear
    in between.
    """

    family: Family
    deflection: DeflectionGrid | None = None
    touch_noise: bool = True
    certificate: bool = True
    cte: bool = True
    artefact_temperature_c: float = 20.0
    thermometer_uncertainty_k: float = 0.0
    drift_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("thermometer_uncertainty_k", "drift_mm"):
            if not getattr(self, name) >= 0.0:
                raise DataError(f"{name} must not be negative, not {getattr(self, name)}")

    @classmethod
    def as_modelled(cls, machine: MachineDescription) -> TruthAssumptions:
        """Return the assumptions for machines that the model can represent. There is no deflection, no thermometer
        error and no drift."""
        return cls(machine.family)

    @classmethod
    def of_case(cls, machine: MachineDescription) -> TruthAssumptions:
        """Return the assumptions for machines of the machine file's family with the deflection of that file."""
        return cls(machine.family, machine.deflection)
