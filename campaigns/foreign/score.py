"""Identification of a foreign machine, compared with the truth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from campaigns.foreign.artefact import ForeignBar
from campaigns.foreign.machine import CHAIN, GRID, RANGES, TOOL, ForeignMachine, aligned_rms_um
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.identification import Estimate, Options, identify_by_evidence, predicted_vce
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import Family, family_from_amplitudes

AMPLITUDES: dict[str, float | list[float]] = {
    "positioning_um": [8.0, 5.0, 3.0, 1.8, 1.1],
    "straightness_um": [5.5, 3.3, 2.0, 1.2],
    "rotation_urad": [4.6, 2.8, 1.7, 1.0, 0.6],
    "squareness_urad": 9.0,
    "cross_displacement_um": 4.5,
    "cross_rotation_urad": 3.0,
}


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
    machine: ForeignMachine,
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


def true_error_um(machine: ForeignMachine, written: WrittenModel | None = None) -> float:
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
