"""Share of the residuals that a new table may leave at the held-out positions."""

from __future__ import annotations

import pytest

from agent.results.estimation import allowed_share


@pytest.mark.parametrize(("predicted", "allowed"), [(0.2, 0.8), (0.8, 0.8), (0.81, 1.0), (1.4, 1.0)])
def test_a_limit_that_the_prediction_itself_exceeds_is_no_limit(predicted: float, allowed: float) -> None:
    assert allowed_share(predicted, 0.8) == allowed
