"""Effect of a displaced zero of the axes on a machine whose errors are corrected by a table.

After a homing, an axis that displays x stands at x + h, where h is the offset of its zero. The controller takes the
correction c of the displayed position x, but the machine has its error e where the slides are. The tip is at

    x + h + c(x) + e(x + h + c(x)),

which differs from its place with h = 0 by h + J h to first order, where J is the gradient of e. The first part, h, is
the same everywhere: it shifts all of a workpiece, and a work offset that is measured after the homing contains it. The
second part, J h, is a change of the error that the table does not correct. The table's own gradient adds nothing at a
displayed position. Seen from a fixed place of the slides, the difference is -K h instead, with the gradient K of c. If
the table corrects the errors, K = -J, so both are the same error, and it must be counted once.
"""

from __future__ import annotations

import numpy as np

from twin.arrays import Array
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import ErrorModel
from twin.machine.volumetric import VolumetricRms, align_rigidly, rms

STEP_MM = 1.0
"""Half the distance of the two positions from whose errors a gradient is computed. The errors are polynomials over
hundreds of mm, of which this central difference omits only the third derivatives."""


def homing_effect(
    model: ErrorModel, factor: Array, tool_offset: Array, sigma_mm: Array, axis_positions: Array
) -> VolumetricRms:
    """Return the volumetric error that a homing is expected to add, in mm, raw and after removal of the best-fitting
    rigid motion.

    The zeros of X, Y and Z scatter independently with the standard deviations `sigma_mm` (3,). The mean square length
    of J h over h is then the sum of σ² |∂e/∂x|² over the axes, and its mean over the grid `axis_positions` (n, 3) is
    the square of the result.

    `factor` (p, k) states the errors that the table corrects as parameters E of `model`: the expected value of E Eᵀ is
    F Fᵀ. For known errors it is one column, the parameters themselves; for an unknown machine it is a root of their
    prior covariance. The errors are those at the tool point with the offset `tool_offset` (3,).
    """
    points = axis_positions + tool_offset
    squares = np.zeros(2)
    for axis, sigma in enumerate(sigma_mm.tolist()):
        step = np.zeros(3)
        step[axis] = STEP_MM
        ahead, behind = (deviation_basis(model, axis_positions + sign * step, tool_offset) for sign in (1.0, -1.0))
        for gradient in np.moveaxis((ahead - behind) @ factor / (2.0 * STEP_MM), -1, 0):
            squares += sigma**2 * np.array([rms(gradient), rms(align_rigidly(points, gradient))]) ** 2
    raw, aligned = np.sqrt(squares).tolist()
    return VolumetricRms(raw, aligned)
