"""Straight artefacts: balls so close to one line that the roll about it is hardly seen.

The decision is taken once, by the certificate, and not by the measured points of each position. Noise and machine
errors of some micrometres are as large as the distances of the balls from the line, so the measured points of
neighbouring positions would give different answers.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.artefact.artefact import Artefact

_STRAIGHT = 1e-3  # second over first singular value of the certified centres: 0.5 mm off the line on a bar of 1.5 m


def line_frames(artefact: Artefact) -> list[Array | None]:
    """Return one entry for each ball: the frame (3, 3) of the line on which the balls of its member stand, or None if
    they do not stand on a line.

    The frame is a rotation whose first column is the direction of the line in the artefact's frame. All balls of an
    artefact that is not combined from several members belong to the same member.
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
    line = axes[0] * np.sign(axes[0, np.abs(axes[0]).argmax()])
    lateral = np.cross(np.eye(3)[np.abs(line).argmin()], line)
    lateral /= np.linalg.norm(lateral)
    return np.column_stack((line, lateral, np.cross(line, lateral)))
