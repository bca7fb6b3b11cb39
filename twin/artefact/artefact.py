"""Ball artefact with its calibrated ball centres, and the effect of temperature and gravity on the centres.

The artefact has any shape: a bar, a plate, a tetrahedron. It consists of balls and of the solid parts that carry them.
The mount is fixed at the origin of the artefact frame. If azimuth and elevation of the mount are 0, the axes of this
frame are parallel to those of the workpiece frame, with Z upwards. On a bar, the origin is on the axis of the bar, at
its middle, and the X axis points along the bar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from twin.arrays import Array, as_points
from twin.artefact.artefact_body import ArtefactBody, Rod, vector
from twin.display import Displayed
from twin.errors import DataError
from twin.immutable import Immutable
from twin.units import REFERENCE_TEMPERATURE_C

STEEL_CTE_PER_K = 11.5e-6
_SMALLEST_SAG_MM = 0.002  # a short bar bends by its clamping rather than by its weight


@dataclass(frozen=True, eq=False)
class Artefact(Displayed, Immutable):
    """Calibrated ball artefact with N balls.

    - `balls` (N, 3) contains the ball centres in mm at the reference temperature, without gravity sag.
    - `covariance` (3N, 3N) is the covariance of the centres in mm², ordered ball by ball as x, y, z.
    - `sag_mm` is the distance by which the ends of a horizontal bar hang below its middle, with its standard
      uncertainty `sag_standard_uncertainty_mm` (0: exact).
    - `members` gives for each ball the number of its artefact if several artefacts are combined in one estimate. It is
      empty for a single artefact.
    - `uncertified` contains the numbers of the balls whose centres are nominal values without a certificate. Their
      covariance is large, and paths to them use the nominal centres.
    - `body` describes the solid parts besides the balls, which the probe must not hit.
    """

    name: str
    certificate: str
    balls: Array = field(repr=False)
    ball_diameter_mm: float
    reference_temperature_c: float
    cte_per_k: float
    cte_standard_uncertainty_per_k: float
    covariance: Array = field(repr=False)
    holder_length_mm: float = 0.0
    sag_mm: float = 0.0
    members: tuple[int, ...] = ()
    uncertified: tuple[int, ...] = ()
    sag_standard_uncertainty_mm: float = 0.0
    body: ArtefactBody = field(default_factory=ArtefactBody)

    def __repr__(self) -> str:
        return f"<Artefact: {self.name!r}, {self.count} balls of {self.ball_diameter_mm:g} mm>"

    def __post_init__(self) -> None:
        balls = as_points(self.balls, "balls of the artefact")
        if len(balls) < 2:
            raise DataError("an artefact needs at least two balls", artefact=self.name)
        if not self.ball_diameter_mm > 0.0:
            raise DataError(f"ball diameter must be positive, got {self.ball_diameter_mm}", artefact=self.name)
        members = np.array(self.members or (0,) * len(balls))
        if len(members) != len(balls):
            raise DataError(f"{len(members)} members for {len(balls)} balls", artefact=self.name)
        for member in np.unique(members):
            _refuse_overlap(balls[members == member], self.ball_diameter_mm, self.name)
        _refuse_bad_covariance(self.covariance, 3 * len(balls), self.name)
        feet = self.body.feet_mm
        if feet is not None and len(feet) != len(balls):
            raise DataError(f"{len(feet)} feet of holders for {len(balls)} balls", artefact=self.name)

    @property
    def count(self) -> int:
        return len(self.balls)

    @property
    def ball_radius_mm(self) -> float:
        return 0.5 * self.ball_diameter_mm

    @property
    def half_length_mm(self) -> float:
        """Largest distance in mm of a ball from the origin of the artefact frame, measured along X (along the bar, if
        the artefact is a bar).
        """
        return float(np.abs(self.balls[:, 0]).max())

    @property
    def rods(self) -> tuple[Rod, ...]:
        """Solid parts besides the balls, in the artefact frame: holders, the beam of a bar, and further parts."""
        feet = self.body.feet(self.balls)
        holders = (
            Rod(f"post {number}", vector(foot), vector(ball), self.body.holder_radius_mm)
            for number, (foot, ball) in enumerate(zip(feet, self.balls, strict=True))
        )
        return (*holders, *self.body.carriers(self.balls))

    @property
    def half_span_mm(self) -> float:
        """Largest distance in mm of a ball centre or of the axis of a solid part from the origin of the artefact frame,
        measured along X.
        """
        ends = [abs(end[0]) for rod in self.rods for end in (rod.start_mm, rod.end_mm)]
        return max(self.half_length_mm, *ends)

    @property
    def reach_mm(self) -> float:
        """Largest distance in mm of any point of the artefact from the origin of the artefact frame."""
        balls = float(np.linalg.norm(self.balls, axis=1).max()) + self.ball_radius_mm
        rods = [math.hypot(*end) + rod.radius_mm for rod in self.rods for end in (rod.start_mm, rod.end_mm)]
        return max(balls, *rods)

    @property
    def is_single_bar(self) -> bool:
        """True for one bar that is held in its middle, so that its ends hang down."""
        return self.body.beam is not None and not self.members

    @property
    def expected_sag_mm(self) -> float:
        """Size in mm of the sag that a bar may have if nothing states it: that of its beam under its own weight, but at
        least 2 µm. It is 0 without a beam."""
        beam = self.body.beam
        return 0.0 if beam is None else max(beam.own_sag_mm(self.half_length_mm), _SMALLEST_SAG_MM)

    @property
    def droop_mm(self) -> Array:
        """Distance (N,) in mm by which each ball hangs below the middle if the bar is horizontal."""
        return np.asarray(self.sag_mm * self.droop_shape)

    @property
    def droop_shape(self) -> Array:
        """Distance (N,) by which each ball of a horizontal bar hangs below the middle, relative to that of its ends."""
        # the bar hangs as two cantilevers clamped at the mount, so the distance from the middle counts on either side
        along = np.abs(self.balls[:, 0]) / max(self.half_length_mm, 1e-9)
        return np.asarray(_droop(along))

    def at(self, temperature_c: float, elevation_rad: float) -> Array:
        """Return the ball centres (N, 3) in mm in the artefact frame at a given temperature and elevation of the mount.
        Thermal expansion and gravity sag are included.
        """
        stretched = self.without_sag(temperature_c)
        if self.sag_mm:
            # gravity acts across the bar with cos(elevation)
            stretched[:, 2] -= math.cos(elevation_rad) * self.droop_mm
        return stretched

    def without_sag(self, temperature_c: float) -> Array:
        """Return the ball centres (N, 3) in mm in the artefact frame at a given temperature, without gravity."""
        # thermal expansion p (1 + α ΔT)
        return np.asarray(self.balls * (1.0 + self.cte_per_k * (temperature_c - self.reference_temperature_c)))


def ball_bar(
    name: str,
    *,
    balls: int,
    length_mm: float,
    tilt_rad: float,
    holder_length_mm: float,
    ball_diameter_mm: float,
    standard_uncertainty_mm: float = 0.0,
    certificate: str = "nominal",
    reference_temperature_c: float = REFERENCE_TEMPERATURE_C,
    cte_per_k: float = STEEL_CTE_PER_K,
    cte_standard_uncertainty_per_k: float = 0.0,
    sag_mm: float = 0.0,
    along_mm: Array | None = None,
) -> Artefact:
    """Return a bar of equally spaced balls. `length_mm` is the distance between the end balls along the bar. It does
    not depend on the number of balls. If the places `along_mm` (balls,) of the balls are given, they replace the equal
    spacing.
    """
    return Artefact(
        name=name,
        certificate=certificate,
        balls=bar_balls(balls, length_mm, tilt_rad, holder_length_mm, along_mm),
        ball_diameter_mm=ball_diameter_mm,
        reference_temperature_c=reference_temperature_c,
        cte_per_k=cte_per_k,
        cte_standard_uncertainty_per_k=cte_standard_uncertainty_per_k,
        covariance=np.eye(3 * balls) * standard_uncertainty_mm**2,
        holder_length_mm=holder_length_mm,
        sag_mm=sag_mm,
    )


def bar_balls(
    balls: int, length_mm: float, tilt_rad: float, holder_length_mm: float, along_mm: Array | None = None
) -> Array:
    """Return the ball centres of a bar as an array (balls, 3) in mm, equally spaced along X or, if they are given, at
    the places `along_mm` (balls,) in mm along X.

    If the holders (posts) of the balls are not tilted, each ball is one holder length from the bar axis, in the
    direction -Y. If the holders are tilted by an angle θ, each ball is displaced from this location by the holder
    length times sin θ. The direction of the displacement repeats every four balls: up (+Z), out (-Y), down (-Z) and in
    (+Y).
    """
    if balls < 2:
        raise DataError(f"a ball bar needs at least two balls, got {balls}")
    centres = np.zeros((balls, 3))
    centres[:, 0] = np.linspace(-0.5 * length_mm, 0.5 * length_mm, balls) if along_mm is None else along_mm
    centres[:, 1] = -holder_length_mm
    offset = holder_length_mm * math.sin(tilt_rad)
    centres[0::4, 2] += offset
    centres[1::4, 1] -= offset
    centres[2::4, 2] -= offset
    centres[3::4, 1] += offset
    return centres


def _droop(along: Array) -> Array:
    """Return the deflection of a uniformly loaded cantilever, scaled to 1 at its end.

    `along`: distance from the middle support (0) to the end (1).
    """
    # w x² (6 L² - 4 L x + x²) / 24 EI, divided by its value w L⁴ / 8 EI at x = L
    return along**2 * (6.0 - 4.0 * along + along**2) / 3.0


def _refuse_overlap(balls: Array, diameter_mm: float, name: str) -> None:
    distance = np.linalg.norm(balls[:, None] - balls[None], axis=2)
    np.fill_diagonal(distance, np.inf)
    if distance.min() < diameter_mm:
        first, second = (int(index) for index in np.unravel_index(np.argmin(distance), distance.shape))
        raise DataError(
            f"balls {first} and {second} are {distance.min():.3f} mm apart, less than their diameter",
            hint="Centres are in mm; check whether one is listed twice",
            artefact=name,
        )


def _refuse_bad_covariance(covariance: Array, size: int, name: str) -> None:
    if covariance.shape != (size, size) or not np.isfinite(covariance).all():
        raise DataError(
            f"covariance of the ball centres has shape {covariance.shape}, expected finite ({size}, {size})",
            artefact=name,
        )
    scale = max(float(np.abs(covariance).max()), 1e-300)
    if not np.allclose(covariance, covariance.T, rtol=0.0, atol=1e-9 * scale):
        raise DataError("covariance of the ball centres is not symmetric", artefact=name)
    if np.linalg.eigvalsh(covariance)[0] < -1e-9 * scale:
        raise DataError("covariance of the ball centres is not positive semi-definite", artefact=name)
