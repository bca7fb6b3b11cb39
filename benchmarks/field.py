"""Time to calculate the exact deviation of a machine at 24,000 points, compared with a plain loop of 4x4 matrices and
with the quadratic form for the volumetric error.

The loop is the obvious implementation. For each point and axis it evaluates the Legendre series, builds the homogeneous
transforms as 4x4 arrays, and multiplies them with `@`. The loop is timed on a sample of the same points, and the times
per point are compared.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable

import numpy as np

from benchmarks.family import MODEL, RANGES, TOOL, seconds
from twin.arrays import Array
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import AXES
from twin.machine.volumetric import QuadraticForm, evaluation_grid

LOOP_SAMPLE = 400
ROUNDS = 15


def machine() -> Array:
    """Return the model parameters of a machine with errors of tens of µm and µrad."""
    sizes = [2e-2 if parameter.unit == "mm" else 2e-5 for parameter in MODEL.parameters]
    return np.random.default_rng(1).uniform(-1.0, 1.0, MODEL.size) * sizes


def legendre(order: int, argument: float) -> list[float]:
    values = [1.0, argument]
    for k in range(1, order):
        values.append(((2 * k + 1) * argument * values[k] - k * values[k - 1]) / (k + 1))
    return values


def axis_transform(axis: int, point: list[float], series: Array, lean: list[float]) -> Array:
    """Return the homogeneous transform of one axis, with its errors, as a 4x4 array.

    The transform is the product Trans(q u) Trans(E) Rz Ry Rx. In this product q is the axis position, u is the unit
    vector of the axis, and E is the translational error of the axis. Rz, Ry and Rx are the rotations by its angular
    errors about Z, Y and X. `series` contains the Legendre coefficients of the six error motions of the axis. `lean`
    contains the five coefficients of the bending of the column by the extended ram: in the transform of the Z axis,
    three of them add a displacement along Y to E, and two add a rotation about X.
    """
    low, high = RANGES[axis]
    values = legendre(series.shape[1] - 1, 2.0 * (point[axis] - low) / (high - low) - 1.0)
    motions = (series @ values).tolist()
    if axis == 2:
        v, w = point[1] / 1300.0, point[2] / 1500.0
        motions[1] += (lean[0] + lean[1] * w + lean[2] * w * w) * v
        motions[3] += (lean[3] + lean[4] * w) * v
    (sa, ca), (sb, cb), (sc, cc) = ((math.sin(angle), math.cos(angle)) for angle in motions[3:])
    transform = np.array(
        [
            [cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa, motions[0]],
            [sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa, motions[1]],
            [-sb, cb * sa, cb * ca, motions[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
    transform[axis, 3] += point[axis]
    return transform


def plain_loop(points: Array, parameters: Array) -> Array:
    """Return the machine's deviations, shape (n, 3), in mm at n axis positions, computed for each point by a product of
    4x4 matrices.
    """
    series = [MODEL.coefficients(axis, parameters) for axis in range(3)]
    lean = list(MODEL.column_and_ram(parameters).values())
    a0z, b0z, c0y = MODEL.squareness(parameters)
    tool = np.append(TOOL, 1.0)
    deviation = np.empty_like(points)
    for row, point in enumerate(points.tolist()):
        transforms = [axis_transform(axis, point, series[axis], lean) for axis in range(3)]
        y, z = point[1], point[2]
        transforms[1][:3, 3] += (-math.sin(c0y) * y, (math.cos(c0y) - 1.0) * y, 0.0)
        transforms[2][0, 3] += math.sin(b0z) * math.cos(a0z) * z
        transforms[2][1, 3] -= math.sin(a0z) * z
        transforms[2][2, 3] += (math.cos(b0z) * math.cos(a0z) - 1.0) * z
        place = np.eye(4)
        for letter in reversed(MODEL.chain.tool_side):
            place = place @ transforms[AXES.index(letter)]
        deviation[row] = (place @ tool)[:3] - point - TOOL
    return deviation


def run() -> dict[str, float]:
    """Return the figures of the benchmark by name; times are medians over several rounds.

    Every round times all ways of calculation, and other load on the computer therefore affects all of them.
    """
    grid, parameters = evaluation_grid(RANGES), machine()
    lengths = np.array([high for _, high in RANGES])
    scattered = np.random.default_rng(2).uniform(0.0, 1.0, grid.shape) * lengths
    sample = scattered[:LOOP_SAMPLE]
    difference = np.abs(plain_loop(sample, parameters) - exact_deviation(MODEL, sample, TOOL, parameters)).max()
    assert difference < 1e-11, "the two do not compute the same"
    form = QuadraticForm.build(MODEL, grid, TOOL)
    works: dict[str, Callable[[], object]] = {
        "loop": lambda: plain_loop(sample, parameters),
        "grid": lambda: exact_deviation(MODEL, grid, TOOL, parameters),
        "scattered": lambda: exact_deviation(MODEL, scattered, TOOL, parameters),
        "form": lambda: form.value(parameters),
    }
    rounds = [{name: seconds(work) for name, work in works.items()} for _ in range(ROUNDS)]
    loop, on_grid, on_scattered, value = (statistics.median(r[name] for r in rounds) for name in works)
    loop *= len(grid) / LOOP_SAMPLE
    return {
        "plain_loop_us_per_point": 1e6 * loop / len(grid),
        "plain_loop_24000_extrapolated_ms": 1e3 * loop,
        "exact_grid_24000_ms": 1e3 * on_grid,
        "exact_scattered_24000_ms": 1e3 * on_scattered,
        "quadratic_form_value_us": 1e6 * value,
        "loop_over_exact_grid": loop / on_grid,
        "loop_over_exact_scattered": loop / on_scattered,
        "loop_over_quadratic_form": loop / value,
        "largest_difference_to_loop_nm": 1e6 * float(difference),
    }


def main() -> None:
    for name, figure in run().items():
        print(f"{name:36s} {figure:14.6g}")


if __name__ == "__main__":
    main()
