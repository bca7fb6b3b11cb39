"""Cells with predicted errors in the tables of `volcal predict` and `volcal acceptance`."""

from __future__ import annotations

from twin.units import UM_PER_MM
from twin.workpiece.features import Feature, Measure
from twin.workpiece.prediction import FeatureError

UNCERTAINTY_HEADING = "U (k = 2), or limits (95 %)"


def error_cells(feature: Feature, error: FeatureError) -> list[str]:
    """Return the expected error in µm and, as text, its uncertainty.

    An error with a sign has the expanded uncertainty. The distribution of an error that cannot be negative is not
    symmetric: its limits are stated.
    """
    expected = UM_PER_MM * error.expected_mm
    if feature.measure is Measure.SIGNED:
        return [f"{expected:+.2f}", f"± {UM_PER_MM * error.expanded_mm:.2f}"]
    return [f"{expected:.2f}", f"{UM_PER_MM * error.low_mm:.2f} … {UM_PER_MM * error.high_mm:.2f}"]
