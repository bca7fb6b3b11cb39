"""Variants of the ball bar that a job uses as artefact.

A variant has a different number of balls or a different tilt of the ball holders. All other properties are those of the
bar's calibration certificate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from twin.artefact.artefact import Artefact, ball_bar, bar_balls
from twin.errors import DataError

_ALIKE_MM = 1.0  # largest deviation of a calibrated centre from the drawing


@dataclass(frozen=True, eq=False)
class Bar:
    """Ball bar with its properties as described by its calibration certificate.

    `certified` is the artefact with the calibrated ball centres. `length_mm` is the distance between the two end balls
    along the bar. `tilt_deg` is the angle in degrees by which the ball holders are tilted.
    """

    certified: Artefact
    length_mm: float
    tilt_deg: float

    @classmethod
    def of(cls, artefact: Artefact) -> Bar:
        """Return `artefact` as a ball bar, with the length and the tilt found from its ball centres.

        Raises DataError if the artefact does not consist of equally spaced balls on alternately tilted holders.
        """
        along = artefact.balls[:, 0]
        length_mm = float(np.ptp(along))
        holder_mm = artefact.holder_length_mm
        off_mm = float(np.abs(artefact.balls[0, 2])) if holder_mm > 0.0 else 0.0
        tilt_deg = math.degrees(math.asin(min(off_mm / holder_mm, 1.0))) if holder_mm > 0.0 else 0.0
        drawn = bar_balls(artefact.count, length_mm, math.radians(tilt_deg), holder_mm)
        off_drawing = np.abs(drawn - artefact.balls).max()
        if off_drawing > _ALIKE_MM:
            raise DataError(
                f"'{artefact.name}' is not a bar of equally spaced balls on tilted holders: its balls deviate "
                f"by up to {off_drawing:.1f} mm from such a bar",
                hint="this study changes the bar's balls and their tilt; use a bar such as config/artefacts/"
                "ball-bar-1500.toml",
            )
        return cls(artefact, length_mm, tilt_deg)

    @property
    def standard_uncertainty_mm(self) -> float:
        """Root mean square, in mm, of the standard uncertainties of all ball coordinates in the calibration certificate
        of the bar.
        """
        return float(np.sqrt(np.diagonal(self.certified.covariance).mean()))

    def with_(self, balls: int | None = None, tilt_deg: float | None = None) -> Artefact:
        """Return an uncalibrated bar with nominal ball centres. It has the length of this bar, `balls` balls, and
        holders tilted by `tilt_deg`.

        If an argument is None, the value of the certified bar is used.
        """
        count = self.certified.count if balls is None else balls
        tilt = self.tilt_deg if tilt_deg is None else tilt_deg
        artefact = self.certified
        bar = ball_bar(
            f"{artefact.name}, {count} balls at {tilt:g}°",
            balls=count,
            length_mm=self.length_mm,
            tilt_rad=math.radians(tilt),
            holder_length_mm=artefact.holder_length_mm,
            ball_diameter_mm=artefact.ball_diameter_mm,
            standard_uncertainty_mm=self.standard_uncertainty_mm,
            reference_temperature_c=artefact.reference_temperature_c,
            cte_per_k=artefact.cte_per_k,
            cte_standard_uncertainty_per_k=artefact.cte_standard_uncertainty_per_k,
            sag_mm=artefact.sag_mm,
        )
        return replace(bar, body=artefact.body, sag_standard_uncertainty_mm=artefact.sag_standard_uncertainty_mm)
