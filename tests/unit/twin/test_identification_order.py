"""Order by evidence: evidence differences equal those of dense normal densities of the same equations."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from measured_set import AMPLITUDES, TOOL, bar, case_study, measured
from scale_prior import prior_of_logs
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

from twin.artefact.observations import Observations
from twin.errors import DataError
from twin.identification import Options, identify, identify_by_evidence
from twin.identification.misfit import misfit_modes
from twin.identification.problem import build_problem
from twin.identification.solution import log_evidence_and_scales
from twin.machine.forward_model import deviation_basis, exact_deviation
from twin.machine.machine_population import Family, family_from_amplitudes

ARTEFACT = bar(7, sigma_mm=0.8e-3)


def family_of(order: int) -> Family:
    return case_study(order)[1]


def seen_of(order: int, seed: int, expression: str = "S3", stations: int = 2) -> Observations:
    family = family_of(order)
    parameters = family.draw(np.random.default_rng(seed), 1)[0]
    rng = np.random.default_rng(seed + 1)
    return measured(
        expression, stations, ARTEFACT, lambda X, tool: exact_deviation(family.model, X, tool, parameters), rng
    )


def stationary_columns(family: Family, seen: Observations, scales: Sequence[float]) -> np.ndarray:
    """Return columns (n, 3, m) whose sum of squares is the covariance of the stationary part of all error motions, with
    the scales of X, Y and Z.

    The integrals of the Matérn kernel with the Legendre polynomials are taken by the midpoint rule.
    """
    u = (np.arange(600) + 0.5) / 300.0 - 1.0
    distance = np.sqrt(3.0) * np.abs(u[:, None] - u) / 1.0
    kernel = (1.0 + distance) * np.exp(-distance)
    basis, sd = deviation_basis(family.model, seen.axis_positions, TOOL), family.prior_standard_deviation
    found = []
    for error in (f"E{direction}{axis}" for axis in "XYZ" for direction in "XYZABC"):
        here = [row for row, name in enumerate(family.model.names) if name.startswith(f"{error}[")]
        orders = np.array([int(family.model.names[row][4:-1]) for row in here])
        if not len(orders):
            continue
        polynomials = np.stack([np.polynomial.legendre.Legendre.basis(order)(u) for order in orders])
        weights = polynomials * ((2 * orders + 1) / 2.0)[:, None] / 300.0
        covariance = weights @ kernel @ weights.T
        squares = 1.0 / (2.0 * orders + 1.0)
        covariance *= 0.25 * (squares @ sd[here] ** 2) / (squares @ np.diag(covariance))
        found.append(scales["XYZ".index(error[2])] * basis[:, :, here] @ np.linalg.cholesky(covariance))
    return np.concatenate(found, axis=2)


def dense_log_evidence(order: int, seen: Observations, scales: tuple[float, ...]) -> float:
    """Return the log normal density of the residuals with the poses projected out, in one matrix over all balls."""
    family = family_of(order)
    points = seen.axis_positions + TOOL
    stationary, independent = scales[6:9], scales[9:12]
    factors = [independent["XYZ".index(name[2])] if name.startswith("E") else scales[1] for name in family.model.names]
    deviations = family.prior_standard_deviation * factors
    columns = [deviation_basis(family.model, seen.axis_positions, TOOL) * deviations]
    modes = misfit_modes(family.model, tuple(TOOL.tolist()))
    columns.append(1e-3 * modes.at(seen.axis_positions) * np.repeat(scales[2:6], modes.sizes))
    columns.append(stationary_columns(family, seen, stationary))
    certificate, residual, kept = np.zeros((seen.size, 3, 21)), np.zeros((seen.size, 3)), []
    for position in np.unique(seen.position):
        here = np.flatnonzero(seen.position == position)
        nominal, found = ARTEFACT.balls[seen.ball[here]], points[here]
        arms, middle = nominal - nominal.mean(axis=0), found - found.mean(axis=0)
        left, _, right = np.linalg.svd(arms.T @ middle)
        turn = right.T @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ left.T
        residual[here] = arms @ turn.T - middle
        for row, ball in zip(here, seen.ball[here], strict=True):
            certificate[row, :, 3 * ball : 3 * ball + 3] = -0.8e-3 * turn
        motion = np.zeros((seen.size, 3, 6))
        motion[here, :, :3] = np.eye(3)
        motion[here, :, 3:] = -np.cross(np.eye(3), middle[:, None, :] / 500.0).transpose(0, 2, 1)
        kept.append(motion.reshape(-1, 6))
    design = np.concatenate((*columns, certificate), axis=2).reshape(3 * seen.size, -1)
    free = null_space(np.concatenate(kept, axis=1).T).T
    covariance = free @ (design @ design.T + (1e-3 * scales[0]) ** 2 * np.eye(len(design))) @ free.T
    density = multivariate_normal.logpdf(free @ residual.reshape(-1), np.zeros(len(free)), covariance)
    return float(density) - 0.5 * float(np.log(scales) @ prior_of_logs() @ np.log(scales))


def test_evidence_of_orders_differs_as_the_dense_densities_do() -> None:
    seen = seen_of(4, 1, stations=4)
    ours, dense = [], []
    for order in (2, 4, 6):
        problem = build_problem(family_of(order), seen, ARTEFACT, Options())
        evidence, scales = log_evidence_and_scales(problem, Options())
        ours.append(evidence)
        dense.append(dense_log_evidence(order, seen, scales.values))
    assert np.ptp(dense) > 3.0
    assert np.diff(ours) == pytest.approx(np.diff(dense), abs=1e-3)


def test_the_chosen_order_is_the_highest_without_very_strong_evidence_against_it() -> None:
    estimate = identify_by_evidence(family_of, seen_of(6, 3, "S1+S2+S3", 4), ARTEFACT, candidates=(2, 4, 3, 7))
    table = {entry.order: entry for entry in estimate.order_evidence}
    assert list(table) == [2, 3, 4, 7]
    assert max(entry.relative_log for entry in table.values()) == 0.0
    assert [order for order, entry in table.items() if entry.chosen] == [7]
    assert estimate.model == case_study(7)[0]
    assert table[2].relative_log < -5.0


def test_a_family_that_does_not_fall_off_gets_no_higher_order_than_the_machine_has() -> None:
    """Without the falling prior a higher order would follow noise, and the evidence then speaks against it."""
    flat: dict[str, float | list[float]] = {
        **AMPLITUDES,
        "decay": 1.0,
        "positioning_um": [8.0, 5.0, 3.0],
        "rotation_urad": [4.6, 2.8, 2.0],
    }
    flat["straightness_um"] = [5.5, 3.3]
    estimate = identify_by_evidence(
        lambda order: family_from_amplitudes(case_study(order)[0], flat),
        seen_of(4, 2, "S1+S2+S3", 4),
        ARTEFACT,
        candidates=(2, 4, 6, 9),
    )
    assert estimate.model.highest_order == (4, 4, 4)
    assert estimate.order_evidence[-1].relative_log < -10.0


def test_it_is_the_estimate_of_that_order_and_of_the_balls_kept() -> None:
    seen = seen_of(4, 5, stations=4)
    shuffled = seen.select(np.random.default_rng(0).permutation(seen.size))
    spoilt = shuffled.axis_positions.copy()
    spoilt[17] += [0.0, 0.05, 0.0]
    given = dataclasses.replace(shuffled, axis_positions=spoilt)
    estimate = identify_by_evidence(family_of, given, ARTEFACT, candidates=(3, 4))
    row = (int(given.position[17]), int(given.ball[17]), 0)
    assert estimate.rejected == (row,)
    clean = given.select(np.arange(given.size) != 17)
    model, family = estimate.model, family_of(estimate.model.highest_order[0])
    alone = identify(model, clean, ARTEFACT, family, Options(outliers="none"))
    scale = family.prior_standard_deviation
    assert estimate.parameters / scale == pytest.approx(alone.parameters / scale, abs=1e-4)
    assert np.linalg.norm(estimate.residuals_mm[17]) == pytest.approx(0.05, abs=0.01)


def test_published_equations_take_the_order_that_ball_centres_speak_for() -> None:
    seen = seen_of(4, 7, stations=4)
    centres = identify_by_evidence(family_of, seen, ARTEFACT, candidates=(3, 5))
    unit = Options(formulation="distances", weights="unit")
    distances = identify_by_evidence(family_of, seen, ARTEFACT, unit, candidates=(3, 5))
    assert distances.formulation == "distances"
    assert [entry.relative_log for entry in distances.order_evidence] == [
        entry.relative_log for entry in centres.order_evidence
    ]


def test_where_there_is_nothing_to_compare() -> None:
    seen = seen_of(3, 9)
    known = identify(case_study(3)[0], seen, ARTEFACT, family_of(3)).carried_over()
    for options in (Options(use_prior=False), Options(carried_over=known)):
        with pytest.raises(DataError, match="family as prior"):
            identify_by_evidence(family_of, seen, ARTEFACT, options)
    with pytest.raises(DataError, match="no order"):
        identify_by_evidence(family_of, seen, ARTEFACT, candidates=())


class TestBadPrior:
    seen = seen_of(3, 11)

    def test_a_family_of_zeros(self) -> None:
        model, family = case_study(3)
        nothing = Family(model, 0.0 * family.half_widths)
        for act in (
            lambda: identify(model, self.seen, ARTEFACT, nothing),
            lambda: identify(
                model, self.seen, ARTEFACT, family, Options(prior_standard_deviation=np.zeros(model.size))
            ),
            lambda: identify_by_evidence(lambda _: nothing, self.seen, ARTEFACT, candidates=(3,)),
        ):
            with pytest.raises(DataError, match="nothing to identify"):
                act()

    def test_a_negative_one_names_the_parameter(self) -> None:
        model, family = case_study(3)
        wrong = family.prior_standard_deviation
        wrong[4] *= -1.0
        with pytest.raises(DataError, match="negative") as caught:
            identify(model, self.seen, ARTEFACT, family, Options(prior_standard_deviation=wrong))
        assert caught.value.where["parameter"] == model.names[4]

    @pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.diag([1e-6, 1e-6, 0.0]), np.diag([1e-6, -1e-6, 1e-6])])
    def test_a_covariance_that_is_none_names_the_row(self, bad: np.ndarray) -> None:
        covariance = self.seen.covariance.copy()
        covariance[9] = bad
        with pytest.raises(DataError, match="positive definite") as caught:
            dataclasses.replace(self.seen, covariance=covariance)
        assert caught.value.where["row"] == "9"


def test_a_scale_at_its_bound_is_named() -> None:
    seen = seen_of(3, 13, stations=4)
    quiet = dataclasses.replace(seen, covariance=seen.covariance * 1e4)
    model, family = case_study(3)
    estimate = identify(model, quiet, ARTEFACT, family, Options(outliers="none"))
    assert any(text.startswith("touch noise: 0.3 times") for text in estimate.scales_at_bounds)
    assert identify(model, seen, ARTEFACT, family).scales_at_bounds == ()
