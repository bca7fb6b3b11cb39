"""In which order the balls of one position are measured: both ends first, then the rest on the fastest way back."""

from __future__ import annotations

from collections.abc import Sequence

from agent.plans.probing import Probing
from agent.plans.traffic import Spot, Stand, Traffic
from twin.geometry import point
from twin.tours import shortest_tour


def measuring_sequence(
    traffic: Traffic, stand: Stand, probing: Probing, balls: Sequence[int], first: int, last: int
) -> list[int]:
    """`balls` without both ends, in the order that takes least machine time from `last` back to `first`."""
    key = (stand, tuple(balls), first, last)
    if key not in traffic.sequences:
        traffic.sequences[key] = _sequence(traffic, stand, probing, balls, first, last)
    return list(traffic.sequences[key])


def _sequence(
    traffic: Traffic, stand: Stand, probing: Probing, balls: Sequence[int], first: int, last: int
) -> list[int]:
    directions = [point(direction) for direction in probing.directions]
    contact_mm, out_mm = probing.contact_mm, probing.contact_mm + probing.narrow.approach_mm
    left = {ball: Spot(ball, directions[-1], contact_mm, touching=True) for ball in balls}
    begun = {ball: Spot(ball, directions[0], out_mm) for ball in balls}
    bounds = traffic.straight_seconds(stand, list(left.values()), list(begun.values())).tolist()
    place = {ball: index for index, ball in enumerate(balls)}

    def cost(one: int, other: int) -> float:
        return traffic.seconds_between(stand, left[one], begun[other])

    def least(one: int, other: int) -> float:
        return float(bounds[place[one]][place[other]])

    return shortest_tour([ball for ball in balls if ball not in (first, last)], last, first, cost, least)
