"""Nights on a machine that drifts in other ways than the program assumes: what is predicted stays true, and a night
that does not fit is named."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from foreign_nights import (
    NIGHTS,
    STATED_UM,
    STEP_NIGHT,
    Change,
    NightScore,
    fused_nights,
    one_axis_only,
    season,
    straightness_steps,
)

WINDOW = 10


def window_means(nights: list[NightScore]) -> np.ndarray:
    return np.array([night.ratio for night in nights]).reshape(-1, WINDOW).mean(axis=1)


def told(change: Change, nights: list[NightScore]) -> str:
    worst = max(nights, key=lambda night: night.ratio)
    return (
        f"{change.__name__}: true/predicted {np.round(window_means(nights), 2)}, worst night {worst.number}: "
        f"{worst.true_um:.2f} µm against {worst.predicted_um:.2f} predicted ({worst.ratio:.2f}); "
        f"not fitting: {[night.number for night in nights if not night.fit.fits]}; "
        f"drift factor {nights[-1].fit.factor:.2f}"
    )


@pytest.mark.parametrize("change", [straightness_steps, season, one_axis_only])
def test_sixty_nights_stay_truthful(change: Change, record_property: Callable[[str, object], None]) -> None:
    nights = fused_nights(change)
    summary = told(change, nights)
    record_property("nights", summary)
    assert len(nights) == NIGHTS
    means = window_means(nights)
    assert ((means > 0.5) & (means < 1.33)).all(), summary
    assert 0.75 < means.mean() < 1.33, summary
    calm = [night for night in nights if not (change is straightness_steps and night.number == STEP_NIGHT)]
    assert max(night.ratio for night in calm) < 1.6, summary
    not_fitting = [night.number for night in nights if not night.fit.fits]
    assert len([number for number in not_fitting if number != STEP_NIGHT]) <= 2, summary
    assert change is not straightness_steps or STEP_NIGHT in not_fitting, summary


def test_a_drift_larger_than_stated_is_learned() -> None:
    nights = fused_nights(season)
    assert np.median([night.fit.factor for night in nights[10:]]) > 2.0
    quiet = fused_nights(straightness_steps, STEP_NIGHT - 1, stated_um=4.0 * STATED_UM)
    assert quiet[-1].fit.factor < 0.5
