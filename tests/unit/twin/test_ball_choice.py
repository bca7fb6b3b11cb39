"""Balls chosen so that they are spread over the artefact."""

from __future__ import annotations

import numpy as np
import pytest

from twin.design.candidates import spread_balls


@pytest.mark.parametrize(("count", "expected"), [(2, (0, 10)), (3, (0, 5, 10)), (5, (0, 2, 5, 7, 10))])
def test_balls_of_a_bar_are_its_ends_and_others_between_them(count: int, expected: tuple[int, ...]) -> None:
    bar = np.column_stack([np.linspace(0.0, 1000.0, 11), np.zeros((11, 2))])
    assert spread_balls(bar, range(11), count) == expected


def test_only_offered_balls_are_chosen() -> None:
    rng = np.random.default_rng(3)
    centres = rng.uniform(0.0, 500.0, (20, 3))
    offered = [1, 4, 5, 9, 13, 17]
    chosen = spread_balls(centres, offered, 4)
    assert set(chosen) < set(offered)
    assert list(chosen) == sorted(set(chosen))
    nearest = min(float(np.linalg.norm(centres[a] - centres[b])) for a in chosen for b in chosen if a < b)
    left = [ball for ball in offered if ball not in chosen]
    # no ball that is left out is farther from the chosen ones than these are from each other
    assert max(min(float(np.linalg.norm(centres[b] - centres[c])) for c in chosen) for b in left) <= nearest
