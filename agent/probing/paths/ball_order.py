"""Measuring order of the balls of one position. The balls that determine the pose of the artefact are measured first.
The other balls are then measured on the fastest path from the last of these balls back to the first."""

from __future__ import annotations

from collections.abc import Sequence

from agent.probing.paths.approach_points import TipLocation
from agent.probing.paths.artefact_bodies import ArtefactPose
from agent.probing.paths.free_paths import FreePathFinder
from agent.probing.probing_parameters import ProbingParameters
from twin.collision.geometry import point
from twin.collision.travelling_salesman import shortest_tour


def shortest_sequence(
    finder: FreePathFinder,
    pose: ArtefactPose,
    probing: ProbingParameters,
    balls: Sequence[int],
    start: int,
    end: int,
) -> list[int]:
    """Return the `balls` other than `start` and `end` in the order that takes the tip from `start` past all of them to
    `end` in the shortest time. The times are those of straight paths."""
    key = (pose, tuple(balls), start, end)
    if key not in finder.sequences:
        finder.sequences[key] = _sequence(finder, pose, probing, balls, start, end)
    return list(finder.sequences[key])


def _sequence(
    finder: FreePathFinder,
    pose: ArtefactPose,
    probing: ProbingParameters,
    balls: Sequence[int],
    start: int,
    end: int,
) -> list[int]:
    """Return the order with the shortest total time of straight paths. Detours are ignored, because each takes about
    the same time."""
    contact_mm, out_mm = probing.contact_mm, probing.contact_mm + probing.narrow_search.approach_mm
    starts = [TipLocation(ball, point(probing.directions[-1]), contact_mm, touching=True) for ball in balls]
    ends = [TipLocation(ball, point(probing.directions[0]), out_mm) for ball in balls]
    seconds = finder.straight_seconds(pose, starts, ends).tolist()
    index_of = {ball: index for index, ball in enumerate(balls)}

    def cost(one: int, other: int) -> float:
        return float(seconds[index_of[one]][index_of[other]])

    return shortest_tour([ball for ball in balls if ball not in (start, end)], start, end, cost, cost)
