"""Readings of each kind of instrument: which direction it observes, and which unknowns and errors its set-up has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points, as_vector
from twin.errors import DataError
from twin.identification.instruments.readings import InstrumentKind, InstrumentReadings
from twin.units import MM_PER_UM

_OFF_LINE_MM = 1.0  # farther off, a target does not belong to the line
_ALONG = 1e-2  # cosine between two directions that count as perpendicular
_PER_CENT = 1e-2
_PPM = 1e-6
_MM_PER_M = 1e3


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings (m,) in mm or rad with their standard uncertainties `noise` (m,) and their numbers in the file `name`.
    `tool_offset` (3,) in mm is where the reflector, the ball or the level is. `device` names the instrument if other
    readings were taken with the same one."""

    name: str
    values: Array
    noise: Array
    tool_offset: Array
    lines: tuple[int, ...] = ()
    device: str | None = None

    def of_kind(
        self,
        kind: InstrumentKind,
        points: Array,
        *,
        along: Array | None = None,
        about: Array | None = None,
        free: list[Array],
        of_device: list[Array],
        of_set_up: list[Array] | None = None,
    ) -> InstrumentReadings:
        """Return the readings of an instrument of this `kind`. `of_device` are the correlated errors of the instrument
        itself, and `of_set_up` those of one set-up."""
        nothing, size = np.zeros((len(self.values), 3)), len(self.values)
        return InstrumentReadings(
            name=self.name,
            kind=kind,
            points=points,
            tool_offset=as_vector(self.tool_offset, 3, "tool offset"),
            along=nothing if along is None else along,
            about=nothing if about is None else about,
            readings=self.values,
            noise=self.noise,
            free=np.array(free).reshape(-1, size).T,
            correlated=np.array(of_device + (of_set_up or [])).reshape(-1, size).T,
            lines=self.lines,
            device=self.device,
            shared=len(of_device),
        )


@dataclass(frozen=True)
class LaserSetUp:
    """Standard uncertainties of a laser interferometer that all readings of a line share.

    `scale_um_per_m` is that of its scale: wavelength, sensors of the air, and angle between beam and motion. `drift_um`
    is the drift of its zero from the first to the last reading, for example by the air in the dead path.
    """

    scale_um_per_m: float = 0.5
    drift_um: float = 0.0


@dataclass(frozen=True)
class StraightnessSetUp:
    """Standard uncertainties of straightness optics: of their scale, and of their bow, a parabola that rises over a
    line of 1 m by this much and over others with the square of the length."""

    scale_percent: float = 0.5
    bow_um_per_m2: float = 0.1


@dataclass(frozen=True)
class BallbarSetUp:
    """Standard uncertainties of a ballbar: of its calibrated length, of the scale of its sensor, and of the form of its
    balls in their seats: three lobes, which add this standard uncertainty to each reading."""

    length_um: float = 0.5
    scale_percent: float = 0.15
    form_um: float = 0.1


def laser_line(seen: Readings, points: ArrayLike, set_up: LaserSetUp) -> InstrumentReadings:
    """Return the readings of a laser along a line, an axis or a diagonal: actual minus nominal distance, rising in the
    direction from the first target. `points` (m, 3) are the axis positions of the targets in mm."""
    at, direction, distance = _line(points, seen)
    turn = np.linspace(0.0, 1.0, len(distance))
    return seen.of_kind(
        "laser",
        at,
        along=np.tile(direction, (len(at), 1)),
        free=[np.ones(len(at))],
        of_device=[_PPM * set_up.scale_um_per_m * distance],
        of_set_up=[MM_PER_UM * set_up.drift_um * turn],
    )


def straightness_line(
    seen: Readings, points: ArrayLike, across: ArrayLike, set_up: StraightnessSetUp
) -> InstrumentReadings:
    """Return the displacements that straightness optics show along a line, in the direction `across` (3,)."""
    at, direction, distance = _line(points, seen)
    normal = as_vector(across, 3, "direction across the line")
    if abs(float(normal @ direction)) > _ALONG:
        raise DataError("a straightness is measured across its line, not along it", hint="choose another axis 'across'")
    middle, length = 0.5 * float(distance.max()), max(float(distance.max()), 1e-9)
    share = (distance - middle) / length
    bow = 4.0 * share**2 * (length / _MM_PER_M) ** 2
    return seen.of_kind(
        "straightness",
        at,
        along=np.tile(normal, (len(at), 1)),
        free=[np.ones(len(at)), share],
        of_device=[_PER_CENT * set_up.scale_percent * seen.values],
        of_set_up=[MM_PER_UM * set_up.bow_um_per_m2 * bow],
    )


def ballbar_circle(
    seen: Readings,
    centre_mm: ArrayLike,
    radius_mm: float,
    axes: tuple[int, int],
    angles_rad: Array,
    set_up: BallbarSetUp,
) -> InstrumentReadings:
    """Return the radial deviations of a circle, outwards positive, at angles (m,) from the first axis towards the
    second one. `centre_mm` (3,) is an axis position."""
    outwards = np.zeros((len(angles_rad), 3))
    outwards[:, axes[0]], outwards[:, axes[1]] = np.cos(angles_rad), np.sin(angles_rad)
    form = MM_PER_UM * set_up.form_um
    return seen.of_kind(
        "ballbar",
        as_vector(centre_mm, 3, "centre of the circle") + radius_mm * outwards,
        along=outwards,
        free=[np.cos(angles_rad), np.sin(angles_rad)],
        of_device=[
            np.full(len(angles_rad), MM_PER_UM * set_up.length_um),
            _PER_CENT * set_up.scale_percent * seen.values,
        ],
        of_set_up=[form * np.cos(3.0 * angles_rad), form * np.sin(3.0 * angles_rad)],
    )


def level_readings(seen: Readings, points: ArrayLike, about: ArrayLike, scale_percent: float) -> InstrumentReadings:
    """Return the angles that a level or an autocollimator shows between tool and workpiece, by the right-hand rule
    about the direction `about` (3,). Their zero is free."""
    at = as_points(points, "axis positions")
    return seen.of_kind(
        "level",
        at,
        about=np.tile(as_vector(about, 3, "axis of the angle"), (len(at), 1)),
        free=[np.ones(len(at))],
        of_device=[_PER_CENT * scale_percent * seen.values],
    )


def stated_values(
    name: str, parameters: tuple[str, ...], units: tuple[str, ...], values: Array, noise: Array, lines: tuple[int, ...]
) -> InstrumentReadings:
    """Return values of parameters of the error model that an earlier report states, each with its own uncertainty."""
    nothing = np.zeros((len(values), 3))
    return InstrumentReadings(
        name, "values", nothing, np.zeros(3), nothing, nothing, values, noise,
        np.zeros((len(values), 0)), np.zeros((len(values), 0)), parameters, units, lines,
    )  # fmt: skip


def _line(points: ArrayLike, seen: Readings) -> tuple[Array, Array, Array]:
    """Return the targets (m, 3), the direction (3,) of the line from the first target to the farthest one, and the
    distances (m,) from the first target in mm."""
    at = as_points(points, "axis positions")
    apart = at - at[0]
    length = np.linalg.norm(apart, axis=1)
    if float(length.max()) < _OFF_LINE_MM:
        raise DataError("all targets are at the same place", hint="give the axis position of each target")
    direction = apart[int(length.argmax())] / length.max()
    distance = apart @ direction
    off = np.linalg.norm(apart - np.multiply.outer(distance, direction), axis=1)
    if float(off.max()) > _OFF_LINE_MM:
        worst = int(off.argmax())
        message = f"this target is {off[worst]:.1f} mm off the line from the first target to the farthest one"
        line = seen.lines[worst] if seen.lines else worst + 1
        raise DataError(message, hint="give each line as a file of its own", row=line)
    # The sign of a reading belongs to a direction: it must not depend on which end is farther from the first target.
    if float(distance.min()) < -_OFF_LINE_MM:
        worst = int(distance.argmin())
        message = f"this target lies on the other side of the first target, {-distance[worst]:.1f} mm behind it"
        hint = "begin with a target at an end of the line; readings grow from there"
        raise DataError(message, hint=hint, row=seen.lines[worst] if seen.lines else worst + 1)
    return at, direction, distance
