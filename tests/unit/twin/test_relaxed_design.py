"""Lower bound of the expected error: below every set, reached where the best weights are known, and convex in time."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions
from twin.design.criterion import Criterion
from twin.design.relaxed_design import information_bound


def candidates(factors: np.ndarray, form: np.ndarray, unresolved_mm2: float = 0.0) -> CandidatePositions:
    size = factors.shape[2]
    return CandidatePositions(
        positions=tuple(Position(1, 10.0 * number, 0.0) for number in range(len(factors))),
        balls=np.full(len(factors), 5),
        factors=factors,
        precision=np.eye(size),
        form=Criterion(form, form, unresolved_mm2),
    )


@pytest.fixture
def drawn() -> tuple[CandidatePositions, np.ndarray]:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6))
    offered = candidates(rng.normal(size=(9, 2, 6)), 1e-6 * root @ root.T, 2e-6)
    return offered, rng.uniform(0.5, 2.0, 9)


def test_no_set_within_the_time_is_better(drawn: tuple[CandidatePositions, np.ndarray]) -> None:
    offered, times = drawn
    bound = information_bound(offered, times, 4.0)
    sets = [s for size in range(1, 9) for s in combinations(range(9), size) if times[list(s)].sum() <= 4.0]
    best = min(offered.vce(one).aligned_mm for one in sets)
    assert bound.vce_mm <= bound.relaxed_mm <= best * (1.0 + 1e-9)
    assert bound.vce_mm > 0.8 * best
    assert bound.relaxed_mm - bound.vce_mm < 0.006 * bound.relaxed_mm


def test_more_time_lowers_the_bound(drawn: tuple[CandidatePositions, np.ndarray]) -> None:
    offered, times = drawn
    bounds = [information_bound(offered, times, time).vce_mm for time in (1.0, 2.0, 4.0, 8.0)]
    assert bounds == sorted(bounds, reverse=True)


def test_two_unknowns_that_are_seen_apart_share_the_time_in_closed_form() -> None:
    """Candidate i measures unknown i alone with the information a: f = Σ q/(1 + a w), w₁ + w₂ = T. With λ as the
    multiplier of the time, 1 + a w = √(q a/λ)."""
    q, a, time = np.array([4.0, 1.0]), 3.0, 2.0
    offered = candidates(np.sqrt(a) * np.eye(2)[:, None, :], np.diag(q))
    shares = np.sqrt(q) / np.sqrt(q).sum() * (2.0 + a * time)
    assert (shares > 1.0).all()
    exact = float(np.sqrt((q / shares).sum()))
    bound = information_bound(offered, np.ones(2), time)
    assert bound.vce_mm == pytest.approx(exact, rel=6e-3)
    assert bound.vce_mm <= exact * (1.0 + 1e-9)
