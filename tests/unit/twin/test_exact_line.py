"""Balls on an exact line, as a nominal artefact file states them: nothing in their centres shows the roll."""

from __future__ import annotations

import numpy as np

from twin.artefact.artefact import ball_bar
from twin.identification.poses import PoseArms, Poses, RowLayout, rotation_matrices
from twin.identification.straight_lines import StraightLines


def test_rounding_is_not_taken_for_the_lever_of_a_roll() -> None:
    bar = ball_bar("bar", balls=5, length_mm=120.0, tilt_rad=0.0, holder_length_mm=30.0, ball_diameter_mm=12.0)
    count = 20
    turns = rotation_matrices(np.random.default_rng(3).uniform(-1.5, 1.5, (count, 3)))
    layout = RowLayout.of(np.repeat(np.arange(count), bar.count))
    local = np.tile(bar.balls, (count, 1))
    lines = StraightLines.of(bar, [np.arange(bar.count)] * count)
    columns = PoseArms.of(layout, local, lines).rotation_columns(layout, Poses(turns, np.zeros((count, 3))), local)
    assert np.abs(columns[..., 0]).max() < 1e-6
    assert np.linalg.norm(columns[..., 1:], axis=(1, 2)).min() > 0.5
