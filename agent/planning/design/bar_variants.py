"""Variants of the ball bar that a job uses as artefact.

A variant has a different number of balls, tilt of the ball holders, length or spacing of the balls. All other
properties are those of the bar's calibration certificate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact, ball_bar, bar_balls
from twin.artefact.ball_spacing import BallSpacing, spaced_balls
from twin.errors import DataError

_ALIKE_MM = 1.0  # largest deviation of a calibrated centre from the drawing


@dataclass(frozen=True, eq=False)
class Bar:
    """Ball bar with its properties as described by its calibration certificate.

    `certified` is the artefact with the calibrated ball centres. `length_mm` is the distance between the two end balls
    along the bar. `spacing` is the rule of the places of its balls, or None if they follow none; then `along_mm`
    (balls,) are their calibrated places in mm, otherwise those of the rule. `tilt_deg` is the angle in degrees by which
    the ball holders are tilted. `turn`, shape (3, 3), is the rotation about the bar axis from holders along -Y, as in
    `bar_balls`, to those of this bar.
    """

    certified: Artefact
    length_mm: float
    spacing: BallSpacing | None
    along_mm: Array
    tilt_deg: float
    turn: Array

    @classmethod
    def of(cls, artefact: Artefact) -> Bar:
        """Return `artefact` as a ball bar, with its length, its spacing and its tilt found from its ball centres.

        Raises DataError if the artefact does not consist of balls on alternately tilted holders, which point along -Y,
        +Z, +Y or -Z of the artefact frame, or if the origin is not in the middle of the bar.
        """
        along_mm = artefact.balls[:, 0]
        length_mm = float(np.ptp(along_mm))
        spacing, drawn_mm = _spacing(along_mm, length_mm)
        found = min((_drawn(artefact, drawn_mm, quarter) for quarter in range(4)), key=lambda one: one[0])
        off_drawing, tilt_deg, turn = found
        if off_drawing > _ALIKE_MM:
            raise DataError(
                f"'{artefact.name}' is not a bar of balls on tilted holders with the origin in its middle: its balls "
                f"deviate by up to {off_drawing:.1f} mm from such a bar",
                hint="this study changes the bar's balls and their tilt; use a bar such as config/artefacts/"
                "ball-bar-1500.toml",
            )
        return cls(artefact, length_mm, spacing, drawn_mm, tilt_deg, turn)

    @property
    def standard_uncertainty_mm(self) -> float:
        """Root mean square, in mm, of the standard uncertainties of all ball coordinates in the calibration certificate
        of the bar.
        """
        return float(np.sqrt(np.diagonal(self.certified.covariance).mean()))

    def with_(self, balls: int | None = None, tilt_deg: float | None = None, along_mm: Array | None = None) -> Artefact:
        """Return an uncalibrated bar with nominal ball centres. It has the length of this bar, `balls` balls, and
        holders tilted by `tilt_deg`.

        If an argument is None, the value of the certified bar is used. Another number of balls has the same rule of
        spacing; DataError is raised if there is none. If the places `along_mm` (N,) in mm of the balls
        along the bar are given, they determine its length and its number of balls; its sag and the uncertainty of the
        sag are then those of this beam with another length, in proportion to the fourth power of the length.
        """
        if along_mm is None:
            along_mm = self._along_mm(self.certified.count if balls is None else balls)
        count = len(along_mm)
        tilt = self.tilt_deg if tilt_deg is None else tilt_deg
        artefact = self.certified
        length_mm = float(np.ptp(along_mm))
        stretched = (length_mm / self.length_mm) ** 4
        bar = ball_bar(
            f"{artefact.name}, {count} balls at {tilt:g}°",
            balls=count,
            length_mm=length_mm,
            tilt_rad=math.radians(tilt),
            holder_length_mm=artefact.holder_length_mm,
            ball_diameter_mm=artefact.ball_diameter_mm,
            standard_uncertainty_mm=self.standard_uncertainty_mm,
            reference_temperature_c=artefact.reference_temperature_c,
            cte_per_k=artefact.cte_per_k,
            cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
            sag_mm=stretched * artefact.sag_mm,
            along_mm=along_mm,
        )
        return replace(
            bar,
            balls=bar.balls @ self.turn.T,
            body=artefact.body,
            sag_standard_uncertainty_mm=stretched * artefact.sag_standard_uncertainty_mm,
        )

    def _along_mm(self, balls: int) -> Array:
        """Return the places (balls,) in mm of this number of balls along a bar like this one."""
        if balls == len(self.along_mm):
            return self.along_mm
        if self.spacing is None:
            raise DataError(
                f"the balls of '{self.certified.name}' are spaced by no rule that is known, so a bar like it with "
                f"{balls} balls is not determined",
                hint="use a bar with equal gaps, such as config/artefacts/ball-bar-1500.toml",
            )
        return spaced_balls(balls, self.length_mm, self.spacing)


def _spacing(along_mm: Array, length_mm: float) -> tuple[BallSpacing | None, Array]:
    """Return the rule of the places `along_mm` (balls,) of the balls of a bar, and its places; without a rule, the
    places relative to the middle of the bar, to a tenth of a millimetre."""
    for spacing in BallSpacing:
        drawn = spaced_balls(len(along_mm), length_mm, spacing)
        if np.abs(drawn - along_mm).max() <= _ALIKE_MM:
            return spacing, drawn
    from_first = (along_mm - along_mm[0]).round(1)
    return None, np.asarray(from_first - 0.5 * from_first[-1])


def _drawn(artefact: Artefact, along_mm: Array, quarter: int) -> tuple[float, float, Array]:
    """Compare `artefact` with a drawn bar whose balls are at `along_mm` (balls,) along it and whose holders are turned
    by `quarter` times -90° about the bar axis.

    Return the largest deviation of a ball coordinate in mm, the tilt of the holders in degrees, and the rotation.
    """
    cosine, sine = ((1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0))[quarter]
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    holder_mm = artefact.holder_length_mm
    # the first ball is displaced along +Z of the drawing by the holder length times the sine of the tilt
    off_mm = float(np.abs((artefact.balls @ turn)[0, 2])) if holder_mm > 0.0 else 0.0
    tilt_deg = math.degrees(math.asin(min(off_mm / holder_mm, 1.0))) if holder_mm > 0.0 else 0.0
    drawn = bar_balls(artefact.count, float(np.ptp(along_mm)), math.radians(tilt_deg), holder_mm, along_mm)
    return float(np.abs(drawn @ turn.T - artefact.balls).max()), tilt_deg, turn
