"""Time to identify machine errors from the position sets S1+S2+S3, compared with scipy's `least_squares` and with bare
linear algebra.

The case has 11 balls, 4 stations and Legendre order 5. In addition, the default identification with one Legendre order
is compared with an identification that chooses one of seven orders by Bayesian evidence.

The function `reference` solves the same maximum-a-posteriori problem with `scipy.optimize.least_squares` and its own
finite differences. The problem contains the exact machine model, the poses of the artefact and the prior population of
machine errors, but no nuisance parameters.

The bare core is only the linear algebra of an identification: it eliminates the poses by projection, forms the normal
equations, factorises them and solves them once. The bare core is timed in two variants. The variant `bare_core` starts
from a whitened Jacobian that is already arranged by position. The variant `core_with_basis` starts from axis positions
and poses; it evaluates the basis of the error field there, whitens it and arranges it. The variant `core_with_basis` is
the fair baseline, because every identification must first build the Jacobian. Neither variant finds the poses,
evaluates the exact model, takes a second step, returns a covariance or checks its input; `identify` does all of this.

Every round times all these alternatives in turn. Times are medians over the rounds, and ratios are medians of the
ratios within a round. Other load on the computer therefore affects all alternatives equally. If other programs use the
processor, set OPENBLAS_NUM_THREADS=1: waiting for threads on busy cores takes longer than the work on these small
matrices.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.optimize import least_squares

from benchmarks.family import AMPLITUDES, RANGES, TOOL
from twin.arrays import Array
from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import is_reachable, mount_pose, parse_position_set, station_locations
from twin.identification import Estimate, Options, identify, identify_by_evidence
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import Family, family_from_amplitudes

NOISE_MM = 1e-3
ROUNDS = 41
ROUNDS_OF_CHOICE = 5
FIXED = Options(estimate_scales=False, outliers="none", misfit_mm=0.0)


@dataclass(frozen=True)
class Case:
    """Simulated measurement of the artefact in K positions.

    `rotation`, shape (K, 3, 3), and `centre`, shape (K, 3) in mm, give the pose of the artefact in each position. The
    function `reference`, which solves the problem with scipy, starts from these poses.
    """

    model: ErrorModel
    family: Family
    artefact: Artefact
    observations: Observations
    rotation: Array
    centre: Array


def build_case(seed: int = 1) -> Case:
    model = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 5)
    family = family_from_amplitudes(model, AMPLITUDES)
    rng = np.random.default_rng(seed)
    parameters = family.draw(rng, 1)[0]
    bar = ball_bar("bar", balls=11, length_mm=1500.0, tilt_rad=0.26, holder_length_mm=60.0, ball_diameter_mm=25.0)
    positions = parse_position_set("S1+S2+S3", 4)
    places = station_locations(4, RANGES[0], 560.0, 900.0, 750.0)
    lower, upper = np.array(RANGES).T
    rows, rotations, centres = [], [], []
    for number, position in enumerate(positions):
        azimuth, elevation = np.radians(position.azimuth_deg), np.radians(position.elevation_deg)
        pose = mount_pose(places[position.station - 1], MountGeometry(), azimuth, elevation)
        points = pose.apply(bar.balls) - TOOL
        for ball in np.flatnonzero(is_reachable(points, lower, upper, np.full(3, 10.0))):
            rows.append((number, ball, elevation, *points[ball]))
        rotations.append(pose.rotation)
        centres.append(pose.centre)
    table = np.array(rows)
    axis_positions = table[:, 3:].copy()
    for _ in range(3):
        axis_positions = table[:, 3:] - exact_deviation(model, axis_positions, TOOL, parameters)
    observations = Observations(
        position=table[:, 0].astype(int),
        ball=table[:, 1].astype(int),
        tool=np.zeros(len(table), dtype=int),
        axis_positions=axis_positions + rng.normal(0.0, NOISE_MM, axis_positions.shape),
        covariance=np.tile(np.eye(3) * NOISE_MM**2, (len(table), 1, 1)),
        temperature_c=np.full(len(table), 20.0),
        elevation_rad=table[:, 2],
        tool_offsets=TOOL[None],
    )
    return Case(model, family, bar, observations, np.array(rotations), np.array(centres))


def reference(case_: Case) -> Array:
    """Return the p model parameters, shape (p,), that scipy's `least_squares` finds with finite differences for the
    simulated measurement `case_`.

    The unknowns (parameters and corrections of the artefact poses) are scaled. Parameters are in units of their prior
    standard deviations, displacements of a pose in mm, and rotations of a pose in mrad.
    """
    seen, scale, size = case_.observations, case_.family.prior_standard_deviation, case_.model.size
    balls = case_.artefact.balls[seen.ball]

    def residuals(unknowns: Array) -> Array:
        pose = unknowns[size:].reshape(-1, 6)[seen.position]
        deviation = exact_deviation(case_.model, seen.axis_positions, TOOL, scale * unknowns[:size])
        placed = np.einsum("nij,nj->ni", case_.rotation[seen.position], balls)
        placed = placed + np.cross(1e-3 * pose[:, 3:], placed) + case_.centre[seen.position] + pose[:, :3]
        errors = (seen.axis_positions + TOOL + deviation - placed) / NOISE_MM
        return np.concatenate((errors.reshape(-1), unknowns[:size]))

    start = np.zeros(size + 6 * len(case_.centre))
    found = least_squares(residuals, start, method="trf", x_scale="jac")
    return np.asarray(scale * found.x[:size])


def jacobian(case_: Case) -> tuple[Array, Array]:
    """Return two whitened Jacobians (in units of the noise) of the measured ball centres: with respect to the model
    parameters, shape (K, 3 m, p), and to the artefact poses, shape (K, 3 m, 6).

    K is the number of positions, m is the largest number of balls in a position, and p is the number of parameters. The
    rows of a position with fewer than m balls are padded with zeros.
    """
    seen, counts = case_.observations, np.bincount(case_.observations.position)
    shape = (len(counts), int(counts.max()), 3)
    basis = deviation_basis(case_.model, seen.axis_positions, TOOL) * (case_.family.prior_standard_deviation / NOISE_MM)
    design, poses = np.zeros((*shape, case_.model.size)), np.zeros((*shape, 6))
    lever = np.einsum("nij,nj->ni", case_.rotation[seen.position], case_.artefact.balls[seen.ball])
    place = np.concatenate([np.arange(count) for count in counts])
    design[seen.position, place] = basis
    poses[seen.position, place, :, :3] = np.eye(3) / NOISE_MM
    poses[seen.position, place, :, 3:] = np.cross(np.eye(3), lever[:, None, :]).transpose(0, 2, 1) / NOISE_MM / 500.0
    return design.reshape(len(counts), -1, case_.model.size), poses.reshape(len(counts), -1, 6)


def core(design: Array, poses: Array, target: Array) -> Array:
    """Solve the linearised identification once: eliminate the artefact poses by projection and solve the normal
    equations.

    Returns the p model parameters, shape (p,), in units of their prior standard deviations. `design` and `poses` are
    the results of `jacobian`, and `target` contains the residuals in units of the noise.
    """
    q, _ = np.linalg.qr(poses)
    # Project the poses out, then solve the normal equations (JᵀJ + I) x = Jᵀ r of the prior-scaled unknowns.
    free = (design - q @ (q.transpose(0, 2, 1) @ design)).reshape(-1, design.shape[2])
    factor = np.linalg.cholesky(free.T @ free + np.eye(design.shape[2]))
    return np.asarray(np.linalg.solve(factor.T, np.linalg.solve(factor, free.T @ target)))


def by_evidence(case_: Case) -> Estimate:
    """Run the default identification, but choose one of seven Legendre orders by Bayesian evidence."""

    def family_of(order: int) -> Family:
        return family_from_amplitudes(ErrorModel.uniform(case_.model.chain, RANGES, order), AMPLITUDES)

    return identify_by_evidence(family_of, case_.observations, case_.artefact)


def seconds(works: dict[str, Callable[[], object]], rounds: int) -> dict[str, Array]:
    """Return, for each function in `works`, its times in s as an array of shape (rounds,). Every round times all
    functions in turn.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            start = perf_counter()
            work()
            times[name].append(perf_counter() - start)
    return {name: np.array(values) for name, values in times.items()}


def run() -> dict[str, float]:
    """Return, by name, the median times of the identification and its alternatives in ms and the ratios of times, all
    measured in this process.

    A figure with `fixed` in its name belongs to an identification that estimates no scale factors of noise and prior,
    searches for no outliers, and has no misfit (errors that the model cannot represent).
    """
    prepared = build_case()
    everything = (prepared.model, prepared.observations, prepared.artefact, prepared.family)
    ready = jacobian(prepared)
    target = np.random.default_rng(0).normal(size=ready[0].shape[0] * ready[0].shape[1])
    works: dict[str, Callable[[], object]] = {
        "bare_core": lambda: core(*ready, target),
        "core_with_basis": lambda: core(*jacobian(prepared), target),
        "fixed": lambda: identify(*everything, FIXED),
        "default": lambda: identify(*everything),
    }
    for work in works.values():
        work()
    times = seconds(works, ROUNDS)
    scipy_s = float(seconds({"scipy": lambda: reference(prepared)}, 1)["scipy"][0])
    chosen = {"default": works["default"], "evidence": lambda: by_evidence(prepared)}
    choosing = seconds(chosen, ROUNDS_OF_CHOICE)
    found = {"balls": float(prepared.observations.size), "scipy_ms": 1e3 * scipy_s}
    found["evidence_ms"] = 1e3 * float(np.median(choosing["evidence"]))
    found["evidence_over_default"] = float(np.median(choosing["evidence"] / choosing["default"]))
    found |= {f"{name}_ms": 1e3 * float(np.median(values)) for name, values in times.items()}
    for name in ("fixed", "default"):
        found[f"scipy_over_{name}"] = scipy_s / float(np.median(times[name]))
        for base in ("bare_core", "core_with_basis"):
            found[f"{name}_over_{base}"] = float(np.median(times[name] / times[base]))
    return found


def main() -> None:
    for name, value in run().items():
        print(f"  {name:32s} {value:12.4g}")


if __name__ == "__main__":
    main()
