"""The order in which places are visited that costs least: exact for few of them, improved by exchanges for more.

Costs need not be the same both ways and may be dear to know: they are asked for one by one, through the caller's
function, and an exchange whose new legs cost more at the least than the old ones do is never asked about.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import TypeVar

Node = TypeVar("Node", bound=Hashable)

MAX_EXACT_NODES = 8
_LEAST_GAIN = 1e-9


def shortest_tour(
    places: Sequence[Node],
    start: Node,
    end: Node | None,
    cost: Callable[[Node, Node], float],
    least: Callable[[Node, Node], float],
) -> list[Node]:
    """`places` in the order that costs least from `start` to `end` (None: wherever it ends).

    `least(a, b)`: a lower bound of `cost(a, b)` that is cheap to know. Up to `MAX_EXACT_NODES` places the answer is the
    best there is (Held and Karp 1962); beyond, no exchange of two legs and no move of up to three places makes the
    answer better. Of equals the earlier in `places`.
    """
    if len(places) <= MAX_EXACT_NODES:
        return _exact(places, start, end, cost)
    return _improved(_nearest(places, start, least), start, end, cost, least)


def _stops(order: Sequence[Node], start: Node, end: Node | None) -> list[Node]:
    return [start, *order, *([] if end is None else [end])]


def _exact(places: Sequence[Node], start: Node, end: Node | None, cost: Callable[[Node, Node], float]) -> list[Node]:
    """Best ways through every subset, by its last place."""
    costs = [[0.0 if a is b else cost(a, b) for b in places] for a in places]
    best: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = {
        (1 << index, index): (cost(start, place), (index,)) for index, place in enumerate(places)
    }
    for subset in range(1, 1 << len(places)):
        for last in range(len(places)):
            if (subset, last) not in best:
                continue
            paid, way = best[subset, last]
            for after in range(len(places)):
                if subset >> after & 1:
                    continue
                further = (paid + costs[last][after], (*way, after))
                reached = (subset | 1 << after, after)
                if reached not in best or further[0] < best[reached][0] - _LEAST_GAIN:
                    best[reached] = further
    whole = (1 << len(places)) - 1
    ends = [best[whole, last] for last in range(len(places))]
    if end is not None:
        ends = [(paid + cost(places[way[-1]], end), way) for paid, way in ends]
    return [places[index] for index in min(ends, default=(0.0, ()))[1]]


def _nearest(places: Sequence[Node], start: Node, least: Callable[[Node, Node], float]) -> list[Node]:
    """Always on to the nearest that is left."""
    left, order, here = list(places), list[Node](), start
    while left:
        here = min(left, key=lambda place: least(here, place))
        left.remove(here)
        order.append(here)
    return order


def _improved(
    order: list[Node],
    start: Node,
    end: Node | None,
    cost: Callable[[Node, Node], float],
    least: Callable[[Node, Node], float],
) -> list[Node]:
    better: list[Node] | None = order
    while better is not None:
        order, old = better, {leg: cost(*leg) for leg in pairwise(_stops(better, start, end))}
        exchanged = (one for one in _exchanged(order) if _cheaper(_stops(one, start, end), old, cost, least))
        better = next(exchanged, None)
    return order


def _cheaper(
    stops: list[Node],
    old: Mapping[tuple[Node, Node], float],
    cost: Callable[[Node, Node], float],
    least: Callable[[Node, Node], float],
) -> bool:
    """Whether the way over `stops` costs less than one of legs that cost as `old` says; those that both have do not
    matter."""
    legs = list(pairwise(stops))
    new = [leg for leg in legs if leg not in old]
    kept = set(legs)
    saved = sum([paid for leg, paid in old.items() if leg not in kept]) - _LEAST_GAIN
    return sum([least(*leg) for leg in new]) < saved and sum([cost(*leg) for leg in new]) < saved


def _exchanged(order: list[Node]) -> Iterator[list[Node]]:
    """Every part turned round (2-opt), and every part of up to three places elsewhere (or-opt)."""
    count = len(order)
    for first in range(count):
        for last in range(first + 2, count + 1):
            yield order[:first] + order[first:last][::-1] + order[last:]
    for length in (1, 2, 3):
        for first in range(count - length + 1):
            part, rest = order[first : first + length], order[:first] + order[first + length :]
            for to in range(len(rest) + 1):
                if to != first:
                    yield rest[:to] + part + rest[to:]
