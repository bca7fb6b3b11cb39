"""Virtual straightness interferometer with an optical square, which measures straightness and squareness (ISO 230-1).

It measures the displacement of the tip across a line against the axis of its optics. The optics are not parallel to the
line (removed by the evaluation), not perfectly flat, and scale what they show. For a squareness, the second line is
measured against the same optics, turned by an optical square whose angle is not exactly 90°.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from simulators.instruments.machine_under_test import MachineUnderTest
from simulators.instruments.stated_uncertainty import draws_of, factors, range_of, scatter, standard_uncertainty
from simulators.instruments.target_line import TargetLine, by_target, scatter_of_mean
from simulators.world.noise import generator
from twin.arrays import Array


@dataclass(frozen=True)
class StraightnessClass:
    """Quality of straightness optics and of an optical square, as standard uncertainties.

    The optics show `scale_percent` too much or too little, and have a bow of `bow_um_per_m2` times the square of the
    length of the line in m. They are parallel to the line within `alignment_urad`. A reading scatters by `reading_um`,
    and by `turbulence_um_per_m` times the distance. The square is right within `square_urad`.
    """

    scale_percent: float = 0.5
    bow_um_per_m2: float = 0.075
    alignment_urad: float = 50.0
    reading_um: float = 0.1
    turbulence_um_per_m: float = 0.15
    square_urad: float = 1.5


@dataclass(frozen=True, eq=False)
class StraightnessMeasurement:
    """Straightness of a line in one direction. `deviations` (n,) in mm are those from the least-squares line, `span` is
    their range and `span_u` its standard uncertainty, in mm."""

    along_mm: Array
    deviations: Array
    span: float
    span_u: float
    duration_s: float


@dataclass(frozen=True)
class SquarenessMeasurement:
    """Angle between the positive directions of two lines minus 90°, and its standard uncertainty, in rad."""

    angle_rad: float
    angle_u_rad: float
    duration_s: float


@dataclass(frozen=True, eq=False)
class _Readings:
    """Mean readings (n,) in mm at the targets, their standard uncertainty by scatter, and the time that they took."""

    mean: Array
    spread: float
    duration_s: float


def measure_straightness(
    machine: MachineUnderTest, line: TargetLine, across: int, seed: int, quality: StraightnessClass | None = None
) -> StraightnessMeasurement:
    """Measure the straightness of the motion of `machine` along `line` in the direction of the axis number `across`.

    `seed` selects the errors of the instrument and of its set-up.
    """
    quality = quality or StraightnessClass()
    rng = generator(seed, "straightness interferometer")
    alignment = 1e-6 * quality.alignment_urad * rng.standard_normal()
    seen = _read(machine, line, across, alignment, quality, rng)

    return StraightnessMeasurement(
        line.along_mm,
        _from_line(line.along_mm, seen.mean),
        float(_span(line.along_mm, seen.mean)),
        standard_uncertainty(
            lambda readings: _span(line.along_mm, readings),
            seen.mean,
            _drawn_errors(seen, line, quality, draws_of(seed)),
        ),
        seen.duration_s,
    )


def measure_squareness(
    machine: MachineUnderTest,
    lines: tuple[TargetLine, TargetLine],
    axes: tuple[int, int],
    seed: int,
    quality: StraightnessClass | None = None,
) -> SquarenessMeasurement:
    """Measure the angle between two `lines` that run along the axes number `axes`.

    The optics stay where they are: their alignment is common to both lines, and the square turns the beam.
    """
    quality = quality or StraightnessClass()
    rng = generator(seed, "straightness interferometer")
    alignment = 1e-6 * quality.alignment_urad * rng.standard_normal()
    square = 1e-6 * quality.square_urad * rng.standard_normal()
    first = _read(machine, lines[0], axes[1], alignment, quality, rng)
    # Both beams turn together: what appears as a slope upwards on the first line is one downwards on the second.
    later = replace(machine, now_s=machine.now_s + first.duration_s)
    second = _read(later, lines[1], axes[0], square - alignment, quality, rng)
    both = np.concatenate((first.mean, second.mean))

    def angle(readings: Array) -> Array:
        one, other = np.split(readings, [len(first.mean)], axis=-1)
        return -(_slope(lines[0].along_mm, one) + _slope(lines[1].along_mm, other))

    draws = draws_of(seed)
    turned = 1e-6 * quality.square_urad * factors(draws) * lines[1].along_mm
    errors = np.concatenate(
        (_drawn_errors(first, lines[0], quality, draws), _drawn_errors(second, lines[1], quality, draws) + turned),
        axis=1,
    )
    return SquarenessMeasurement(
        float(angle(both)), standard_uncertainty(angle, both, errors), first.duration_s + second.duration_s
    )


def _read(
    machine: MachineUnderTest,
    line: TargetLine,
    across: int,
    slope: float,
    quality: StraightnessClass,
    rng: np.random.Generator,
) -> _Readings:
    """Return the mean readings of a line when the beam has the angle -`slope` in rad to it."""
    visit = line.visited_by(machine)
    seen = by_target(visit.displaced[..., across])
    along = line.along_mm
    shown = (1.0 + 1e-2 * quality.scale_percent * rng.standard_normal()) * (seen + slope * along)
    shown = shown + _bow(line, quality.bow_um_per_m2 * rng.standard_normal())
    shown = shown + _sigma_mm(along, quality) * rng.standard_normal(shown.shape)
    return _Readings(shown.mean(axis=(0, 1)), scatter_of_mean(shown), visit.duration_s)


def _drawn_errors(seen: _Readings, line: TargetLine, quality: StraightnessClass, rng: np.random.Generator) -> Array:
    """Return errors (DRAWS, n) in mm of the mean readings, as the instrument knows them."""
    scale = 1e-2 * quality.scale_percent * factors(rng)
    bow = quality.bow_um_per_m2 * factors(rng) * _bow(line, 1.0)
    return scale * seen.mean + bow + seen.spread * scatter(rng, len(seen.mean))


def _bow(line: TargetLine, um_per_m2: float) -> Array:
    """Return the error (n,) in mm of optics whose flat is a parabola; it is greatest in the middle of the line."""
    share = 2.0 * line.along_mm / line.length_mm - 1.0
    return 1e-3 * um_per_m2 * (1e-3 * line.length_mm) ** 2 * (1.0 - share**2)


def _sigma_mm(along: Array, quality: StraightnessClass) -> Array:
    return np.asarray(np.hypot(1e-3 * quality.reading_um, 1e-6 * quality.turbulence_um_per_m * along))


def _slope(along: Array, across: Array) -> Array:
    """Return the slopes (...) of the least-squares lines of readings (..., n)."""
    centred = along - along.mean()
    return np.asarray(across @ centred / (centred @ centred))


def _from_line(along: Array, across: Array) -> Array:
    slopes = _slope(along, across)[..., None]
    return np.asarray(across - across.mean(axis=-1, keepdims=True) - slopes * (along - along.mean()))


def _span(along: Array, across: Array) -> Array:
    return range_of(_from_line(along, across))
