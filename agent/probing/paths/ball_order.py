"""In which order the balls of one position are measured: both ends first, then the rest on the fastest way back."""

from __future__ import annotations

from collections.abc import Sequence

from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.free_paths import ArtefactPose, FreePathFinder
from agent.probing.probing_parameters import ProbingParameters
from twin.collision.geometry import point
from twin.collision.travelling_salesman import shortest_tour


def measuring_sequence(
    traffic: FreePathFinder,
    stand: ArtefactPose,
    probing: ProbingParameters,
    balls: Sequence[int],
    first: int,
    last: int,
) -> list[int]:
    """`balls` without both ends, in the order that takes least machine time from `last` back to `first`."""
    key = (stand, tuple(balls), first, last)
    if key not in traffic.sequences:
        traffic.sequences[key] = _sequence(traffic, stand, probing, balls, first, last)
    return list(traffic.sequences[key])


def _sequence(
    traffic: FreePathFinder,
    stand: ArtefactPose,
    probing: ProbingParameters,
    balls: Sequence[int],
    first: int,
    last: int,
) -> list[int]:
    """By the times of straight ways: to go round what stands between two neighbours costs about the same everywhere."""
    contact_mm, out_mm = probing.contact_mm, probing.contact_mm + probing.narrow.approach_mm
    left = [TipLocation(ball, point(probing.directions[-1]), contact_mm, touching=True) for ball in balls]
    begun = [TipLocation(ball, point(probing.directions[0]), out_mm) for ball in balls]
    seconds = traffic.straight_seconds(stand, left, begun).tolist()
    place = {ball: index for index, ball in enumerate(balls)}

    def cost(one: int, other: int) -> float:
        return float(seconds[place[one]][place[other]])

    return shortest_tour([ball for ball in balls if ball not in (first, last)], last, first, cost, cost)
