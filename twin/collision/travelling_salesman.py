"""Search for the cheapest order in which to visit a number of points.

For few points, the order found is the best possible. For more points, an initial order is improved step by step by
exchanging legs.

The cost of a leg between two points may depend on its direction and may take long to compute. Costs are therefore
requested one by one from a function of the caller. The caller also provides a lower bound of the cost that is quick to
compute. An exchange is rejected if the lower bounds of its new legs already exceed the cost of the old legs. The exact
costs of the new legs are then not computed.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import TypeVar

Node = TypeVar("Node", bound=Hashable)

MAX_EXACT_NODES = 8
# Exchanges that gain less are floating-point noise, and could be made and undone for ever.
_LEAST_GAIN = 1e-9


def shortest_tour(
    nodes: Sequence[Node],
    start: Node,
    end: Node | None,
    cost: Callable[[Node, Node], float],
    lower_bound: Callable[[Node, Node], float],
) -> list[Node]:
    """Return `nodes` in the order that minimises the total cost of a tour from `start` to `end`. If `end` is None, the
    tour may end at any node.

    `cost(a, b)` is the cost of the leg from a to b. `lower_bound(a, b)` is a lower bound of this cost that is quick to
    compute.

    If there are at most eight nodes (`MAX_EXACT_NODES`), the result is a best order (method of Held and Karp, 1962). If
    there are more, the result is a local optimum. Its cost cannot be reduced by reversing one part of the tour (2-opt),
    or by moving up to three successive nodes to another place in the order (Or-opt). If several orders have the same
    cost, the order of `nodes` decides, so the result is reproducible.
    """
    if len(nodes) <= MAX_EXACT_NODES:
        return _exact(nodes, start, end, cost)
    # Legs are looked up millions of times, and the hash of a number takes a tenth of the time of that of a node.
    numbers: dict[Node, int] = {}
    for node in _stops(nodes, start, end):
        numbers.setdefault(node, len(numbers))
    named = list(numbers)
    first, last = numbers[start], None if end is None else numbers[end]
    exact, quick = _by_number(cost, named), _by_number(lower_bound, named)
    nearest = _nearest([numbers[node] for node in nodes], first, quick)
    return [named[number] for number in _improved(nearest, first, last, exact, quick)]


def _by_number(function: Callable[[Node, Node], float], named: Sequence[Node]) -> Callable[[int, int], float]:
    """Return `function` as a function of the indices of its nodes in `named`, with a cache."""

    @cache
    def of_numbers(first: int, second: int) -> float:
        return function(named[first], named[second])

    return of_numbers


def _stops(order: Sequence[Node], start: Node, end: Node | None) -> list[Node]:
    return [start, *order, *([] if end is None else [end])]


def _exact(nodes: Sequence[Node], start: Node, end: Node | None, cost: Callable[[Node, Node], float]) -> list[Node]:
    """Return the best order by dynamic programming over subsets of nodes and their last node (Held and Karp)."""
    costs = [[0.0 if a is b else cost(a, b) for b in nodes] for a in nodes]
    best: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = {
        (1 << index, index): (cost(start, node), (index,)) for index, node in enumerate(nodes)
    }
    for subset in range(1, 1 << len(nodes)):
        for last in range(len(nodes)):
            if (subset, last) not in best:
                continue
            spent, path = best[subset, last]
            for after in range(len(nodes)):
                if subset >> after & 1:
                    continue
                extended = (spent + costs[last][after], (*path, after))
                reached = (subset | 1 << after, after)
                if reached not in best or extended[0] < best[reached][0] - _LEAST_GAIN:
                    best[reached] = extended
    whole = (1 << len(nodes)) - 1
    ends = [best[whole, last] for last in range(len(nodes))]
    if end is not None:
        ends = [(spent + cost(nodes[path[-1]], end), path) for spent, path in ends]
    return [nodes[index] for index in min(ends, default=(0.0, ()))[1]]


def _nearest(nodes: Sequence[Node], start: Node, lower_bound: Callable[[Node, Node], float]) -> list[Node]:
    """Return the nearest-neighbour order: always continue to the nearest remaining node."""
    left, order, here = list(nodes), list[Node](), start
    while left:
        here = min(left, key=lambda node: lower_bound(here, node))
        left.remove(here)
        order.append(here)
    return order


def _improved(
    order: list[Node],
    start: Node,
    end: Node | None,
    cost: Callable[[Node, Node], float],
    lower_bound: Callable[[Node, Node], float],
) -> list[Node]:
    better: list[Node] | None = order
    while better is not None:
        order, old = better, {leg: cost(*leg) for leg in pairwise(_stops(better, start, end))}
        exchanged = (one for one in _exchanged(order) if _cheaper(_stops(one, start, end), old, cost, lower_bound))
        better = next(exchanged, None)
    return order


def _cheaper(
    stops: list[Node],
    old: Mapping[tuple[Node, Node], float],
    cost: Callable[[Node, Node], float],
    lower_bound: Callable[[Node, Node], float],
) -> bool:
    """Return True if the tour over `stops` costs less than the tour with the legs `old`.

    Only legs that the two tours do not share are compared.
    """
    legs = list(pairwise(stops))
    new = [leg for leg in legs if leg not in old]
    kept = set(legs)
    saved = sum([spent for leg, spent in old.items() if leg not in kept]) - _LEAST_GAIN
    return sum([lower_bound(*leg) for leg in new]) < saved and sum([cost(*leg) for leg in new]) < saved


def _exchanged(order: list[Node]) -> Iterator[list[Node]]:
    """Yield every order that differs from `order` by one exchange.

    An exchange reverses one part (2-opt) or moves up to three successive nodes elsewhere (or-opt).
    """
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
