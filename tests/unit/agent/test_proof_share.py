"""Share of the residuals that a new table may leave at the held-out positions."""

from __future__ import annotations

import pytest

from agent.results.estimation import allowed_share


@pytest.mark.parametrize(("predicted", "allowed"), [(0.2, 0.8), (0.8, 0.8), (0.9, 0.95), (0.96, 0.8), (1.4, 0.8)])
def test_half_of_a_small_predicted_reduction_is_demanded(predicted: float, allowed: float) -> None:
    assert allowed_share(predicted, 0.8) == pytest.approx(allowed)
