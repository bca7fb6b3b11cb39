"""Calibration of the artefact by an identification: its ball centres, as the measurements of a machine give them.

The errors of the certified centres are unknowns of every identification with full weights, so that their posterior is a
certificate of the artefact. Its frame is the one of the artefact file: the rigid motion that fits the centres best to
those of the file is removed, from the centres and from their covariance, since no measurement sees it. Its scale
is that of the lengths that were certified before the measurement: an artefact in a free pose shows the differences of
the scales of the axes, not the scale that they have in common.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.artefact.certificate import (
    UNCERTIFIED_MM,
    BallDistance,
    best_known_length,
    has_certificate,
    known_length,
    without_motions,
)
from twin.units import UM_PER_MM

COVERAGE_FACTOR = 2.0
_INFORMATION = 1e-6  # share of the certificate's variance that a measurement must remove to count as a calibration
_IMPROVED = 0.5  # share of the variance of a centre that remains at most if the measurement is better than the file


@dataclass(frozen=True, eq=False)
class ArtefactCalibration:
    """Ball centres (N, 3) in mm at the reference temperature, in the frame of the artefact file, with their covariance
    (3N, 3N) in mm², ordered ball by ball as x, y, z. The covariance has no part along small rigid motions.

    `before` is the length that was known best before the measurement, and `certified` is False if the centres of the
    artefact file were known only roughly. `not_improved` contains the balls whose centres are hardly better known than
    before.
    """

    balls: Array
    covariance: Array
    before: BallDistance
    certified: bool
    not_improved: tuple[int, ...]

    @property
    def expanded_uncertainty_mm(self) -> Array:
        """Expanded uncertainty U (N, 3) in mm of each coordinate, with the coverage factor k = 2."""
        return COVERAGE_FACTOR * np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0)).reshape(-1, 3)

    @property
    def scale(self) -> BallDistance:
        """The length that was known best before the measurement, as known now."""
        return known_length(self.balls, self.covariance, self.before.balls)

    @property
    def limits(self) -> tuple[str, ...]:
        """Sentences on what the measurement cannot show."""
        first, second = self.before.balls
        notes = [
            f"The scale of all coordinates rests on the distance of balls {first} and {second}, which was known to "
            f"{COVERAGE_FACTOR * UM_PER_MM * self.before.standard_uncertainty_mm:.2g} µm "
            f"({COVERAGE_FACTOR * self.before.ppm:.2g} ppm, k = {COVERAGE_FACTOR:g}) before the measurement. An "
            "error of it makes all lengths of artefact and machine wrong in proportion, and nothing measured with this "
            "artefact shows it.",
            "The coordinates refer to the frame of the artefact file, fitted to its centres; position and direction "
            "of the artefact are not part of the calibration.",
            "Machine and artefact were estimated together: do not identify the same ball centres again with this "
            "calibration, which would count them twice.",
        ]
        if self.not_improved:
            numbers = ", ".join(str(ball) for ball in self.not_improved)
            notes.append(f"Hardly better known than before: balls {numbers}.")
        return tuple(notes)

    def calibrated(self, artefact: Artefact, origin: str) -> Artefact:
        """Return `artefact` with these centres and their covariance. `origin` describes the measurement and replaces
        the certificate, which is named behind it."""
        deviation = np.sqrt(np.diagonal(self.covariance).reshape(-1, 3).max(axis=1))
        return replace(
            artefact,
            certificate=f"{origin}; scale: {artefact.certificate}",
            balls=self.balls,
            covariance=self.covariance,
            uncertified=tuple(ball for ball in artefact.uncertified if deviation[ball] > 0.5 * UNCERTIFIED_MM),
        )


def artefact_calibration(balls: Array, factor: Array, errors: Array, covariance: Array) -> ArtefactCalibration | None:
    """Return the calibration of an artefact, or None if the measurement has not changed what is known of it, because
    the certificate has no uncertainty or was taken as exact.

    `balls` (N, 3) in mm are the centres of the artefact file, and `factor` (3N, m) is a matrix L in mm such that L Lᵀ
    is their covariance. The estimate has the errors L u, and `errors` (m,) and `covariance` (m, m) are those of u.
    """
    # A priori u has the unit covariance; if it still has, the measurement has taught nothing about the artefact.
    if not np.abs(np.eye(len(covariance)) - covariance).max(initial=0.0) > _INFORMATION:
        return None
    free, before = without_motions(balls), factor @ factor.T
    # the covariance F L C Lᵀ Fᵀ of the centres F L u, where F removes rigid motions
    after = free @ factor @ covariance @ factor.T @ free
    found, stated = (np.diagonal(one).reshape(-1, 3).sum(axis=1) for one in (after, free @ before @ free))
    return ArtefactCalibration(
        balls=balls + (free @ factor @ errors).reshape(-1, 3),
        covariance=0.5 * (after + after.T),
        before=best_known_length(balls, before),
        certified=has_certificate(balls, before),
        not_improved=tuple(np.flatnonzero(found > _IMPROVED * stated).tolist()),
    )
