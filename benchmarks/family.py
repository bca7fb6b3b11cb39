"""Volumetric error (VE) and volumetric error after compensation (VCE) of 10,000 random machines of one prior population
(the family): calculation with a quadratic form, compared with evaluation on a grid.

The quadratic form is compared with two direct evaluations of every machine on a grid of 60×20×20 points. Both direct
evaluations are timed on a sample of the machines, and the times per machine are compared.

The direct evaluation `exact` multiplies the homogeneous transforms of the axes at every point of the grid, which is the
definition of VE. The direct evaluation `linear` starts from a precomputed basis of the error field (the derivatives
with respect to the parameters), and each machine then costs one matrix product. The quadratic form must agree with
`linear` to 1e-9. Both direct evaluations remove the best rigid motion with a basis that is computed once. The
preparation of the quadratic form (grid, basis, rigid motions) is timed as well, and one of the ratios includes the time
of this preparation.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from time import perf_counter

import numpy as np

from twin.arrays import Array
from twin.machine.deflection import CASE_STUDY_NODES, cantilever_deflection
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import QuadraticForm, evaluation_grid

RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 5)
AMPLITUDES: dict[str, float | list[float]] = {
    "positioning_um": [8.0, 5.0, 3.0, 1.8, 1.1],
    "straightness_um": [5.5, 3.3, 2.0, 1.2],
    "rotation_urad": [4.6, 2.8, 1.7, 1.0, 0.6],
    "squareness_urad": 9.0,
    "cross_displacement_um": 4.5,
    "cross_rotation_urad": 3.0,
}
FAMILY = family_from_amplitudes(MODEL, AMPLITUDES)
TOOL = np.array([0.0, 250.0, 0.0])
MACHINES = 10_000
SAMPLE = 12
ROUNDS = 5


class PlainGrid:
    """Direct evaluation of the raw and the rigidly aligned rms error of single machines from all points of a grid in
    the workspace.
    """

    def __init__(self) -> None:
        self.grid = evaluation_grid(RANGES)
        self.basis = deviation_basis(MODEL, self.grid, TOOL).reshape(-1, MODEL.size)
        self.field = cantilever_deflection(*CASE_STUDY_NODES).at(self.grid)
        points = self.grid + TOOL
        motions = rigid_fields(points, points.mean(axis=0), 1000.0).reshape(-1, 6)
        self.motions = np.linalg.qr(motions)[0]

    def by_linear(self, parameters: Array) -> tuple[float, float]:
        return self._rms((self.basis @ parameters).reshape(-1, 3) + self.field)

    def by_exact(self, parameters: Array) -> tuple[float, float]:
        return self._rms(exact_deviation(MODEL, self.grid, TOOL, parameters) + self.field)

    def _rms(self, deviation: Array) -> tuple[float, float]:
        flat = deviation.reshape(-1)
        square = float(flat @ flat)
        left = flat - self.motions @ (self.motions.T @ flat)
        return float(np.sqrt(square / len(deviation))), float(np.sqrt(left @ left / len(deviation)))


def seconds(work: Callable[[], object]) -> float:
    start = perf_counter()
    work()
    return perf_counter() - start


def run() -> dict[str, float]:
    """Return the figures of the benchmark by name; times are medians over several rounds.

    Every round times all ways of calculation, and other load on the computer therefore affects all of them.
    """
    rng = np.random.default_rng(1)
    machines = FAMILY.draw(rng, MACHINES)
    # models that leave a tenth of every error: VCE is the same form, applied to the difference
    left = machines - machines * (1.0 - 0.1 * rng.standard_normal(machines.shape))
    plain = PlainGrid()
    form = QuadraticForm.build(MODEL, plain.grid, TOOL).with_field(plain.field)
    disagreement = max(largest_difference(plain, form, some) for some in (machines, left))
    works: dict[str, Callable[[], object]] = {
        "prepare": lambda: QuadraticForm.build(MODEL, evaluation_grid(RANGES), TOOL).with_field(plain.field),
        "ve": lambda: form.values(machines),
        "vce": lambda: form.values(left),
        "linear": lambda: [plain.by_linear(machine) for machine in machines[:SAMPLE]],
        "exact": lambda: [plain.by_exact(machine) for machine in machines[:SAMPLE]],
    }
    rounds = [{name: seconds(work) for name, work in works.items()} for _ in range(ROUNDS)]
    prepare, ve, vce, linear, exact = (statistics.median(r[name] for r in rounds) for name in works)
    linear, exact = linear / SAMPLE * MACHINES, exact / SAMPLE * MACHINES
    raw, aligned = form.values(machines)
    return {
        "median_ve_raw_um": 1e3 * float(np.median(raw)),
        "median_ve_aligned_um": 1e3 * float(np.median(aligned)),
        "exact_grid_10000_extrapolated_s": exact,
        "linear_grid_10000_extrapolated_s": linear,
        "forms_10000_ve_ms": 1e3 * ve,
        "forms_10000_vce_ms": 1e3 * vce,
        "forms_prepared_once_ms": 1e3 * prepare,
        "exact_grid_over_forms": exact / ve,
        "linear_grid_over_forms": linear / ve,
        "exact_grid_over_forms_prepared": exact / (prepare + ve),
        "largest_relative_difference": disagreement,
    }


def largest_difference(plain: PlainGrid, form: QuadraticForm, machines: Array) -> float:
    """Return the largest relative difference between two calculations of the rms error of the machines `parameters`:
    with the quadratic form `form`, and with the linear evaluation of `plain` on a grid.

    Only a sample of these machines is compared.
    """
    wanted = np.array([plain.by_linear(machine) for machine in machines[:SAMPLE]])
    found = np.stack(form.values(machines[:SAMPLE]), axis=1)
    return float(np.abs(found / wanted - 1.0).max())


def main() -> None:
    for name, figure in run().items():
        print(f"{name:36s} {figure:14.6g}")


if __name__ == "__main__":
    main()
