"""Closed form against simulations of whole procedures in plain numpy, with a truth richer than the model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from measured_set import RANGES, TOOL, bar, case_study, measured

from twin.artefact.artefact import Artefact
from twin.artefact.observations import Observations
from twin.errors import DataError, ModelError
from twin.identification import identify
from twin.identification.options import Options
from twin.machine.deflection import CASE_STUDY_NODES, cantilever_deflection
from twin.machine.error_model import motion_uncertainty
from twin.machine.forward_model import exact_deviation
from twin.machine.machine_population import Family
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.error_budget import INFLUENCES, ErrorBudget, error_budget, error_budget_of_form
from twin.uncertainty.residual_field_form import FieldForm
from twin.uncertainty.truth_assumptions import TruthAssumptions

GRID = evaluation_grid(RANGES, (7, 5, 5))
DEFLECTION = cantilever_deflection(*CASE_STUDY_NODES)
COVARIANCE = np.diag([1.0e-3, 0.6e-3, 1.2e-3]) ** 2
FIXED = Options(estimate_scales=False, outliers="none", temperature_standard_uncertainty_k=0.3)
PUBLISHED = replace(FIXED, formulation="distances", weights="unit", use_prior=False)
FAMILIES = {order: case_study(order)[1] for order in (3, 4, 5, 7)}
TRUE_FAMILY = FAMILIES[7]
NOBODY = Family(TRUE_FAMILY.model, np.zeros(TRUE_FAMILY.model.size))
NOTHING = TruthAssumptions(NOBODY, touch_noise=False, certificate=False, cte=False)
EVERYTHING = TruthAssumptions(
    TRUE_FAMILY, DEFLECTION, artefact_temperature_c=26.0, thermometer_uncertainty_k=0.3, drift_mm=1.5e-3
)
MILD = replace(EVERYTHING, artefact_temperature_c=22.0, thermometer_uncertainty_k=0.1)
"""All influences except single ones that would dominate the mean of a few squares."""


@dataclass(frozen=True)
class Case:
    order: int
    expression: str
    options: Options

    @property
    def family(self) -> Family:
        return FAMILIES[self.order]


CENTRES = Case(5, "S3", FIXED)
DISTANCES = Case(3, "S1+S3", PUBLISHED)


def certified() -> Artefact:
    return bar(7, 15.0, 0.8e-3, cte_standard_uncertainty_per_k=0.5e-6)


def without_errors(at: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.zeros_like(at)


def planned(case: Case) -> Observations:
    """Return the observations of an error-free machine at the reference temperature."""
    seen = measured(case.expression, 3, certified(), without_errors, np.random.default_rng(0), sigma_mm=0.0)
    return replace(seen, covariance=np.tile(COVARIANCE, (seen.size, 1, 1)))


def closed(case: Case, assumptions: TruthAssumptions) -> ErrorBudget:
    family = case.family
    return error_budget(family.model, family, certified(), planned(case), case.options, assumptions, GRID, TOOL)


def night(case: Case, assumptions: TruthAssumptions, rng: np.random.Generator) -> tuple[float, float]:
    """Return the mean square VCE, raw and aligned, of one machine after one simulated procedure."""
    parameters = assumptions.family.draw(rng, 1)[0]

    def truth(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        bent = 0.0 if assumptions.deflection is None else assumptions.deflection.at(np.clip(at, *np.array(RANGES).T))
        return exact_deviation(assumptions.family.model, at, tool, parameters) + bent

    seen = simulated(case, assumptions, truth, rng)
    estimate = identify(case.family.model, seen, certified(), case.family, case.options)
    left = truth(GRID, TOOL) - exact_deviation(case.family.model, GRID, TOOL, estimate.parameters)
    return mean_square(left), mean_square(without_rigid_motion(left))


def simulated(case: Case, assumptions: TruthAssumptions, truth, rng: np.random.Generator) -> Observations:
    stated = certified()
    slip = rng.normal(0.0, 0.8e-3, stated.balls.shape) * assumptions.certificate
    cte = stated.cte_per_k + rng.normal(0.0, stated.cte_standard_uncertainty_per_k) * assumptions.cte
    real = replace(stated, balls=stated.balls + slip, cte_per_k=cte)
    real_c = assumptions.artefact_temperature_c + rng.normal(0.0, 1.0) * assumptions.thermometer_uncertainty_k
    seen = measured(case.expression, 3, real, without_errors, rng, sigma_mm=0.0, temperature_c=real_c)
    nominal = seen.axis_positions
    found = nominal - truth(nominal - truth(nominal, TOOL), TOOL)
    found += rng.normal(0.0, np.sqrt(np.diagonal(COVARIANCE)), (seen.size, 3)) * assumptions.touch_noise
    for position in np.unique(seen.position):
        rows = np.flatnonzero(seen.position == position)
        found[rows] += np.linspace(0.0, 1.0, len(rows))[:, None] * rng.normal(0.0, assumptions.drift_mm, 3)
    return replace(
        seen,
        axis_positions=found,
        covariance=np.tile(COVARIANCE, (seen.size, 1, 1)),
        temperature_c=np.full(seen.size, assumptions.artefact_temperature_c),
    )


def mean_square(field: np.ndarray) -> float:
    return float((field**2).sum(axis=1).mean())


def without_rigid_motion(field: np.ndarray) -> np.ndarray:
    arms = (GRID - GRID.mean(axis=0)) / 1000.0
    motions = np.zeros((len(GRID), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        motions[:, :, 3 + k] = np.cross(axis, arms)
    flat = motions.reshape(-1, 6)
    return field - (flat @ np.linalg.lstsq(flat, field.reshape(-1), rcond=None)[0]).reshape(-1, 3)


def agree(case: Case, assumptions: TruthAssumptions, nights: int, seed: int = 1) -> np.ndarray:
    """Check the mean of the simulated squares within three of its standard deviations."""
    children = np.random.SeedSequence(seed).spawn(nights)
    squares = np.array([night(case, assumptions, np.random.default_rng(child)) for child in children])
    expected = closed(case, assumptions).expected
    for found, wanted in zip(squares.T, (expected.raw_mm**2, expected.aligned_mm**2), strict=True):
        doubt = found.std(ddof=1) / np.sqrt(nights)
        assert abs(found.mean() - wanted) < 3.0 * doubt, (found.mean() / wanted, doubt / wanted)
        assert doubt < 0.12 * wanted
    return squares


@pytest.mark.parametrize("case", [CENTRES, DISTANCES], ids=["centres", "distances, unit weights, no prior"])
def test_the_closed_form_agrees_with_whole_procedures(case: Case) -> None:
    """The mean square agrees, half of the machines lie above the median, and one in twenty outside the 95 % limits."""
    raw, aligned = np.sqrt(agree(case, EVERYTHING, 150)).T
    distribution = closed(case, EVERYTHING).distribution
    low, high = distribution.limits(0.95)
    assert distribution.expected.raw_mm == pytest.approx(closed(case, EVERYTHING).expected.raw_mm, rel=1e-9)
    for found, one in ((raw, "raw_mm"), (aligned, "aligned_mm")):
        assert np.mean(found > getattr(distribution.median, one)) == pytest.approx(0.5, abs=3.0 * 0.5 / np.sqrt(150))
        inside = (found > getattr(low, one)) & (found < getattr(high, one))
        assert np.mean(inside) == pytest.approx(0.95, abs=3.0 * 0.218 / np.sqrt(150))


MIXED = [
    Case(4, "S1+S2", replace(FIXED, formulation="distances")),
    Case(4, "S3", replace(FIXED, weights="unit")),
    Case(3, "S1+S3", replace(FIXED, use_prior=False)),
    Case(4, "S3", replace(PUBLISHED, cut_off=0.02)),
]


@pytest.mark.parametrize("case", MIXED, ids=["distances, full", "centres, unit", "centres, no prior", "cut-off"])
def test_it_holds_for_every_way_of_identifying(case: Case) -> None:
    agree(case, MILD, 60)


def only_within(model_names: tuple[str, ...], inside: bool) -> Family:
    """Return the true family restricted to the model's parameters, or to all others."""
    chosen = np.array([(name in model_names) == inside for name in TRUE_FAMILY.model.names])
    return Family(TRUE_FAMILY.model, TRUE_FAMILY.half_widths * chosen)


OWN_NAMES = case_study(5)[0].names
ALONE = {
    "touch noise": replace(NOTHING, touch_noise=True),
    "certificate": replace(NOTHING, certificate=True),
    "CTE": replace(NOTHING, cte=True, artefact_temperature_c=26.0),
    "temperature": replace(NOTHING, thermometer_uncertainty_k=0.3),
    "drift": replace(NOTHING, drift_mm=1.5e-3),
    "unseen": replace(NOTHING, family=only_within(OWN_NAMES, inside=True)),
    "misfit": replace(NOTHING, family=only_within(OWN_NAMES, inside=False), deflection=DEFLECTION),
}


@pytest.mark.parametrize("name", ALONE)
def test_each_contribution_is_what_it_is_alone(name: str) -> None:
    agree(CENTRES, ALONE[name], 150 if name in ("CTE", "temperature") else 40)
    budget = closed(CENTRES, ALONE[name])
    assert budget.contributions[name] == pytest.approx(budget.expected)
    assert all(part.raw_mm == 0.0 for other, part in budget.contributions.items() if other != name)


def test_a_contribution_is_the_same_in_company() -> None:
    whole = closed(CENTRES, EVERYTHING).contributions
    assert tuple(whole) == INFLUENCES
    for name, assumptions in ALONE.items():
        warm = replace(assumptions, artefact_temperature_c=26.0)
        alone = closed(CENTRES, warm).contributions[name]
        assert whole[name].raw_mm == pytest.approx(alone.raw_mm, rel=1e-9)
        assert whole[name].aligned_mm == pytest.approx(alone.aligned_mm, rel=1e-9)
    assert whole["mount"].raw_mm == 0.0


def test_squares_add_up() -> None:
    budget = closed(DISTANCES, EVERYTHING)
    parts = budget.contributions.values()
    assert sum(part.raw_mm**2 for part in parts) == pytest.approx(budget.expected.raw_mm**2)
    assert sum(part.aligned_mm**2 for part in parts) == pytest.approx(budget.expected.aligned_mm**2)


def test_a_fixed_deflection_is_a_bias_and_not_a_spread() -> None:
    """Compare with a single noiseless identification, to nanometres."""
    assumptions = replace(NOTHING, deflection=DEFLECTION)
    raw, aligned = night(CENTRES, assumptions, np.random.default_rng(0))
    expected = closed(CENTRES, assumptions).expected
    assert np.sqrt(raw) == pytest.approx(expected.raw_mm, abs=5e-6)
    assert np.sqrt(aligned) == pytest.approx(expected.aligned_mm, abs=5e-6)


def test_before_is_the_mean_square_of_the_family() -> None:
    rng = np.random.default_rng(3)
    squares = []
    for _ in range(400):
        parameters = TRUE_FAMILY.draw(rng, 1)[0]
        field = exact_deviation(TRUE_FAMILY.model, GRID, TOOL, parameters) + DEFLECTION.at(GRID)
        squares.append((mean_square(field), mean_square(without_rigid_motion(field))))
    before = closed(CENTRES, EVERYTHING).uncompensated
    for found, wanted in zip(np.transpose(squares), (before.raw_mm**2, before.aligned_mm**2), strict=True):
        assert found.mean() == pytest.approx(wanted, abs=3.0 * found.std() / 20.0)


def test_the_map_holds_what_the_expected_error_says() -> None:
    budget = closed(CENTRES, EVERYTHING)
    raw, aligned = budget.field_uncertainty(GRID), budget.field_uncertainty(GRID, aligned=True)
    assert np.sqrt(mean_square(raw)) == pytest.approx(budget.expected.raw_mm, rel=1e-9)
    assert np.sqrt(mean_square(aligned)) == pytest.approx(budget.expected.aligned_mm, rel=1e-9)


def test_parameters_are_as_uncertain_as_simulated() -> None:
    assumptions = replace(EVERYTHING, drift_mm=0.0)
    squares = []
    for child in np.random.SeedSequence(5).spawn(60):
        rng = np.random.default_rng(child)
        parameters = assumptions.family.draw(rng, 1)[0]
        seen = simulated(
            CENTRES,
            assumptions,
            lambda at, tool, p=parameters: (
                exact_deviation(TRUE_FAMILY.model, at, tool, p) + DEFLECTION.at(np.clip(at, *np.array(RANGES).T))
            ),
            rng,
        )
        estimate = identify(CENTRES.family.model, seen, certified(), CENTRES.family, FIXED)
        truth = dict(zip(TRUE_FAMILY.model.names, parameters, strict=True))
        own = np.array([truth[name] for name in OWN_NAMES])
        squares.append((own - estimate.parameters) ** 2)
    ratio = np.mean(squares, axis=0) / closed(CENTRES, assumptions).parameter_uncertainty() ** 2
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    assert (np.abs(ratio - 1.0) < 5.0 * np.sqrt(2.0 / 60.0)).all()


def test_error_motions_are_as_uncertain_as_their_curves() -> None:
    """Compare with the curve of each error motion over its axis, from random coefficients."""
    model, family = FAMILIES[4].model, FAMILIES[4]
    factor = family.prior_standard_deviation[:, None] * np.random.default_rng(6).normal(size=(model.size, model.size))
    found = motion_uncertainty(model, factor @ factor.T)
    at = np.linspace(-1.0, 1.0, 4001)
    for error in ("EXX", "EZX", "ECY"):
        first = 2 if error == "EZX" else 1
        coefficients = factor[[model.index(f"{error}[{order}]") for order in range(first, 5)]]
        curves = np.polynomial.legendre.legval(at, np.vstack((np.zeros((first, model.size)), coefficients)))
        assert found[error] == pytest.approx(np.sqrt((curves**2).sum(axis=0).mean()), rel=1e-3)
    assert found["B0Z"] == pytest.approx(np.linalg.norm(factor[model.index("B0Z")]))
    assert len(found) == 21
    with pytest.raises(DataError, match="shape"):
        motion_uncertainty(model, np.eye(3))


def test_the_model_may_hold_more_than_the_machines_do() -> None:
    """Truth of order 3, model of order 5: the model represents every machine."""
    simple = FAMILIES[3]
    budget = closed(CENTRES, replace(NOTHING, family=simple))
    assert budget.contributions["misfit"].raw_mm == 0.0
    agree(CENTRES, replace(NOTHING, family=simple, touch_noise=True), 30)


@pytest.mark.parametrize("name", ["EAY[1]", "ECY[2]", "EZX[3]"])
def test_with_two_tools_each_parameter_is_left_as_one_identification_leaves_it(name: str) -> None:
    tools = (TOOL, np.array([0.0, 400.0, 60.0]))
    prior, model = CENTRES.family, CENTRES.family.model
    alone = Family(model, prior.half_widths * np.array([other == name for other in model.names]))
    parameters = alone.prior_standard_deviation

    def truth(at: np.ndarray, tool: np.ndarray) -> np.ndarray:
        return exact_deviation(model, at, tool, parameters)

    rng = np.random.default_rng(8)
    seen = measured("S3", 2, certified(), truth, rng, sigma_mm=0.0, tools=tools)
    seen = replace(seen, covariance=np.tile(COVARIANCE, (seen.size, 1, 1)))
    estimate = identify(model, seen, certified(), prior, FIXED)
    left = truth(GRID, TOOL) - exact_deviation(model, GRID, TOOL, estimate.parameters)
    budget = error_budget(model, prior, certified(), seen, FIXED, replace(NOTHING, family=alone), GRID, TOOL)
    assert budget.expected.raw_mm == pytest.approx(np.sqrt(mean_square(left)), abs=2e-6)


def test_the_day_makes_the_artefact_as_warm_as_reality_says() -> None:
    """The truth assumptions set the temperature, not the planned rows."""
    assumptions = replace(NOTHING, cte=True, artefact_temperature_c=26.0)
    seen = planned(CENTRES)
    family = CENTRES.family
    form = FieldForm.build(family.model, assumptions, GRID, TOOL)
    cold = error_budget_of_form(form, family, certified(), seen, FIXED)
    hot = error_budget_of_form(form, family, certified(), replace(seen, temperature_c=np.full(seen.size, 26.0)), FIXED)
    assert cold.expected == hot.expected
    assert cold.expected.raw_mm > 0.0


def test_machines_of_another_chain_are_refused() -> None:
    model, family = case_study(5)
    other = replace(model, ranges_mm=((0.0, 3000.0), *RANGES[1:]))
    assumptions = TruthAssumptions(Family(other, family.half_widths))
    with pytest.raises(ModelError, match="axis ranges"):
        FieldForm.build(model, assumptions, GRID, TOOL)


def test_an_estimate_carried_over_is_refused() -> None:
    model, family = case_study(5)
    rng = np.random.default_rng(2)
    seen = simulated(CENTRES, replace(NOTHING, touch_noise=True), without_errors, rng)
    estimate = identify(model, seen, certified(), family, FIXED)
    options = replace(FIXED, carried_over=estimate.carried_over())
    with pytest.raises(DataError, match="carried over"):
        error_budget(model, family, certified(), planned(CENTRES), options, NOTHING, GRID, TOOL)


def test_the_prior_of_another_model_is_refused() -> None:
    model, _ = case_study(5)
    with pytest.raises(DataError, match="another model"):
        error_budget(model, TRUE_FAMILY, certified(), planned(CENTRES), FIXED, NOTHING, GRID, TOOL)
