"""Identification against scipy on the same residuals, and errors for insufficient sets."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured, truth_of
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from twin.artefact.observations import Observations
from twin.errors import DataError, SingularSet
from twin.identification import Options, field_uncertainty, identify, predicted_vce
from twin.identification.options import Formulation, Weights
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms, volumetric_error

GRID = evaluation_grid(RANGES, (14, 8, 8))
PLAIN = Options(estimate_scales=False, outliers="none", misfit_mm=0.0)


def machine(order: int, seed: int):
    model, family = case_study(order)
    parameters = family.draw(np.random.default_rng(seed), 1)[0]
    return model, family, parameters, lambda X, tool: exact_deviation(model, X, tool, parameters)


def by_scipy(model, family, artefact, seen: Observations, certificate_mm: float) -> np.ndarray:
    """Return the maximum a posteriori solution by `trf` with finite differences: parameters, poses and certificate
    errors."""
    p, places = model.size, len(np.unique(seen.position))
    scale = family.prior_standard_deviation
    points = seen.axis_positions + seen.tool_offsets[seen.tool]
    starts = []
    for k in range(places):
        rows = seen.position == k
        balls = artefact.balls[seen.ball[rows]]
        turn, _ = Rotation.align_vectors(points[rows] - points[rows].mean(0), balls - balls.mean(0))
        starts.append((turn, points[rows].mean(0) - turn.apply(balls.mean(0))))
    white = np.linalg.inv(np.linalg.cholesky(seen.covariance))

    def residuals(u: np.ndarray) -> np.ndarray:
        deviation = np.zeros_like(points)
        for tool, offset in enumerate(seen.tool_offsets):
            rows = seen.tool == tool
            deviation[rows] = exact_deviation(model, seen.axis_positions[rows], offset, scale * u[:p])
        poses, slip = u[p : p + 6 * places].reshape(-1, 6), u[p + 6 * places :].reshape(-1, 3)
        error = points + deviation
        for k, (turn, centre) in enumerate(starts):
            rows = seen.position == k
            balls = artefact.balls[seen.ball[rows]] + certificate_mm * slip[seen.ball[rows]]
            turned = (Rotation.from_rotvec(1e-5 * poses[k, 3:]) * turn).apply(balls)
            error[rows] -= turned + centre + 1e-2 * poses[k, :3]
        return np.concatenate((np.einsum("nij,nj->ni", white, error).reshape(-1), u[:p], slip.reshape(-1)))

    start = np.zeros(p + 6 * places + 3 * artefact.count)
    found = least_squares(residuals, start, jac="3-point", xtol=1e-13, ftol=1e-13, gtol=1e-13, x_scale="jac")
    return scale * found.x[:p]


def test_the_solution_is_that_of_scipy_on_the_exact_residuals() -> None:
    model, family, _, truth = machine(2, 1)
    rng = np.random.default_rng(2)
    artefact = bar(5, sigma_mm=0.8e-3)
    seen = measured("S3", 1, artefact, truth, rng)
    root = rng.normal(0.0, 0.3e-3, (seen.size, 3, 3)) + np.eye(3) * [1e-3, 2e-3, 3e-3]
    seen = dataclasses.replace(seen, covariance=root @ root.transpose(0, 2, 1))
    reference = by_scipy(model, family, artefact, seen, 0.8e-3)
    estimate = identify(model, seen, artefact, family, PLAIN)
    scale = family.prior_standard_deviation
    assert np.abs(reference / scale).max() > 0.5
    assert estimate.parameters / scale == pytest.approx(reference / scale, abs=2e-4)


def test_two_tools_are_fused_as_scipy_does() -> None:
    model, family, _, truth = machine(2, 3)
    artefact = bar(5, sigma_mm=1e-9)
    tools = (TOOL, np.array([60.0, 330.0, -40.0]))
    seen = measured("S3", 1, artefact, truth, np.random.default_rng(4), tools=tools)
    estimate = identify(model, seen, artefact, family, PLAIN)
    scale = family.prior_standard_deviation
    reference = by_scipy(model, family, artefact, seen, 1e-9)
    assert estimate.parameters / scale == pytest.approx(reference / scale, abs=2e-4)
    one = measured("S3", 1, artefact, truth, np.random.default_rng(4))
    assert estimate.rank > identify(model, one, artefact, family, PLAIN).rank


def test_without_noise_the_field_comes_back() -> None:
    model, family, _, truth = machine(3, 5)
    seen = measured("S1+S2+S3", 4, bar(), truth, np.random.default_rng(0), sigma_mm=1e-7)
    estimate = identify(model, seen, bar(), family, PLAIN)
    left = truth(GRID, TOOL) - exact_deviation(model, GRID, TOOL, estimate.parameters)
    assert volumetric_error(GRID + TOOL, truth(GRID, TOOL)).aligned_um > 4.0
    assert rms(align_rigidly(GRID + TOOL, left)) < 0.15e-3


def test_covariance_is_the_inverse_of_the_full_normal_matrix() -> None:
    """Compare with plain dense algebra: invert one matrix with all poses and take the block of the parameters."""
    model, family, _, truth = machine(2, 6)
    artefact = bar(5)
    seen = measured("S3", 1, artefact, truth, np.random.default_rng(7))
    estimate = identify(model, seen, artefact, family, PLAIN)
    p, places = model.size, 6
    big = np.zeros((3 * seen.size + p, p + 6 * places))
    basis = deviation_basis(model, seen.axis_positions, TOOL)
    points = seen.axis_positions + TOOL
    for row in range(seen.size):
        rows, at = slice(3 * row, 3 * row + 3), p + 6 * seen.position[row]
        arm = points[row] - points[seen.position == seen.position[row]].mean(axis=0)
        big[rows, :p] = basis[row] / 1e-3
        big[rows, at : at + 3] = -np.eye(3) / 1e-3
        big[rows, at + 3 : at + 6] = -np.cross(np.eye(3), arm).T / 1e-3 / 500.0
    big[3 * seen.size :, :p] = np.diag(1.0 / family.prior_standard_deviation)
    expected = np.linalg.inv(big.T @ big)[:p, :p]
    scale = family.prior_standard_deviation
    assert estimate.covariance / np.outer(scale, scale) == pytest.approx(expected / np.outer(scale, scale), abs=1e-4)


def test_a_covariance_taken_as_prior_equals_measuring_both_at_once() -> None:
    model, family, _, truth = machine(3, 8)
    artefact = bar(7)
    rng = np.random.default_rng(9)
    first, second = (measured(name, 2, artefact, truth, rng) for name in ("S1", "S3"))
    names = ("ball", "tool", "axis_positions", "covariance", "temperature_c", "elevation_rad")
    joined = {name: np.concatenate((getattr(first, name), getattr(second, name))) for name in names}
    position = np.concatenate((first.position, second.position + 100))
    both = Observations(position=position, tool_offsets=first.tool_offsets, **joined)
    last_night = identify(model, first, artefact, family, PLAIN)
    carried = dataclasses.replace(PLAIN, carried_over=last_night.carried_over())
    in_turn = identify(model, second, artefact, family, carried)
    at_once = identify(model, both, artefact, family, PLAIN)
    scale = family.prior_standard_deviation
    assert in_turn.parameters / scale == pytest.approx(at_once.parameters / scale, abs=2e-4)
    assert in_turn.covariance / np.outer(scale, scale) == pytest.approx(
        at_once.covariance / np.outer(scale, scale), abs=1e-5
    )


class TestUncertainty:
    def test_a_drawn_machine_lies_where_the_covariance_says(self) -> None:
        """With truths drawn from the prior, normalised squares average 1 and 95 % of the parameters lie within 1.96
        sigma."""
        model, family = case_study(4)
        squares, inside = [], []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            parameters = rng.normal(size=model.size) * family.prior_standard_deviation
            certified = bar(11, sigma_mm=0.8e-3)
            real = dataclasses.replace(certified, balls=certified.balls + rng.normal(0.0, 0.8e-3, (11, 3)))
            seen = measured("S3", 3, real, truth_of(model, parameters), rng)
            estimate = identify(model, seen, certified, family, PLAIN)
            scale = np.sqrt(np.diag(estimate.covariance))
            error = (parameters - estimate.parameters) / scale
            inside.append(np.mean(np.abs(error) < 1.96))
            field = exact_deviation(model, GRID, TOOL, parameters)
            field = field - exact_deviation(model, GRID, TOOL, estimate.parameters)
            squares.append(np.mean((field / field_uncertainty(estimate, GRID, TOOL)) ** 2))
        assert 0.93 < np.mean(inside) < 0.98
        assert 0.75 < np.mean(squares) < 1.35

    def test_thermal_expansion_is_taken_out_and_its_doubt_counted(self) -> None:
        model, family, parameters, truth = machine(3, 12)
        steel = bar(11, cte_standard_uncertainty_per_k=1e-6)
        cool, warm = (measured("S3", 3, steel, truth, np.random.default_rng(13), temperature_c=t) for t in (20.0, 26.0))
        at_20, at_26 = (identify(model, seen, steel, family, PLAIN) for seen in (cool, warm))
        slope = model.index("EXX[1]")
        assert abs(at_26.parameters[slope] - at_20.parameters[slope]) < 3.0 * at_26.standard_uncertainty[slope]
        ignored = identify(model, dataclasses.replace(warm, temperature_c=cool.temperature_c), steel, family, PLAIN)
        assert abs(ignored.parameters[slope] - parameters[slope]) > 40e-3 > 5.0 * at_26.standard_uncertainty[slope]
        assert at_26.standard_uncertainty[slope] > 1.8 * at_20.standard_uncertainty[slope]

    def test_noise_is_estimated_where_it_is_misstated(self) -> None:
        model, family, _, truth = machine(4, 14)
        seen = measured("S3", 4, bar(), truth, np.random.default_rng(15), sigma_mm=2e-3)
        stated = dataclasses.replace(seen, covariance=seen.covariance / 4.0)
        estimate = identify(model, stated, bar(), family)
        assert estimate.scales.noise == pytest.approx(2.0, rel=0.1)
        assert estimate.chi2_normalised == pytest.approx(4.0, rel=0.2)
        assert estimate.rejected == ()


@pytest.mark.parametrize(
    ("formulation", "weights", "prior", "cut_off"),
    [
        *((f, w, p, None) for f in ("centres", "distances") for w in ("full", "unit") for p in (True, False)),
        ("distances", "unit", False, 0.05),
    ],
)
def test_normalised_chi2_is_one_where_all_is_as_stated(
    formulation: Formulation, weights: Weights, prior: bool, cut_off: float | None
) -> None:
    """Truth, certificate and noise are drawn from their priors, with noise that differs between balls."""
    model, family = case_study(3)
    options = dataclasses.replace(PLAIN, formulation=formulation, weights=weights, use_prior=prior, cut_off=cut_off)
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        parameters = rng.normal(size=model.size) * family.prior_standard_deviation
        certified = bar(9, sigma_mm=0.8e-3)
        real = dataclasses.replace(certified, balls=certified.balls + rng.normal(0.0, 0.8e-3, (9, 3)))
        seen = measured("S1+S2+S3", 3, real, truth_of(model, parameters), rng, sigma_mm=1e-7)
        sigma_mm = rng.uniform(0.5e-3, 2e-3, seen.size)
        noise = sigma_mm[:, None] * rng.normal(size=(seen.size, 3))
        covariance = sigma_mm[:, None, None] ** 2 * np.eye(3)
        seen = dataclasses.replace(seen, axis_positions=seen.axis_positions + noise, covariance=covariance)
        found.append(identify(model, seen, certified, family, options).chi2_normalised)
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)


class TestOutliers:
    def test_gross_errors_are_named_and_nothing_else(self) -> None:
        model, family, _, truth = machine(4, 16)
        artefact = bar(11, sigma_mm=0.8e-3)
        seen = measured("S3", 4, artefact, truth, np.random.default_rng(18))
        spoilt = seen.axis_positions.copy()
        for row, slip in ((3, [0.0, 0.02, 0.0]), (5, [0.015, 0.0, 0.015]), (150, [0.0, 0.0, -0.5])):
            spoilt[row] += slip
        estimate = identify(model, dataclasses.replace(seen, axis_positions=spoilt), artefact, family)
        rows = sorted((int(seen.position[r]), int(seen.ball[r]), 0) for r in (3, 5, 150))
        assert sorted(estimate.rejected) == rows
        clean = identify(model, seen.select(~np.isin(np.arange(seen.size), (3, 5, 150))), artefact, family)
        scale = family.prior_standard_deviation
        # the search for the scales ends within about 1 % of the likeliest ones, wherever it begins
        assert estimate.parameters / scale == pytest.approx(clean.parameters / scale, abs=1e-3)
        assert np.linalg.norm(estimate.residuals_mm[150]) == pytest.approx(0.5, abs=0.01)

    def test_a_clean_set_loses_no_ball(self) -> None:
        model, family, _, truth = machine(4, 18)
        for seed in range(6):
            seen = measured("S3", 3, bar(), truth, np.random.default_rng(100 + seed))
            assert identify(model, seen, bar(), family).rejected == ()

    def test_the_wrong_artefact_is_no_matter_of_outliers(self) -> None:
        model, family, _, truth = machine(3, 19)
        seen = measured("S3", 2, bar(), truth, np.random.default_rng(20))
        wrong = dataclasses.replace(
            bar(), balls=bar().balls * [1.002, 1.0, 1.0] + np.linspace(0, 1, 33).reshape(11, 3) ** 2
        )
        with pytest.raises((DataError, SingularSet), match=r"contradict|converge"):
            identify(model, seen, wrong, family)


class TestTooLittle:
    model, family, _, truth = machine(4, 21)

    def seen(self, expression: str, stations: int, balls: int = 11) -> Observations:
        return measured(expression, stations, bar(balls), type(self).truth, np.random.default_rng(22))

    def test_one_position(self) -> None:
        seen = self.seen("S3", 1)
        with pytest.raises(SingularSet, match="1 position"):
            identify(self.model, seen.select(seen.position == 2), bar(), self.family)

    def test_two_balls(self) -> None:
        seen = self.seen("S3", 2)
        with pytest.raises(SingularSet, match="fewer than 3 different balls"):
            identify(self.model, seen.select(seen.ball < 2), bar(), self.family)

    def test_without_the_prior_the_open_directions_are_named(self) -> None:
        with pytest.raises(SingularSet, match=r"open: .*EXX\[4\].* merges|open: .*not (seen|told apart) by this set"):
            identify(self.model, self.seen("S1", 1), bar(), self.family, Options(use_prior=False))

    def test_without_the_prior_a_rich_set_is_solved(self) -> None:
        estimate = identify(self.model, self.seen("S1+S2+S3", 4), bar(), self.family, Options(use_prior=False))
        assert estimate.rank == 56
        assert len(estimate.null_directions) == self.model.size - 56
        assert not any(direction.changes_field for direction in estimate.null_directions)

    def test_a_ball_that_the_artefact_does_not_have(self) -> None:
        with pytest.raises(DataError, match="ball 7 is not on the artefact"):
            identify(self.model, self.seen("S3", 2), bar(7), self.family)

    def test_the_family_of_another_machine(self) -> None:
        with pytest.raises(DataError, match="another model"):
            identify(self.model, self.seen("S3", 2), bar(), case_study(3)[1])

    @pytest.mark.parametrize(
        "wrong",
        [
            {"formulation": "angles"},
            {"weights": "some"},
            {"outliers": "yes"},
            {"misfit_mm": -1.0},
            {"false_alarm": 2.0},
            {"formulation": "distances", "weights": "unit", "use_prior": False, "cut_off": 0.0},
            {"formulation": "distances", "weights": "unit", "cut_off": 0.01},
            {"weights": "unit", "use_prior": False, "cut_off": 0.01},
        ],
    )
    def test_options_are_checked(self, wrong: dict) -> None:
        with pytest.raises(DataError):
            Options(**wrong)


class TestDistances:
    def test_with_full_weights_a_bar_with_offset_balls_tells_the_same_as_centres(self) -> None:
        """All distances of a rigid set determine its shape, so to first order no information is lost."""
        model, family, _, truth = machine(3, 23)
        artefact = bar(7, sigma_mm=0.8e-3)
        seen = measured("S3", 3, artefact, truth, np.random.default_rng(24))
        centres, distances = (
            identify(model, seen, artefact, family, dataclasses.replace(PLAIN, formulation=name))
            for name in ("centres", "distances")
        )
        scale = family.prior_standard_deviation
        assert distances.parameters / scale == pytest.approx(centres.parameters / scale, abs=2e-3)
        assert np.diag(distances.covariance) / scale**2 == pytest.approx(
            np.diag(centres.covariance) / scale**2, abs=1e-3
        )

    def test_unit_weights_solve_the_plain_least_squares_of_distances(self) -> None:
        model, family, _, truth = machine(2, 25)
        artefact = bar(5)
        seen = measured("S3", 2, artefact, truth, np.random.default_rng(26))
        pairs = [
            (i, j) for i in range(seen.size) for j in range(i + 1, seen.size) if seen.position[i] == seen.position[j]
        ]
        points, balls = seen.axis_positions + TOOL, artefact.balls[seen.ball]
        scale = family.prior_standard_deviation

        def residuals(u: np.ndarray) -> np.ndarray:
            at = points + exact_deviation(model, seen.axis_positions, TOOL, scale * u)
            errors = [np.linalg.norm(at[i] - at[j]) - np.linalg.norm(balls[i] - balls[j]) for i, j in pairs]
            return np.concatenate((np.array(errors) / (np.sqrt(2.0) * 1e-3), u))

        reference = least_squares(residuals, np.zeros(model.size), jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        plain = dataclasses.replace(PLAIN, formulation="distances", weights="unit")
        estimate = identify(model, seen, artefact, family, plain)
        assert estimate.parameters / scale == pytest.approx(reference.x, abs=2e-4)

    def test_a_cut_off_gives_the_shortest_solution_from_the_large_singular_values(self) -> None:
        """The reference is numpy's pseudo-inverse of a Jacobian by differences of exact distances. The parameters are
        in half-widths there, in standard deviations here: a factor common to all columns changes nothing."""
        model, family, _, truth = machine(4, 27)
        artefact = bar(5)
        seen = measured("S2", 2, artefact, truth, np.random.default_rng(28), sigma_mm=1e-7)
        pairs = np.array([(i, j) for i in range(seen.size) for j in range(i) if seen.position[i] == seen.position[j]]).T
        unit = family.half_widths

        def distances(u: np.ndarray) -> np.ndarray:
            at = seen.axis_positions + TOOL + exact_deviation(model, seen.axis_positions, TOOL, unit * u)
            return np.linalg.norm(at[pairs[0]] - at[pairs[1]], axis=1)

        balls = artefact.balls[seen.ball]
        wanted = np.linalg.norm(balls[pairs[0]] - balls[pairs[1]], axis=1)
        jacobian = np.stack([(distances(10 * e) - distances(-10 * e)) / 20 for e in np.eye(model.size)], axis=1)
        published = dataclasses.replace(PLAIN, formulation="distances", weights="unit", use_prior=False, cut_off=1e-2)
        found = identify(model, seen, artefact, family, published).parameters / unit
        shortest = np.linalg.pinv(jacobian, rcond=1e-2) @ (wanted - distances(np.zeros(model.size)))
        assert found == pytest.approx(shortest, abs=1e-3)
        plain = identify(model, seen, artefact, family, dataclasses.replace(published, cut_off=None)).parameters / unit
        assert np.linalg.norm(plain) > 1.5 * np.linalg.norm(found)

    def test_a_straight_bar_never_reaches_full_rank(self) -> None:
        model, family = case_study(4, ("b0", "b1", "b2", "c0", "c1"))
        seen = measured("S1+S2+S3", 3, bar(7, 0.0), lambda X, t: np.zeros_like(X), np.random.default_rng(1))
        centres, distances = (
            identify(model, seen, bar(7, 0.0), family, dataclasses.replace(PLAIN, formulation=name))
            for name in ("centres", "distances")
        )
        assert centres.rank == 56
        assert distances.rank == 55


def test_strategies_stand_in_the_published_order() -> None:
    """Predicted VCE of a straight bar of 7 balls, 3 stations, order 4, 1 µm per coordinate."""
    model, family = case_study(4, ("b0", "b1", "b2", "c0", "c1"))
    artefact = bar(7, 0.0)

    def vce(expression: str, **changes: Any) -> float:
        seen = measured(expression, 3, artefact, lambda X, t: np.zeros_like(X), np.random.default_rng(0))
        options = dataclasses.replace(PLAIN, **changes)
        return predicted_vce(identify(model, seen, artefact, family, options), GRID, TOOL).raw_um

    expressions = ("S1", "S2", "S3", "S2+S3", "S1+S2+S3")
    distances = [vce(expression, formulation="distances") for expression in expressions]
    centres = [vce(expression) for expression in expressions]
    assert distances == sorted(distances, reverse=True)
    assert centres == sorted(centres, reverse=True)
    assert all(one < other for one, other in zip(centres, distances, strict=True))
    assert centres[2] < distances[-1]
    nothing = (
        float(
            np.sqrt(
                np.mean(np.sum((deviation_basis(model, GRID, TOOL) * family.prior_standard_deviation) ** 2, (1, 2)))
            )
        )
        * 1e3
    )
    assert vce("S2", formulation="distances", weights="unit", use_prior=False) > 1.5 * nothing > distances[0]
