"""Virtual laser interferometer, which measures positioning along a line (ISO 230-2) and a diagonal (ISO 230-6).

The fringes that it counts follow from the optical path; the displayed distance follows from the fringes and from the
wavelength in the air that its sensors report. Three errors of real set-ups arise from this and are not added: wrong
sensors scale all distances, a beam that is not parallel to the motion shortens them (cosine error), and a change of the
air during the measurement changes the length of the dead path between interferometer and zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from simulators.instruments.machine_under_test import MachineUnderTest
from simulators.instruments.stated_uncertainty import DRAWS, draws_of, factors, range_of, scatter, standard_uncertainty
from simulators.instruments.target_line import TargetLine, by_target, scatter_of_mean
from simulators.world.noise import generator
from twin.arrays import Array

_MEAN_PRESSURE_KPA, _PRESSURE_SPREAD_KPA = 101.3, 1.0
_MEAN_HUMIDITY, _HUMIDITY_SPREAD = 45.0, 10.0
_S_PER_H = 3600.0


@dataclass(frozen=True)
class Air:
    """Temperature in °C, pressure in kPa and relative humidity in % of the air along the beam.

    The refractive index is that of the shop-floor formula of J. A. Stone and J. H. Zimmerman, Engineering Metrology
    Toolbox (NIST), appendix B. It agrees with the Ciddor equation within 0.15 ppm for 0 °C to 35 °C and 50 kPa to
    120 kPa.
    """

    temperature_c: float
    pressure_kpa: float
    humidity_percent: float

    @property
    def refractivity(self) -> float:
        """Refractive index minus 1 at the wavelength of a helium-neon laser, 633 nm."""
        t = self.temperature_c
        dry = 7.86e-4 * self.pressure_kpa / (273.0 + t)
        return dry - 1.5e-11 * self.humidity_percent * (t * t + 160.0)


@dataclass(frozen=True)
class InterferometerClass:
    """Quality of a laser interferometer and of its set-up, as standard uncertainties.

    `air_k`, `pressure_kpa` and `humidity_percent` are those of the sensors of the air, `wavelength_ppm` that of the
    wavelength in vacuum, `beam_mrad` that of the angle between beam and motion about each of two directions. A reading
    scatters by `reading_um`, and by `turbulence_um_per_m` times the path. `dead_path_mm` is the distance between
    interferometer and zero. The pressure of the air drifts by `pressure_drift_kpa_per_h`.
    """

    air_k: float = 0.2
    pressure_kpa: float = 0.05
    humidity_percent: float = 5.0
    wavelength_ppm: float = 0.05
    beam_mrad: float = 0.3
    reading_um: float = 0.05
    turbulence_um_per_m: float = 0.1
    dead_path_mm: float = 150.0
    pressure_drift_kpa_per_h: float = 0.05


@dataclass(frozen=True, eq=False)
class LineMeasurement:
    """Figures of a line, in mm, as ISO 230-2:2014 defines them (3.10 to 3.21), with k = 2 where it asks for a factor.

    `deviations` (runs, 2, n) are the deviations of position, forwards and backwards. `mean_range` is M, the range of
    the mean bidirectional deviations, `systematic` E, `accuracy` A, `repeatability` R and `reversal` B.
    `mean_range_u` is the standard uncertainty of M, and of E and A too: it contains the scale of the instrument and the
    scatter of the readings. `reading_u` is that of one reading at the far end, which R and B contain.
    """

    along_mm: Array
    deviations: Array
    mean_range: float
    mean_range_u: float
    reading_u: float
    systematic: float
    accuracy: float
    repeatability: float
    reversal: float
    duration_s: float

    @property
    def mean(self) -> Array:
        """Mean bidirectional deviation (n,) at each target, in mm."""
        return np.asarray(self.deviations.mean(axis=(0, 1)))


def measure_line(
    machine: MachineUnderTest, line: TargetLine, seed: int, quality: InterferometerClass | None = None
) -> LineMeasurement:
    """Measure the positioning of `machine` along `line` with a reflector at the tip.

    `seed` selects the errors of the instrument and of its set-up.
    """
    quality = quality or InterferometerClass()
    visit = line.visited_by(machine)
    moved_mm = line.along_mm + by_target(visit.displaced @ line.direction)
    at_s = by_target(visit.at_s)
    readings = _displayed_mm(moved_mm, at_s, machine, quality, generator(seed, "interferometer"))
    deviations = readings - line.along_mm
    # the display is set to zero at the first target of the first run
    deviations = deviations - deviations[0, 0, 0]
    mean_of_direction = deviations.mean(axis=0)
    spread = deviations.std(axis=0, ddof=1)
    reversal = np.abs(mean_of_direction[0] - mean_of_direction[1])
    upper, lower = mean_of_direction + 2.0 * spread, mean_of_direction - 2.0 * spread
    # ISO 230-2:2014, 3.19: the largest of 2 s↑ + 2 s↓ + |B|, 4 s↑ and 4 s↓ at each target
    repeatability = np.maximum(2.0 * spread.sum(axis=0) + reversal, 4.0 * spread.max(axis=0))
    mean = deviations.mean(axis=(0, 1))
    return LineMeasurement(
        along_mm=line.along_mm,
        deviations=deviations,
        mean_range=float(range_of(mean)),
        mean_range_u=_uncertainty(line, mean, scatter_of_mean(deviations), quality, seed),
        reading_u=float(_reading_sigma_mm(line.along_mm, quality).max()),
        systematic=float(mean_of_direction.max() - mean_of_direction.min()),
        accuracy=float(upper.max() - lower.min()),
        repeatability=float(repeatability.max()),
        reversal=float(reversal.max()),
        duration_s=visit.duration_s,
    )


def _displayed_mm(
    moved_mm: Array, at_s: Array, machine: MachineUnderTest, quality: InterferometerClass, rng: np.random.Generator
) -> Array:
    """Return the displayed distances (runs, 2, n) in mm when the reflector has moved by `moved_mm` (runs, 2, n)."""
    weather = Air(
        machine.air_c(machine.now_s),
        _MEAN_PRESSURE_KPA + _PRESSURE_SPREAD_KPA * rng.standard_normal(),
        _MEAN_HUMIDITY + _HUMIDITY_SPREAD * rng.uniform(-1.0, 1.0),
    )
    sensor_errors = rng.normal(0.0, [quality.air_k, quality.pressure_kpa, quality.humidity_percent])
    wavelength = 1.0 + 1e-6 * quality.wavelength_ppm * rng.standard_normal()
    cosine = 1.0 - 0.5e-6 * float(np.sum((quality.beam_mrad * rng.standard_normal(2)) ** 2))
    path_mm = quality.dead_path_mm + cosine * moved_mm
    found = np.empty_like(moved_mm)
    at_zero = weather.refractivity
    for place, instant_s in np.ndenumerate(at_s):
        hours = (float(instant_s) - machine.now_s) / _S_PER_H
        air = Air(
            machine.air_c(float(instant_s)),
            weather.pressure_kpa + quality.pressure_drift_kpa_per_h * hours,
            weather.humidity_percent,
        )
        read = Air(
            air.temperature_c + sensor_errors[0],
            air.pressure_kpa + sensor_errors[1],
            air.humidity_percent + sensor_errors[2],
        )
        # Fringes since zero, as a length in vacuum: the dead path changes optically, but its length stays.
        optical = (1.0 + air.refractivity) * path_mm[place] - (1.0 + at_zero) * quality.dead_path_mm
        found[place] = optical / (1.0 + read.refractivity) * wavelength
    return found + _reading_sigma_mm(moved_mm, quality) * rng.standard_normal(found.shape)


def _reading_sigma_mm(moved_mm: Array, quality: InterferometerClass) -> Array:
    turbulence_mm = 1e-6 * quality.turbulence_um_per_m * np.abs(moved_mm)
    return np.asarray(np.hypot(1e-3 * quality.reading_um, turbulence_mm))


def _uncertainty(line: TargetLine, mean: Array, spread: float, quality: InterferometerClass, seed: int) -> float:
    """Return the standard uncertainty of M in mm. The instrument knows the scatter that it saw, and the quality of its
    parts; it does not know its errors."""
    rng = draws_of(seed)
    shortened = 0.5e-6 * np.sum((quality.beam_mrad * rng.standard_normal((DRAWS, 2))) ** 2, axis=1, keepdims=True)
    scale = _relative_uncertainty(quality) * factors(rng) + shortened
    errors = scale * line.along_mm + spread * scatter(rng, len(mean))
    return standard_uncertainty(range_of, mean, errors)


def _relative_uncertainty(quality: InterferometerClass) -> float:
    """Return the relative standard uncertainty of a distance by the compensation of the wavelength, from the changes of
    the refractive index at 20 °C."""
    usual = Air(20.0, _MEAN_PRESSURE_KPA, _MEAN_HUMIDITY)
    parts = [
        Air(20.0 + quality.air_k, usual.pressure_kpa, usual.humidity_percent),
        Air(20.0, usual.pressure_kpa + quality.pressure_kpa, usual.humidity_percent),
        Air(20.0, usual.pressure_kpa, usual.humidity_percent + quality.humidity_percent),
    ]
    changes = [part.refractivity - usual.refractivity for part in parts]
    return float(np.linalg.norm([*changes, 1e-6 * quality.wavelength_ppm]))
