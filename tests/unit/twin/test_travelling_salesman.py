"""Tours compared with every permutation, and a check that longer tours cannot be improved by a simple exchange."""

import math
from collections.abc import Callable, Sequence
from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.collision.travelling_salesman import MAX_EXACT_NODES, shortest_tour


def costs(count: int, seed: int) -> np.ndarray:
    """Return random costs that differ between the two directions."""
    return np.random.default_rng(seed).uniform(1.0, 10.0, (count + 2, count + 2))


def tour_cost(order: Sequence[int], start: int, end: int | None, cost: Callable[[int, int], float]) -> float:
    """Return the sum over all legs from `start` over `order` to `end`."""
    return sum(cost(a, b) for a, b in pairwise([start, *order, *([] if end is None else [end])]))


@given(st.integers(0, 6), st.integers(0, 10_000), st.booleans())
@settings(max_examples=60, deadline=None)
def test_few_places_are_visited_in_the_best_order_there_is(count: int, seed: int, with_end: bool) -> None:
    matrix, places = costs(count, seed), list(range(2, count + 2))
    end = 1 if with_end else None
    cost = lambda a, b: float(matrix[a, b])  # noqa: E731
    found = shortest_tour(places, 0, end, cost, cost)
    assert sorted(found) == places
    best = min(tour_cost(order, 0, end, cost) for order in permutations(places))
    assert tour_cost(found, 0, end, cost) == pytest.approx(best)


@given(st.integers(MAX_EXACT_NODES + 1, 14), st.integers(0, 10_000))
@settings(max_examples=25, deadline=None)
def test_no_exchange_makes_a_longer_order_better(count: int, seed: int) -> None:
    matrix, places = costs(count, seed), list(range(2, count + 2))
    cost = lambda a, b: float(matrix[a, b])  # noqa: E731
    found = shortest_tour(places, 0, 1, cost, lambda a, b: 0.5 * float(matrix[a, b]))
    paid = tour_cost(found, 0, 1, cost)
    assert sorted(found) == places
    for first in range(count):
        for last in range(first + 2, count + 1):
            turned = found[:first] + found[first:last][::-1] + found[last:]
            assert tour_cost(turned, 0, 1, cost) >= paid - 1e-9
        rest = found[:first] + found[first + 1 :]
        for to in range(count):
            assert tour_cost([*rest[:to], found[first], *rest[to:]], 0, 1, cost) >= paid - 1e-9


def test_balls_on_a_bar_are_measured_one_after_the_other() -> None:
    cost = lambda a, b: math.sqrt(abs(a - b))  # noqa: E731
    shuffled = [3, 9, 1, 7, 5, 2, 8, 4, 6]
    assert shortest_tour(shuffled, 10, 0, cost, cost) == [9, 8, 7, 6, 5, 4, 3, 2, 1]
    assert shortest_tour([], 10, 0, cost, cost) == []
