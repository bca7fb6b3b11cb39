"""Artefact for a machine: stated by a person, or proposed from the travel of the machine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.planning.new_machine.machine_setup import Triple
from twin.errors import DataError

SHAPES = ("tilted-bar", "straight-bar", "ball-plate", "tetrahedron")
TILTED_BAR, STRAIGHT_BAR, BALL_PLATE, TETRAHEDRON = SHAPES
ON_MOUNT, BY_HAND = "mount", "by-hand"
"""Ways in which an artefact is held in a position."""
CERTIFICATE, LENGTH, NONE = "certificate", "length", "none"

SIZES_MM = {
    TILTED_BAR: (60, 80, 100, 120, 150, 175, 200, 250, 300, 350, 400, 500, 600, 800, 1000, 1200, 1500),
    STRAIGHT_BAR: (60, 80, 100, 120, 150, 175, 200, 250, 300, 350, 400, 500, 600, 800, 1000, 1200, 1500),
    BALL_PLATE: (100, 150, 200, 250, 300, 350, 420, 500, 600),
    TETRAHEDRON: (150, 200, 250, 300, 400, 500, 600),
}
"""Proposed sizes of each shape: length between the end balls, side between the corner balls, edge. The largest one can
still be carried; the smallest bar has room for three balls."""
LEAST_FIRST_MM = 120
"""Least size of a bar that is proposed first. A smaller one tells little, so it is proposed only if this does not
fit."""
FLAT_SHARE = 0.5
"""Size of the artefact relative to the medium travel, for a machine whose shortest travel allows only flat
elevations."""
DIAGONAL = math.sqrt(2.0)
TOUCHED_MM = 60.0
"""Part of a travel that is needed to touch the balls at the ends of the artefact from both sides, in mm."""
BETWEEN_BALLS_MM = 3.0
"""Least pitch of the balls beyond twice their diameter: the tip begins its touch of a ball in front of its surface, and
must be clear of the next ball there."""
TILTED_FROM_MM = 300.0
TILT_DEG = 15.0
PLATE_THICKNESS_MM = 20.0
CERTIFIED_UM = 0.8
"""Standard uncertainty of a coordinate in the certificate of a calibrated artefact."""
UNCERTIFIED_UM = 50.0
"""Standard uncertainty of a coordinate of an artefact without a certificate, which was built or measured roughly."""
TETRAHEDRON_BALLS = (4, 10)
"""Balls of a tetrahedron: at its corners, or also at the middles of its edges."""
LEAST_PLATE_BALLS = 9


@dataclass(frozen=True)
class Calibration:
    """Knowledge of the ball centres: a certificate, one certified length (the distance `length_mm` of two balls
    with the standard uncertainty `length_uncertainty_um`), or nothing."""

    kind: str = CERTIFICATE
    length_mm: float | None = None
    length_uncertainty_um: float = 1.0

    @property
    def standard_uncertainty_um(self) -> float:
        """Standard uncertainty of each coordinate of a ball centre in the artefact file."""
        return CERTIFIED_UM if self.kind == CERTIFICATE else UNCERTIFIED_UM


@dataclass(frozen=True)
class ArtefactSetup:
    """Ball artefact of one of the `SHAPES`, with equally spaced balls on holders.

    `size_mm` is the distance of the end balls of a bar, the side of a square ball plate between its corner balls, or
    the edge of a tetrahedron. The holders have the length `holder_mm` from the part that carries them to the centre of
    a ball. Those of a tilted bar are tilted by `tilt_deg` alternately up, out, down and in. The shape is empty if the
    artefact was read from a file.
    """

    shape: str
    size_mm: float
    balls: int
    tilt_deg: float
    holder_mm: float
    diameter_mm: float
    calibration: Calibration = Calibration()
    origins: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_bar(self) -> bool:
        return self.shape not in (BALL_PLATE, TETRAHEDRON)

    @property
    def height_mm(self) -> float:
        """Distance in mm of the fourth corner of a tetrahedron from the face that is fixed to the mount."""
        return math.sqrt(2.0 / 3.0) * self.size_mm if self.shape == TETRAHEDRON else 0.0

    @property
    def depth_mm(self) -> float:
        """Distance in mm from the end of the shaft to the middle of the balls, along the holders."""
        thickness = PLATE_THICKNESS_MM if self.shape == BALL_PLATE else 0.0
        return thickness + 0.25 * self.height_mm + self.holder_mm


def propose_shape(travel_mm: Triple) -> str:
    """Return the proposed shape: a tilted bar, or a straight one if it is so short that the stylus would touch a tilted
    neighbour of the ball while the bar is inclined."""
    return TILTED_BAR if propose_size(TILTED_BAR, travel_mm) >= TILTED_FROM_MM else STRAIGHT_BAR


def propose_size(shape: str, travel_mm: Triple) -> float:
    """Return the size in mm of an artefact that fits the travels of a machine, in mm.

    At an elevation of 45° the artefact must fit into the shortest travel and, along an axis, into the medium one. On a
    flat machine this would be too short for the long axes; there the artefact is half the medium travel, and it is
    measured at smaller elevations. A plate or tetrahedron extends in all directions, so it is smaller than a bar.
    """
    shortest, medium, _ = sorted(travel_mm)
    if shape in (BALL_PLATE, TETRAHEDRON):
        wanted = min(medium / DIAGONAL, max(shortest - TOUCHED_MM, FLAT_SHARE * medium))
    else:
        wanted = min(medium, max(DIAGONAL * (shortest - TOUCHED_MM), FLAT_SHARE * medium))
    least = min(LEAST_FIRST_MM, medium) if shape in (TILTED_BAR, STRAIGHT_BAR) else 0.0
    sizes = [size for size in SIZES_MM[shape] if size >= least] or SIZES_MM[shape]
    return float(max((size for size in sizes if size <= wanted), default=sizes[0]))


def smaller_size(artefact: ArtefactSetup) -> float | None:
    """Return the next smaller proposed size of the same shape in mm, or None if there is none."""
    smaller = [size for size in SIZES_MM[artefact.shape] if size < artefact.size_mm]
    return float(max(smaller)) if smaller else None


def smaller_artefacts(shape: str, size_mm: float) -> tuple[ArtefactSetup, ...]:
    """Return the proposed artefacts of a shape that are not larger than `size_mm`, the largest first, and then those of
    a straight bar, which needs the least room."""
    shapes = dict.fromkeys((shape or STRAIGHT_BAR, STRAIGHT_BAR))
    return tuple(nominal_artefact(one, size) for one in shapes for size in reversed(SIZES_MM[one]) if size <= size_mm)


def nominal_artefact(shape: str, size_mm: float) -> ArtefactSetup:
    """Return an artefact of the given shape and size with the proposed balls and holders."""
    diameter = diameter_of(size_mm)
    return ArtefactSetup(
        shape=shape,
        size_mm=float(size_mm),
        balls=balls_of(shape, size_mm, diameter),
        tilt_deg=tilt_of(shape),
        holder_mm=holder_of(shape, size_mm),
        diameter_mm=diameter,
    )


def balls_of(shape: str, size_mm: float, diameter_mm: float) -> int:
    """Return the proposed number of balls. There are so few that the stylus can touch each ball between its neighbours;
    on a bar it is an odd number, so that one is in the middle."""
    if shape == TETRAHEDRON:
        return TETRAHEDRON_BALLS[1]
    pitches = math.floor(size_mm / (2.0 * diameter_mm + BETWEEN_BALLS_MM))
    if shape == BALL_PLATE:
        wanted = 5 if size_mm >= 500.0 else 4 if size_mm >= 300.0 else 3
        return int(max(3, min(wanted, pitches + 1)) ** 2)
    wanted = 11 if size_mm >= 800.0 else 9 if size_mm >= TILTED_FROM_MM else 7
    return max(3, min(wanted, 2 * (pitches // 2) + 1))


def check_balls(shape: str, balls: int) -> int:
    """Return the number of balls. Raises DataError if an artefact of this shape cannot have it."""
    if shape == BALL_PLATE and (balls < LEAST_PLATE_BALLS or math.isqrt(balls) ** 2 != balls):
        raise DataError(f"a ball plate has no {balls} balls", hint="state a square number: 9, 16, 25, 36, 49, 64 or 81")
    if shape == TETRAHEDRON and balls not in TETRAHEDRON_BALLS:
        raise DataError(
            f"a tetrahedron has no {balls} balls", hint="state 4 (corners) or 10 (and the middles of the edges)"
        )
    if not 2 <= balls <= 99:
        raise DataError(f"{balls} is not a number of balls", hint="state 2 to 99")
    return balls


def check_tilt(shape: str, tilt_deg: float) -> float:
    """Return the tilt of the holders. Raises DataError if the holders of this shape have no tilt."""
    if shape != TILTED_BAR and tilt_deg != 0.0:
        raise DataError(
            f"the holders of a {shape} are not tilted, got {tilt_deg:g}°", hint="state --shape tilted-bar, or tilt 0"
        )
    return tilt_deg


def tilt_of(shape: str) -> float:
    """Return the proposed tilt of the holders in degrees."""
    return TILT_DEG if shape == TILTED_BAR else 0.0


def holder_of(shape: str, size_mm: float) -> float:
    """Return the proposed length of the holders in mm. Those of a plate or tetrahedron are longer than those of a bar:
    the part that carries them is beside the ball, too."""
    if shape in (BALL_PLATE, TETRAHEDRON):
        return 60.0 if size_mm >= TILTED_FROM_MM else 40.0
    return 60.0 if size_mm >= 800.0 else 40.0 if size_mm >= TILTED_FROM_MM else 30.0


def diameter_of(size_mm: float) -> float:
    """Return the proposed ball diameter in mm for an artefact of the given size."""
    return 25.0 if size_mm >= 800.0 else 20.0 if size_mm >= TILTED_FROM_MM else 12.0
