"""Conversion of estimates from files of the format `volcal estimate 2`, whose lever arms begin at the axis zeros.

The lever arms of the present error model begin at the lower ends of the axis ranges. The parameters of a machine with a
range that does not begin at zero therefore have another meaning in such a file. They are converted to first order, up
to a rigid motion; the neglected terms are nanometres. An estimate that cannot be converted is refused.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.arrays import Array
from twin.errors import FormatError, ModelError
from twin.identification.unknowns import Unknowns
from twin.machine.error_model import ErrorModel
from twin.machine.lever_origin import from_levers_at_axis_zeros

_REASON = "lever arms begin at the axis zeros in a file of this format, but the axis ranges do not"
_HINT = "Identify again from the balls.csv of that run (volcal identify), or calibrate the machine again"


def conversion_of(model: ErrorModel, tool_offsets: Array, source: str) -> Array | None:
    """Return the matrix (p, p) that converts the p parameters of a file of the format `volcal estimate 2` to those of
    the present error model, or None if the axis ranges begin at zero and nothing changes.

    `tool_offsets` (t, 3) in mm are those of the t tools that measured. Raises FormatError, which names `source`, if
    they differ (a rigid motion then explains only one of them) or if the model cannot represent the converted field.
    """
    if not any(low for low, _ in model.ranges_mm):
        return None
    if (tool_offsets != tool_offsets[0]).any():
        message = f"{_REASON}: an estimate with {len(tool_offsets)} tools cannot be converted"
        raise FormatError(message, hint=_HINT, file=source, key="tool_offsets_mm")
    try:
        return from_levers_at_axis_zeros(model, tool_offsets[0])
    except ModelError as error:
        raise FormatError(f"{_REASON}: {error.message}", hint=_HINT, file=source, key="model") from None


def convert_unknowns(
    unknowns: Unknowns, mean: Array, covariance: Array, conversion: Array, source: str
) -> tuple[Unknowns, Array, Array]:
    """Return the unknowns, their mean (P,) and their covariance (P, P) after `conversion` (p, p) of the parameters.

    The modes of the misfit keep their fields. Raises FormatError, which names `source`, if a parameter without
    uncertainty would become uncertain.
    """
    scale = unknowns.scale
    mixed = conversion * scale  # what the unit of each unknown adds to the parameters
    held = scale == 0.0
    if mixed[held].any():
        name = unknowns.model.names[int(np.flatnonzero(held)[mixed[held].any(axis=1)][0])]
        message = f"{_REASON}: {name}, which the prior population holds at zero, would change"
        raise FormatError(message, hint=_HINT, file=source, key="carried_over.scale")
    own = unknowns.blocks.parameters
    whole = np.eye(len(mean))
    whole[own, own] = np.where(held[:, None], np.eye(len(scale)), mixed / np.where(held, 1.0, scale)[:, None])
    if unknowns.modes is not None:
        modes = unknowns.modes.with_removed(conversion @ unknowns.modes.removed)
        unknowns = replace(unknowns, modes=modes)
    turned = whole @ covariance @ whole.T
    return unknowns, whole @ mean, 0.5 * (turned + turned.T)
