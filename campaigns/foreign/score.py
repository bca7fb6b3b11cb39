"""Identification of a foreign machine, and what it states, compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from benchmarks.family import AMPLITUDES
from campaigns.foreign.artefact import ForeignBar
from campaigns.foreign.machine import CHAIN, GRID, RANGES, TOOL, DrawnMachine, aligned_rms_um
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification import Estimate, Options, identify_by_evidence, predicted_vce
from twin.identification.predicted import expected_vce, field_forms
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import Family, family_from_amplitudes
from twin.uncertainty.coverage import FieldError
from twin.uncertainty.volumetric_distribution import aligned_distributions
from twin.uncertainty.volumetric_limits import limits_of_form

NOMINAL = 0.95
_POINTS, _JOINT = 100, 12


@dataclass(frozen=True)
class Score:
    """Estimate of a machine, with its true volumetric error before and after compensation and the predicted one, all in
    µm after the best rigid motion is removed."""

    estimate: Estimate
    before_um: float
    after_um: float
    predicted_um: float

    @property
    def ratio(self) -> float:
        """True over predicted error after compensation."""
        return self.after_um / self.predicted_um


def family_of(order: int) -> Family:
    return family_from_amplitudes(ErrorModel.uniform(parse_chain(CHAIN), RANGES, order), AMPLITUDES)


def score(
    machine: DrawnMachine,
    bar: ForeignBar,
    seen: Observations,
    options: Options | None = None,
    artefact: Artefact | None = None,
) -> Score:
    """Identify with the order that the evidence chooses, and compare the result with the truth.

    The program reads the certificate of `bar`, or `artefact` instead.
    """
    estimate = identify_by_evidence(family_of, seen, artefact or bar.artefact, options)
    return Score(
        estimate,
        before_um=true_error_um(machine),
        after_um=true_error_um(machine, estimate),
        predicted_um=predicted_vce(estimate, GRID, TOOL).aligned_um,
    )


class WrittenModel(Protocol):
    """Estimate, computed or read from a file, whose parameters are written as compensation."""

    @property
    def model(self) -> ErrorModel: ...
    @property
    def parameters(self) -> Array: ...


def true_error_um(machine: DrawnMachine, written: WrittenModel | None = None) -> float:
    """Return the true volumetric error in µm over the whole travel, after the best rigid motion is removed: with the
    parameters of the estimate `written` as compensation, or without compensation."""
    left = machine.deviation(GRID)
    if written is not None:
        left = left - exact_deviation(written.model, GRID, TOOL, written.parameters)
    return aligned_rms_um(GRID + TOOL, left)


def turned_about_the_bar(points: np.ndarray, angle_rad: float) -> np.ndarray:
    """Return points (n, 3) rotated about the X axis, which is the axis of the bar."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.asarray(points @ np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]]))


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


def compare_with_truth(machine: DrawnMachine, estimate: Estimate, rng: np.random.Generator) -> ComparisonWithTruth:
    """Compare `estimate` with the truth over the whole travel of the machine."""
    before_um, after_um = true_error_um(machine), true_error_um(machine, estimate)
    forms = field_forms(estimate, GRID, TOOL)
    limits = limits_of_form(estimate, forms[1])
    stated = aligned_distributions(estimate, GRID, TOOL)
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
        vce_rank=stated.vce.at_most((1e-3 * after_um) ** 2),
        field_held=float((levels <= NOMINAL).mean()),
        joint_held=joint <= NOMINAL,
    )
