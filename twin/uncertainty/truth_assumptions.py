"""Assumptions about the true machine, artefact and conditions, richer than the model that is identified.

The simulation draws machines from them and the closed form takes second moments from them, so both refer to the same
assumptions.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError
from twin.machine.deflection import DeflectionGrid
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import Family


@dataclass(frozen=True, eq=False)
class TruthAssumptions:
    """True errors that a procedure has to deal with.

    `family`: family of the true machines, whose Legendre order may exceed that of the identified model. `deflection`:
    common to all of them. `touch_noise`, `certificate`, `cte`: if true, the error varies within its stated uncertainty
    (covariance of a centre, covariance of the artefact, standard uncertainty of its CTE); if false, it is zero.

    `artefact_temperature_c`: true temperature of the artefact during the measurement; `thermometer_uncertainty_k`:
    standard uncertainty of its thermometer, one error for the whole run; `drift_mm`: standard deviation per direction
    of the machine's drift from the first to the last ball of a position, linear in between.
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
        """Return the assumptions for machines that the model can represent, with errors of touches and certificate
        only."""
        return cls(machine.family)

    @classmethod
    def of_case(cls, machine: MachineDescription) -> TruthAssumptions:
        """Return the assumptions for machines of the family with the deflection of the machine file."""
        return cls(machine.family, machine.deflection)
