"""Table of the predicted figures of acceptance tests (ISO 230), without and with the table of the estimate."""

from __future__ import annotations

from agent.reports.page.number_format import Table, fixed
from agent.reports.page.texts import Texts
from agent.workpiece.predicted_tests import PredictedTests
from twin.units import UM_PER_MM
from twin.workpiece.features import Measure
from twin.workpiece.prediction import FeatureError


def acceptance_table(predicted: PredictedTests, t: Texts) -> Table:
    """Return one row for each figure, in µm, with U (k = 2) or the 95 % limits of a range. The columns of a machine
    with its table are left out if no table was predicted."""
    states = ["without"] if predicted.table is None else ["without", "with"]
    columns = [t[f"{name}_{state}"] for state in states for name in ("value", "limits")]
    heads = (t["figure"], t["meaning"], t["standard"], *columns)
    rows = []
    for one in predicted.all_tests:
        errors = (one.figure.without_table, one.figure.with_table)[: len(states)]
        cells = [cell for error in errors if error is not None for cell in _cells(one.test.feature.measure, error)]
        rows.append((one.test.feature.name, one.test.title, one.test.standard, *cells))
    return Table(heads, tuple(rows), heads[3:], code=(t["standard"],))


def _cells(measure: Measure, error: FeatureError) -> tuple[str, str]:
    value, low, high, doubt = (
        fixed(UM_PER_MM * one, 1) for one in (error.expected_mm, error.low_mm, error.high_mm, error.expanded_mm)
    )
    return value, f"± {doubt}" if measure is Measure.SIGNED else f"{low} … {high}"
