"""Choice of some of the balls of an artefact, spread over it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.arrays import Array


def spread_balls(centres: Array, offered: Sequence[int], count: int) -> tuple[int, ...]:
    """Return `count` of the `offered` balls, in rising order. The two balls that are farthest apart come first, then
    always the ball that is farthest from all chosen ones (Gonzalez 1985).

    `centres` (N, 3) contains the centres of all N balls in mm. At least two balls must be asked for.
    """
    balls = np.array(offered)
    distances = np.linalg.norm(centres[balls][:, None] - centres[balls][None], axis=2)
    chosen = [int(index) for index in np.unravel_index(distances.argmax(), distances.shape)]
    while len(chosen) < count:
        chosen.append(int(distances[chosen].min(axis=0).argmax()))
    return tuple(sorted(balls[chosen].tolist()))
