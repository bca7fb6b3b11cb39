"""One foreign machine, measured and identified, and its true errors compared with what the program states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from campaigns.foreign.machine import GRID, TOOL, ForeignMachine
from campaigns.foreign.score import true_error_um
from twin.identification import Estimate
from twin.identification.predicted import expected_vce, field_forms
from twin.uncertainty.coverage import FieldError
from twin.uncertainty.volumetric_distribution import volumetric_distributions
from twin.uncertainty.volumetric_limits import limits_of_form

NOMINAL = 0.95
_POINTS, _JOINT = 100, 12


@dataclass(frozen=True)
class ComparisonWithTruth:
    """True errors of a machine, and the statements of the program about them.

    `before_um` is the true volumetric error (VE), `after_um` the true volumetric error with compensation (VCE), and
    `predicted_um` the predicted one, all after the best rigid motion is removed. `ve_held` and `vce_held` are True if
    the stated 95 % limits contain the true value. `vce_rank` is the probability of a smaller VCE than the true one,
    according to the program. `field_held` is the share of the components of the error at 100 random points that their
    95 % intervals contain, and `joint_held` is True if the joint 95 % region of 12 of these points contains all their
    components.
    """

    before_um: float
    after_um: float
    predicted_um: float
    ve_held: bool
    vce_held: bool
    vce_rank: float
    field_held: float
    joint_held: bool

    @property
    def ratio(self) -> float:
        """True over predicted error with compensation."""
        return self.after_um / self.predicted_um


def compare_with_truth(machine: ForeignMachine, estimate: Estimate, rng: np.random.Generator) -> ComparisonWithTruth:
    """Compare `estimate` with the truth over the whole travel of the machine."""
    before_um, after_um = true_error_um(machine), true_error_um(machine, estimate)
    forms = field_forms(estimate, GRID, TOOL)
    limits = limits_of_form(estimate, forms[1])
    stated = volumetric_distributions(estimate, GRID, TOOL)
    low, high = np.array(machine.ranges).T
    points = rng.uniform(low, high, (_POINTS, 3))
    levels = FieldError.of(estimate, machine, points).pointwise_levels()
    joint = FieldError.of(estimate, machine, points[:_JOINT]).joint_level()
    return ComparisonWithTruth(
        before_um=before_um,
        after_um=after_um,
        predicted_um=expected_vce(estimate, forms).aligned_um,
        ve_held=limits.ve_um[0] <= before_um <= limits.ve_um[1],
        vce_held=limits.vce_um[0] <= after_um <= limits.vce_um[1],
        vce_rank=stated.vce.aligned.at_most((1e-3 * after_um) ** 2),
        field_held=float((levels <= NOMINAL).mean()),
        joint_held=joint <= NOMINAL,
    )
