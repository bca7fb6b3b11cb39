"""Description of the current activity in plain words. It is derived from the state of the run and the key of the
current step."""

from __future__ import annotations

import re

from agent.execution.states import RunState

S = RunState

_STATES: dict[RunState, str] = {
    S.IDLE: "ready to start",
    S.PREFLIGHT: "preflight: simulating the whole run; nothing moves",
    S.RESUMING: "preflight: simulating the rest of the interrupted run; nothing moves",
    S.MEASURING: "measuring",
    S.HELD: "held",
    S.IDENTIFYING: "identifying the errors of the machine",
    S.STAGING: "writing the new table into the inactive bank",
    S.ACTIVATING: "activating the new table",
    S.VERIFYING: "verifying with the new table active",
    S.RESTORING: "reactivating the previous table",
    S.WRITTEN: "written, not active: waiting for the controller to be restarted or referenced",
    S.COMPLETE: "complete",
    S.REFUSED: "refused; the machine is unchanged",
    S.ABORTING: "stopping, withdrawing, restoring the previous table",
    S.ABORTED: "aborted; the previous table is active",
    S.FAULTED: "fault; waiting for a reset",
}

_KEY = re.compile(
    r"(?P<phase>[\w-]+)(/station-(?P<station>\d+))?(/az(?P<az>-?[\d.]+)-el(?P<el>-?[\d.]+))?(/ball-(?P<ball>\d+))?"
)
_MOVING = frozenset({S.MEASURING, S.VERIFYING, S.HELD})


def doing(state: RunState, step: str, kind: str | None) -> str:
    """Return the current activity of the service as one line of text. During a measurement the line includes the
    station, the orientation and the ball."""
    words = _STATES[state]
    place = _place(step) if state in _MOVING else ""
    if state is S.MEASURING and not place and kind is not None:
        return f"{words}: preparing"
    return f"{words}: {place}" if place else words


def _place(step: str) -> str:
    found = _KEY.match(step)
    if found is None or found["station"] is None:
        return ""
    parts = [f"station {found['station']}"]
    if found["az"] is not None:
        parts.append(f"azimuth {found['az']}°, elevation {found['el']}°")
    if found["ball"] is not None:
        parts.append(f"ball {int(found['ball'])}")
    return ", ".join(parts)
