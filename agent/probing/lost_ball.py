"""Cause of a ball that could not be measured although it was needed: not found, or found with too small a radius.

If the controller latches the axis positions some time after the trip, the axes travel on meanwhile, and every touch
appears deeper than it is: the ball appears smaller by the feed times the delay. Touches at two feeds distinguish this
from wrong diameters in the settings.
"""

from __future__ import annotations

from agent.errors import MeasurementFault
from agent.execution.steps import Plan
from agent.probing.ball import NOT_FOUND_HINT, LostBall
from agent.probing.latch_delay import LatchDelay, measure_latch_delay
from agent.probing.probing_parameters import ProbingParameters
from twin.units import UM_PER_MM

_TOUCHES = 4
_SAME = 0.5
"""Largest relative difference between the lag of the latch and the missing radius for which the lag explains it."""


def lost_ball_fault(key: str, ball: str, lost: LostBall, probing: ProbingParameters) -> Plan[MeasurementFault]:
    """Return the fault of the `ball` (in words), which could not be measured. If its radius was too small, touch its
    pole at two feeds first, to find out whether the latch is late."""
    small = lost.small
    if small is None:
        text = f"{ball} was not found where it was expected: {lost.reason}"
        return MeasurementFault(text, hint=NOT_FOUND_HINT, step=key)
    text = f"{ball} was found, but it appears too small: {lost.reason}"
    try:
        delay = yield from measure_latch_delay(f"{key}/late-latch", small.centre_mm, probing, _TOUCHES)
    except MeasurementFault as error:
        return MeasurementFault(f"{text}; when its pole was touched again, {error.message}", hint=error.hint, step=key)
    if _explains(delay, small.deficit_mm):
        return MeasurementFault(
            f"{text}. Touches at a lower feed are latched less deep: the controller latches the axis positions "
            f"{delay.delay_ms:.1f} ms after the trip, and the axes travel {delay.lag_um:.0f} µm meanwhile",
            hint="latch the positions in the drives or at a fast input of the controller, not in the PLC program; "
            "`volcal try` measures the delay",
            step=key,
        )
    return MeasurementFault(
        f"{text}, and equally so at a lower feed",
        hint="check the ball diameter in the artefact file and the tip diameter in the settings, then the trigger "
        "force of the probe",
        step=key,
    )


def _explains(delay: LatchDelay, deficit_mm: float) -> bool:
    """Return True if the lag of the latch is about the missing radius `deficit_mm`."""
    return abs(delay.lag_um - deficit_mm * UM_PER_MM) <= _SAME * deficit_mm * UM_PER_MM
