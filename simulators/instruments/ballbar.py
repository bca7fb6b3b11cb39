"""Virtual telescoping ballbar, which measures circular tests in both directions (ISO 230-4).

One ball is at the tip, the other one near the centre of the circle; the bar shows the change of their distance. The
centre of the set-up is not that of the circle: the evaluation removes this by the least-squares circle, up to terms of
second order. The sensor scales what it shows, and the length of the bar is known from a calibrator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.errors import InputError
from simulators.instruments.machine_under_test import MachineUnderTest
from simulators.instruments.stated_uncertainty import draws_of, factors, range_of, scatter, standard_uncertainty
from simulators.world.noise import generator
from twin.arrays import Array

SAMPLES = 360
"""Evaluated samples of a revolution."""
FEED_MM_PER_S = 1000.0 / 60.0
_REVERSAL_RAD = np.radians(3.0)
"""Sector on each side of the reversal of an axis that is left out of the mean path of both directions: until its play
is taken up, an axis lags behind equally in both, and the mean does not cancel it."""
_APPROACH_RAD = np.pi
"""Angle of the approach before the evaluated revolution, which takes up the play of both axes."""
MOST_RUNS = 10


@dataclass(frozen=True)
class BallbarClass:
    """Quality of a ballbar and of its set-up, as standard uncertainties.

    `sensor_um` is the noise of an evaluated sample, `scale_percent` the error of the scale of the sensor, `length_um`
    that of the calibrated length, and `form_um` the form error of the balls in their seats. `centre_um` is the distance
    of the centre ball from the centre of the circle along each axis of its plane, and `height_um` that across it.
    """

    sensor_um: float = 0.1
    scale_percent: float = 0.15
    length_um: float = 0.4
    form_um: float = 0.1
    centre_um: float = 15.0
    height_um: float = 50.0


@dataclass(frozen=True, eq=False)
class Circle:
    """Circle of `radius_mm` about the axis position `centre_mm` (3,) in the plane of two axis numbers, with `runs`
    revolutions in each direction. Counter-clockwise is from the first axis to the second one.

    Raises InputError if the circle is none, or has no run.
    """

    centre_mm: Array
    radius_mm: float
    axes: tuple[int, int]
    runs: int = 3

    def __post_init__(self) -> None:
        if not (np.isfinite(self.centre_mm).all() and np.isfinite(self.radius_mm) and self.radius_mm > 0.0):
            raise InputError("a circle needs a centre and a radius above 0 in mm", key="radius_mm")
        if self.axes[0] == self.axes[1]:
            raise InputError("the plane of a circle needs two different axes", key="plane")
        if not 1 <= self.runs <= MOST_RUNS:
            raise InputError(f"a circle is measured in 1 to {MOST_RUNS} revolutions, not {self.runs}", key="runs")

    def radial(self, angles: Array) -> Array:
        """Return the unit vectors (n, 3) from the centre at angles (n,) in rad."""
        found = np.zeros((len(angles), 3))
        found[:, self.axes[0]], found[:, self.axes[1]] = np.cos(angles), np.sin(angles)
        return found


@dataclass(frozen=True, eq=False)
class CircularTest:
    """Figures of a circular test, in mm, from the least-squares centre of the path.

    `clockwise` and `counter_clockwise` (n,) are the radial deviations of the mean path of each direction at `angles`
    (n,) in rad. `mean` (m,) at `mean_angles` (m,) are those of the mean of both outside the reversals, which lost
    motion does not enlarge. The circular deviations G of each path and of both together (bidirectional) and the
    `hysteresis` H are those of ISO 230-4:2022. `g_mean` is a figure of our own, not one of the standard: the range of
    `mean`, to be compared with a prediction that contains no lost motion. `radius` is the mean radius minus the nominal
    one. Those that end with `_u` are standard uncertainties.
    """

    angles: Array
    clockwise: Array
    counter_clockwise: Array
    mean_angles: Array
    mean: Array
    g_clockwise: float
    g_counter_clockwise: float
    g_bidirectional: float
    g_mean: float
    g_mean_u: float
    hysteresis: float
    radius: float
    radius_u: float
    duration_s: float


def measure_circle(
    machine: MachineUnderTest, circle: Circle, seed: int, quality: BallbarClass | None = None
) -> CircularTest:
    """Measure the circular motion of `machine`, first counter-clockwise, then clockwise.

    `seed` selects the errors of the instrument and of its set-up.
    """
    quality = quality or BallbarClass()
    rng = generator(seed, "ballbar")
    setup_um = rng.normal(0.0, [quality.centre_um, quality.centre_um, quality.height_um])
    height = 3 - sum(circle.axes)
    ball = circle.centre_mm.copy()
    ball[[*circle.axes, height]] += 1e-3 * setup_um
    scale = 1.0 + 1e-2 * quality.scale_percent * rng.standard_normal()
    length_mm = circle.radius_mm + 1e-3 * quality.length_um * rng.standard_normal()
    angles = 2.0 * np.pi * np.arange(SAMPLES) / SAMPLES
    form_mm = 1e-3 * quality.form_um * _form(angles, *rng.standard_normal(2))
    began_s, paths = machine.now_s, []
    for turn in (1.0, -1.0):
        swept, at_s = _swept(circle, began_s)
        began_s = float(at_s[-1])
        way = circle.centre_mm + circle.radius_mm * circle.radial(turn * swept)
        tip = way + machine.contour(way, at_s)
        # the bar shows its change against the calibrated length; the scale of the sensor applies to the change
        shown = scale * (np.linalg.norm(tip - ball, axis=1) - length_mm)
        shown = shown[-circle.runs * SAMPLES :].reshape(circle.runs, SAMPLES)
        shown = shown + 1e-3 * quality.sensor_um * rng.standard_normal(shown.shape)
        mean = shown.mean(axis=0)
        paths.append(form_mm + (mean if turn > 0.0 else np.roll(mean[::-1], 1)))
    raw = np.stack(paths)
    return _evaluated(angles, raw, circle, quality, seed, began_s - machine.now_s)


def _swept(circle: Circle, began_s: float) -> tuple[Array, Array]:
    """Return the angles (m,) in rad through which the tip passes in one direction, from the approach on, and the
    instants (m,) in s."""
    step = 2.0 * np.pi / SAMPLES
    approach = round(_APPROACH_RAD / step)
    swept = np.asarray(step * np.arange(-approach, circle.runs * SAMPLES), dtype=np.float64)
    return swept, began_s + (swept - swept[0]) * circle.radius_mm / FEED_MM_PER_S


def _evaluated(
    angles: Array, raw: Array, circle: Circle, quality: BallbarClass, seed: int, duration_s: float
) -> CircularTest:
    both = raw.mean(axis=0)
    centre = _least_squares_circle(angles, both)
    counter, clockwise, mean = (path - _off_centre(angles, centre) for path in (*raw, both))
    steady = np.abs((angles + 0.25 * np.pi) % (0.5 * np.pi) - 0.25 * np.pi) > _REVERSAL_RAD
    noise = 1e-3 * quality.sensor_um / np.sqrt(2.0 * circle.runs)

    rng = draws_of(seed)
    errors = (
        1e-2 * quality.scale_percent * factors(rng) * both
        + 1e-3 * quality.length_um * factors(rng)
        + noise * scatter(rng, len(both))
        + 1e-3 * quality.form_um * _form(angles, factors(rng), factors(rng))
        + _set_up_of_second_order(angles, circle, quality, rng)
    )

    def roundness(readings: Array) -> Array:
        return range_of((readings - _off_centre(angles, _least_squares_circle(angles, readings)))[..., steady])

    def size(readings: Array) -> Array:
        return np.asarray(_least_squares_circle(angles, readings)[..., 2])

    return CircularTest(
        angles=angles,
        clockwise=clockwise,
        counter_clockwise=counter,
        mean_angles=angles[steady],
        mean=mean[steady],
        g_clockwise=float(range_of(clockwise)),
        g_counter_clockwise=float(range_of(counter)),
        g_bidirectional=float(max(clockwise.max(), counter.max()) - min(clockwise.min(), counter.min())),
        g_mean=float(range_of(mean[steady])),
        g_mean_u=standard_uncertainty(roundness, both, errors),
        hysteresis=float(np.abs(clockwise - counter).max()),
        radius=float(size(both)),
        radius_u=standard_uncertainty(size, both, errors),
        duration_s=duration_s,
    )


def _least_squares_circle(angles: Array, radial: Array) -> Array:
    """Return centres and radii (..., 3) of the circles that fit radial deviations (..., n) best.

    The deviations are small against the radius, and their samples are evenly spaced over the whole circle: the fit is
    the first Fourier coefficients.
    """
    fields = np.stack((2.0 * np.cos(angles), 2.0 * np.sin(angles), np.ones_like(angles)), axis=1)
    return np.asarray(radial @ fields / len(angles))


def _off_centre(angles: Array, centre: Array) -> Array:
    return np.asarray(centre[..., :1] * np.cos(angles) + centre[..., 1:2] * np.sin(angles))


def _form(angles: Array, cosine: float | Array, sine: float | Array) -> Array:
    """Return a form error (..., n) of three lobes, the lowest that neither the centre nor an ellipse takes up."""
    return np.asarray((cosine * np.cos(3.0 * angles) + sine * np.sin(3.0 * angles)) / np.sqrt(2.0))


def _set_up_of_second_order(angles: Array, circle: Circle, quality: BallbarClass, rng: np.random.Generator) -> Array:
    """Return changes (DRAWS, n) in mm of the distance to the centre ball by a drawn set-up that a shift of the centre
    does not explain: half of the square of what is across the bar, over the radius."""
    x, y = (1e-3 * quality.centre_um * factors(rng) for _ in range(2))
    height = 1e-3 * quality.height_um * factors(rng)
    across = y * np.cos(angles) - x * np.sin(angles)
    return np.asarray((across**2 + height**2) / (2.0 * circle.radius_mm))
