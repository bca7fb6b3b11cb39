"""Virtual instruments confirm predictions on machines that share no code with the program, and a wrong one does not."""

from __future__ import annotations

import numpy as np

from campaigns.instruments.trials import one_machine

MACHINES = 3
WRONG_SCALE = 8e-6


def test_predictions_agree_with_the_instruments() -> None:
    """114 figures of three machines, of which those of one machine are correlated: the bound is wide."""
    figures = [figure for number in range(1, 1 + MACHINES) for figure in one_machine("mixed", number).figures]
    assert np.mean([figure.agrees for figure in figures]) > 0.88
    # rightly stated uncertainties give scores of 0.5, too large ones give smaller scores
    assert 0.3 < float(np.sqrt(np.mean([figure.en**2 for figure in figures]))) < 0.75


def test_a_wrong_laser_shows() -> None:
    found = one_machine("mixed", 1, WRONG_SCALE)
    laser = [one for one in found.figures if one.test.test.standard in ("ISO 230-2", "ISO 230-6")]
    others = [one for one in found.figures if one not in laser]
    assert np.mean([figure.agrees for figure in laser]) < 0.5
    assert np.mean([figure.agrees for figure in others]) > 0.8
    assert found.contradicts
