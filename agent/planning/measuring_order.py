"""Order of stations and positions that takes the least machine time. This order is computed once before a run.

The order depends only on the settings, so a resumed run has the same order. The cost of a change of position is the
time of the mount's turn plus the time of two paths. The first path leads from the last ball of a position to a point
clear of the turning artefact, and the second leads from that point to the first ball of the next position. The cost of
a change of station is the time that the operator needs to carry the artefact. Several orders of the stations usually
need the same number of carries. Among these, the order counts that shows a sudden change of the machine best: in travel
order, a change with time looks like a change along the travel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise, permutations

from agent.planning.time_model import TimeModel
from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.artefact_bodies import ArtefactPose
from agent.probing.paths.free_paths import FreePathFinder
from agent.probing.position import PositionRules
from twin.artefact.pose_alignment import choose_alignment_balls
from twin.artefact.position_set import MIN_BALLS, Position
from twin.collision.geometry import point
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.travelling_salesman import shortest_tour

MAX_PERMUTED_STATIONS = 7
"""Largest number of stations whose order is optimised; a larger number is measured in the listed order."""

PARK_DETOUR_S = 20.0
"""Approximate time of a path by way of a park location."""

AT_REST_DEG = (0.0, 0.0)

Angles = tuple[float, float]
HiddenError = Callable[[frozenset[int]], float]
_AS_GOOD = 1.05  # largest ratio of the hidden errors of two orders that count as equally good


@dataclass(frozen=True, eq=False)
class OrderOptimiser:
    """Optimiser of the order of stations and positions for one measuring layout.

    If the rules ask for plain paths between positions, only the turns of the mount are counted. Plain paths lead by way
    of the retreat plane, which no part of artefact or mount reaches, and all of them take about the same time.

    `hidden_um` returns the error in µm that a sudden change of the machine could leave unnoticed, if only the given
    stations are measured after it.
    """

    layout: MeasuringLayout
    rules: PositionRules
    times: TimeModel
    hidden_um: HiddenError

    def stations(self, listed: Sequence[int], standing_at: int | None, last_at: Sequence[int]) -> tuple[int, ...]:
        """Return the stations `listed` in the order in which the artefact has to be carried least often.

        The order starts at the station `standing_at`, where the artefact stands. The stations `last_at` are measured
        afterwards, for the verification, and the carries to them are counted too. Among orders with the same number of
        carries, the one is chosen in which a sudden change of the machine could leave the smallest error unnoticed. If
        these agree within 5 %, the one with the shorter carrying distance along X; if these are equal too, the listed
        order.

        If there are more than `MAX_PERMUTED_STATIONS` (7) stations, the station `standing_at` comes first and the
        others follow as listed.
        """
        if len(listed) > MAX_PERMUTED_STATIONS:
            return (*(s for s in listed if s == standing_at), *(s for s in listed if s != standing_at))
        carries = {order: self._carries(order, standing_at, last_at) for order in permutations(listed)}
        fewest = min(carries.values())
        orders = [order for order, count in carries.items() if count == fewest]
        if len(orders) == 1:
            return orders[0]
        hidden_um = cache(self.hidden_um)
        # the change may happen while the artefact is carried from any station to the next
        hidden = {
            order: max((hidden_um(frozenset(order[first:])) for first in range(1, len(order))), default=0.0)
            for order in orders
        }
        smallest = min(hidden.values())
        return min((order for order, um in hidden.items() if um <= _AS_GOOD * smallest), key=self._distance_mm)

    def positions(self, positions: Sequence[Position], stations: Sequence[int]) -> tuple[Position, ...]:
        """Return the positions in the order of `stations`, with all positions of a station together.

        At each station, the positions are in the fastest order that starts from the angles at which the mount stood
        before. Positions with fewer than three balls within reach come last.
        """
        angles, done = AT_REST_DEG, list[Position]()
        for station in stations:
            here = [position for position in positions if position.station == station]
            reached = [position for position in here if self._ends(position)]
            order = self._at_station(reached, angles)
            done += [*order, *(position for position in here if position not in order)]
            angles = _angles(order[-1]) if order else angles
        return tuple(done)

    def _carries(self, order: Sequence[int], standing_at: int | None, last_at: Sequence[int]) -> tuple[bool, int]:
        elsewhere = bool(order) and standing_at in order and order[0] != standing_at
        carries = sum(1 for station in order[:1] if station != standing_at) + len(order) - 1
        return elsewhere, carries + len(set(last_at)) - (1 if order and order[-1] in last_at else 0)

    def _distance_mm(self, order: Sequence[int]) -> float:
        places = [float(self.layout.location(station)[self.layout.station_axis]) for station in order]
        return sum(abs(b - a) for a, b in pairwise(places))

    def _at_station(self, positions: Sequence[Position], angles: Angles) -> list[Position]:
        begin = Position(positions[0].station, *angles, tool="mount") if positions else None
        if begin is None:
            return []
        turn = cache(self._turn_s)
        path_s = self._path_seconds(begin)
        return shortest_tour(positions, begin, None, lambda a, b: turn(a, b) + path_s(a, b), turn)

    def _turn_s(self, before: Position, after: Position) -> float:
        return self.times.turn_s(_angles(before), _angles(after))

    def _path_seconds(self, begin: Position) -> Callable[[Position, Position], float]:
        """Return a function of two positions that gives the time in s of the path between them. The time from `begin`
        is 0."""
        path_rules = self.rules.retreat.path_rules
        if path_rules is None:
            return lambda _, __: 0.0
        finder = path_rules.finder_for(self.layout)
        # Each position is asked for in the pairs with all others.
        first, last = cache(self._first_locations), cache(self._last_locations)

        @cache
        def seconds(before: Position, after: Position) -> float:
            if before == begin:
                return 0.0
            poses = self._pose(finder, before), self._pose(finder, after)
            starts, ends = last(before), first(after)
            key = (*poses, starts, ends)
            if key not in finder.known.turning_estimates:
                finder.known.turning_estimates[key] = finder.min_turning_seconds(poses[0], starts, poses[1], ends)
            # If no waiting point before the turning artefact is free, the path leads by the park location.
            found = finder.known.turning_estimates[key]
            return found if math.isfinite(found) else PARK_DETOUR_S

        return seconds

    def _last_locations(self, position: Position) -> tuple[TipLocation, ...]:
        probing = self.rules.probing
        away = point(probing.directions[-1])
        return tuple(TipLocation(ball, away, probing.contact_mm, touching=True) for ball in self._ends(position))

    def _first_locations(self, position: Position) -> tuple[TipLocation, ...]:
        probing = self.rules.probing
        out_mm = probing.contact_mm + probing.wide_search.approach_mm
        return tuple(TipLocation(ball, point(probing.directions[0]), out_mm) for ball in self._ends(position))

    def _ends(self, position: Position) -> tuple[int, ...]:
        """Return the numbers of both end balls within reach; empty if too few balls are within reach."""
        nominal = self.layout.nominal(position)
        reached = self.layout.reachable(position, nominal).nonzero()[0].tolist()
        return choose_alignment_balls(nominal, reached).ends if len(reached) >= MIN_BALLS else ()

    @staticmethod
    def _pose(finder: FreePathFinder, position: Position) -> ArtefactPose:
        return finder.pose_at(position.station, position.azimuth_deg, position.elevation_deg)


def _angles(position: Position) -> Angles:
    return position.azimuth_deg, position.elevation_deg
