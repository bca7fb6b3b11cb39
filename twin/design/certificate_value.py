"""Value of the artefact's certificate: the expected error after compensation with it, with a single certified length,
and with nothing certified.

The identification solves for the ball centres together with the errors of the machine, so that a rough knowledge of the
centres costs little. The scale that artefact and machine have in common comes from certified lengths alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import (
    TRACEABLE_PPM,
    BallDistance,
    best_known_length,
    farthest_pairs,
    has_certificate,
    known_length,
    with_reference_length,
)
from twin.design.measurement_setup import SetUp
from twin.identification import identify, predicted_vce
from twin.machine.volumetric import VolumetricRms

ROUGH_MM = 0.05
"""Standard uncertainty in mm per coordinate of balls without a certificate, from a drawing or a simple measurement."""

USUAL_MM = 0.001
"""Standard uncertainty in mm of a certificate, per coordinate or of a length, if the artefact file gives none."""

Knowledge = Literal["certificate", "one length", "nothing"]


@dataclass(frozen=True)
class CertificateValue:
    """Expected volumetric errors after compensation for three states of knowledge of the artefact, for the first tool.

    `present` is the state of the artefact file. `certificate` holds with the centres certified to
    `certificate_mm` (rms per coordinate), `one_length` with the length `length` and centres known to `ROUGH_MM`, and
    `nothing` with the latter alone.
    """

    present: Knowledge
    certificate_mm: float
    certificate: VolumetricRms
    length: BallDistance
    one_length: VolumetricRms
    nothing: VolumetricRms

    def cost_percent(self, without: VolumetricRms) -> float:
        """Return the increase in percent of the error `without` against that with a certificate."""
        return 100.0 * (without.aligned_mm / self.certificate.aligned_mm - 1.0)


def certificate_value(set_up: SetUp, grid: Array) -> CertificateValue:
    """Return the value of the certificate for a planned measurement. The errors are evaluated over axis positions
    `grid` (n, 3) in mm. Raise DataError or SingularSet as `SetUp.estimate`."""
    artefact, observations = set_up.procedure.artefact, set_up.plan().observations
    present, length = _present(artefact)
    rough = np.eye(artefact.balls.size) * ROUGH_MM**2
    known = has_certificate(artefact.balls, artefact.covariance)
    certified = artefact.covariance
    if not known:
        # the certified length, if there is one, would not be forgotten
        certified = np.eye(artefact.balls.size) * USUAL_MM**2
        certified = _with_lengths(artefact, certified, length) if present == "one length" else certified

    def after(covariance: Array) -> VolumetricRms:
        other = replace(artefact, covariance=covariance, uncertified=())
        estimate = identify(set_up.model, observations, other, set_up.family, set_up.options)
        return predicted_vce(estimate, grid, set_up.procedure.layout().tool_offset_mm)

    return CertificateValue(
        present=present,
        certificate_mm=float(np.sqrt(np.diagonal(certified).mean())) if known else USUAL_MM,
        certificate=after(certified),
        length=length,
        one_length=after(_with_lengths(artefact, rough, length)),
        nothing=after(rough),
    )


def _present(artefact: Artefact) -> tuple[Knowledge, BallDistance]:
    """Return what the artefact file knows, and the length that a single certified length would be."""
    ends = known_length(artefact.balls, artefact.covariance, farthest_pairs(artefact.balls)[0])
    if has_certificate(artefact.balls, artefact.covariance):
        return "certificate", replace(ends, standard_uncertainty_mm=ends.standard_uncertainty_mm or USUAL_MM)
    best = best_known_length(artefact.balls, artefact.covariance)
    if best.ppm <= TRACEABLE_PPM:
        return "one length", best
    return "nothing", replace(ends, standard_uncertainty_mm=USUAL_MM)


def _with_lengths(artefact: Artefact, covariance: Array, length: BallDistance) -> Array:
    """Return the covariance (3N, 3N) after an update by `length`. Of several artefacts combined in one, each has a
    length of its own with the same uncertainty."""
    if not artefact.members:
        return with_reference_length(artefact.balls, covariance, length)[1]
    members = np.array(artefact.members)
    for member in np.unique(members):
        balls = np.flatnonzero(members == member)
        first, second = farthest_pairs(artefact.balls[balls])[0]
        pair = (int(balls[first]), int(balls[second]))
        own = replace(length, balls=pair, length_mm=known_length(artefact.balls, covariance, pair).length_mm)
        covariance = with_reference_length(artefact.balls, covariance, own)[1]
    return covariance
