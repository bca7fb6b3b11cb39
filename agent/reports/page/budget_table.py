"""Budget of uncertainty of a run as a table: what contributes to the predicted error after compensation, and to the
expanded uncertainties of the volumetric error and of the most important geometric errors."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from agent.reports.page.data import IdentificationData
from agent.reports.page.error_curves import range_gradient
from agent.reports.page.number_format import COVERAGE, Table, fixed
from agent.reports.page.texts import Texts
from twin.arrays import Array
from twin.identification.predicted import field_forms
from twin.machine.error_model import SQUARENESS
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.posterior_budget import CENTRES, CENTRES_AND_PRIOR, INFLUENCES, PosteriorBudget, posterior_budget
from twin.units import UM_PER_MM

RANGES = ("EXX", "EYY", "EZZ")
"""Error motions whose ranges have a column of their own: those that the certificate and the temperature enter most."""


def budget_table(identification: IdentificationData, tool_offset: Array, t: Texts) -> Table:
    """Return the contribution of each influence in µm or µrad. The squares of a column add up to the square of its last
    row."""
    estimate = identification.estimate
    model, parameters = estimate.model, estimate.parameters
    budget = posterior_budget(estimate, family_prior=identification.family_prior)
    form = field_forms(estimate, evaluation_grid(model.ranges_mm), tool_offset)[1]
    columns = {t["budget_vce"]: _in_um(budget.remaining_rms(form))}
    # VE is the root of the mean square over the workspace; its gradient is Q E / VE
    whole = budget.expected.copy()
    whole[: model.size] = parameters
    size_mm = float(np.sqrt(max(float(whole @ form @ whole), 1e-24)))
    columns[t["budget_ve"]] = _expanded(budget, form @ whole / size_mm, UM_PER_MM)
    for name in RANGES:
        if (gradient := range_gradient(model, parameters, estimate.covariance, name)) is not None:
            columns[f"U({name}) / µm"] = _expanded(budget, _padded(gradient, budget), UM_PER_MM)
    for name in SQUARENESS:
        if name in model.names:
            gradient = np.zeros(model.size)
            gradient[model.index(name)] = 1.0
            columns[f"U({name}) / µrad"] = _expanded(budget, _padded(gradient, budget), 1e6)
    shown = [name for name in INFLUENCES if any(column.get(name, 0.0) >= 0.005 for column in columns.values())]
    joined = any(check.joined for check in estimate.instruments)
    rows = [(t[_influence(name, joined)], *(_cell(column, name) for column in columns.values())) for name in shown]
    rows.append((t["combined"], *(fixed(float(np.hypot.reduce([*c.values()])), 2) for c in columns.values())))
    return Table((t["influence"], *columns), tuple(rows), tuple(columns))


def _influence(name: str, joined: bool) -> str:
    """Return the key of the text of an influence. The noise of joined instruments is in the same row as that of the
    ball centres."""
    return f"influence {name}, joined" if joined and name in (CENTRES, CENTRES_AND_PRIOR) else f"influence {name}"


def _in_um(values: Mapping[str, float]) -> dict[str, float]:
    return {name: UM_PER_MM * value for name, value in values.items()}


def _expanded(budget: PosteriorBudget, gradient: Array, scale: float) -> dict[str, float]:
    found = budget.standard_uncertainties(gradient)
    return {name: COVERAGE * scale * value for name, value in found.items()}


def _padded(gradient: Array, budget: PosteriorBudget) -> Array:
    """Return the gradient with zeros for the misfit coefficients."""
    return np.concatenate((gradient, np.zeros(len(budget.expected) - len(gradient))))


def _cell(column: Mapping[str, float], name: str) -> str:
    return fixed(column[name], 2) if name in column else "–"
