"""Straight artefacts: balls so close to one line that the roll about it is hardly seen.

The decision is taken by the certificate, and not by the measured points of each position. Noise and machine errors of
some micrometres are as large as the distances of the balls from the line, so the measured points of neighbouring
positions would give different answers.

On a plate or a frame, the balls that were measured in one position may stand on one line although the artefact is not
straight: the front column of a plate that is seen edge-on.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twin.arrays import Array
from twin.artefact.artefact import Artefact

_STRAIGHT = 1e-3  # second over first singular value of the certified centres: 0.5 mm off the line on a bar of 1.5 m
_MIN_BALLS = 3  # two balls of an artefact that is not straight are on a line, but say nothing about its roll


def position_frames(artefact: Artefact, positions: Sequence[NDArray[np.int64]]) -> list[Array | None]:
    """Return one entry for each position: the frame (3, 3) of the line on which its balls stand, or None if they do not
    stand on a line. Each entry of `positions` has the numbers of the balls that were measured in a position, which
    belong to the same member if the artefact is combined from several members.

    The frame is a rotation whose first column is the direction of the line in the artefact's frame. If the artefact is
    straight, it is that of all balls, else that of the measured balls, of which at least three are needed.
    """
    frames = _member_frames(artefact)
    found = dict[bytes, Array | None]()
    for numbers in positions:
        key = numbers.tobytes()
        if key not in found:
            whole = frames[int(numbers[0])]
            alone = whole is None and len(numbers) >= _MIN_BALLS
            found[key] = _line_frame(artefact.balls[numbers]) if alone else whole
    return [found[numbers.tobytes()] for numbers in positions]


def _member_frames(artefact: Artefact) -> list[Array | None]:
    """Return one entry for each ball: the frame (3, 3) of the line on which the balls of its member stand, or None. All
    balls of an artefact that is not combined from several members belong to the same member.
    """
    members = artefact.members or (0,) * artefact.count
    numbers = np.array(members)
    frames = {member: _line_frame(artefact.balls[numbers == member]) for member in set(members)}
    return [frames[member] for member in members]


def _line_frame(balls: Array) -> Array | None:
    offset = balls - balls.mean(axis=0)
    weights, axes = np.linalg.svd(offset)[1:]
    if len(weights) > 1 and weights[1] > _STRAIGHT * weights[0]:
        return None
    # The sign of a singular vector is arbitrary; the frame must not depend on the library that computes it.
    line = axes[0] * np.sign(axes[0, np.abs(axes[0]).argmax()])
    # any direction across the line will do, but the axis that is most across it gives the best-conditioned product
    lateral = np.cross(np.eye(3)[np.abs(line).argmin()], line)
    lateral /= np.linalg.norm(lateral)
    return np.column_stack((line, lateral, np.cross(line, lateral)))
