"""Agreement of a predicted figure with a measured one, judged by the E_n score of ISO 13528:2022, 9.7, and ISO/IEC
17043.

The difference is compared with the expanded uncertainties of both sides (k = 2). Where both are stated rightly, about
one score in twenty is larger than 1.
"""

from __future__ import annotations

import math

from twin.errors import DataError

EN_LIMIT = 1.0
"""Largest magnitude of the score of figures that agree."""


def en_score(predicted: float, predicted_expanded: float, measured: float, measured_expanded: float) -> float:
    """Return E_n = (predicted - measured) / sqrt(U_p² + U_m²), in one unit for all four values.

    Raises DataError unless the expanded uncertainties are at least 0 and one of them is above 0.
    """
    if not min(predicted_expanded, measured_expanded) >= 0.0:
        raise DataError("an expanded uncertainty cannot be negative")
    both = math.hypot(predicted_expanded, measured_expanded)
    if both == 0.0:
        raise DataError("two figures without uncertainty cannot be compared")
    return (predicted - measured) / both


def agrees(score: float) -> bool:
    """Return True if an E_n score shows no disagreement."""
    return abs(score) <= EN_LIMIT
