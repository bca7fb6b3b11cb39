"""What a procedure meets: the machine, the artefact and the day as they may really be, richer than what is identified.

One value from which machines are drawn for a simulation and from which second moments are taken for the closed form, so
that the two speak of the same thing.
"""

from __future__ import annotations

from dataclasses import dataclass

from twin.errors import DataError
from twin.machine.deflection import DeflectionGrid
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import Family


@dataclass(frozen=True, eq=False)
class TruthAssumptions:
    """`family`: of the true machines; its Legendre order may be above that of the model identified. `deflection`: acts
    on all of them. `touch_noise`, `certificate`, `cte`: whether these differ from what is stated, within the stated
    uncertainty (covariance of a centre; the artefact's covariance; its CTE's standard uncertainty).

    `artefact_temperature_c`: what the artefact has while it is measured; `thermometer_uncertainty_k`: standard
    uncertainty of its thermometer, one error for the whole run; `drift_mm`: standard deviation, per direction, of what
    the machine drifts from the first to the last ball of a position, linearly.
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
        """Machines that the model can represent, nothing beside it but touch noise and certificate."""
        return cls(machine.family)

    @classmethod
    def of_case(cls, machine: MachineDescription) -> TruthAssumptions:
        """Machines of the family with the deflection of the machine file."""
        return cls(machine.family, machine.deflection)
