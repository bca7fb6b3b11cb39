"""States of a run, and the permitted changes from one state to another.

For operator panels and gateways to other systems, each state also has its name in the standard state model PackML
(ISA-TR88.00.02).
"""

from __future__ import annotations

from enum import Enum


class RunState(Enum):
    IDLE = "idle"
    PREFLIGHT = "preflight"
    RESUMING = "resuming"
    MEASURING = "measuring"
    HELD = "held"
    IDENTIFYING = "identifying"
    STAGING = "staging"
    ACTIVATING = "activating"
    VERIFYING = "verifying"
    RESTORING = "restoring"
    WRITTEN = "written, not active"
    COMPLETE = "complete"
    REFUSED = "refused"
    ABORTING = "aborting"
    ABORTED = "aborted"
    FAULTED = "faulted"


S = RunState

PACKML = {
    S.IDLE: "Idle",
    S.PREFLIGHT: "Starting",
    S.RESUMING: "Starting",
    S.MEASURING: "Execute",
    S.HELD: "Held",
    S.IDENTIFYING: "Execute",
    S.STAGING: "Execute",
    S.ACTIVATING: "Execute",
    S.VERIFYING: "Execute",
    S.RESTORING: "Completing",
    S.WRITTEN: "Suspended",
    S.COMPLETE: "Complete",
    S.REFUSED: "Complete",
    S.ABORTING: "Aborting",
    S.ABORTED: "Aborted",
    S.FAULTED: "Aborted",
}

FORWARD: dict[RunState, frozenset[RunState]] = {
    S.IDLE: frozenset({S.PREFLIGHT, S.RESUMING}),
    S.PREFLIGHT: frozenset({S.MEASURING, S.REFUSED}),
    S.RESUMING: frozenset({S.MEASURING, S.REFUSED}),
    S.MEASURING: frozenset({S.IDENTIFYING, S.RESTORING, S.HELD, S.REFUSED}),
    S.HELD: frozenset({S.MEASURING, S.VERIFYING}),
    S.IDENTIFYING: frozenset({S.STAGING, S.REFUSED, S.COMPLETE}),
    S.STAGING: frozenset({S.ACTIVATING}),
    S.ACTIVATING: frozenset({S.VERIFYING, S.WRITTEN}),
    S.VERIFYING: frozenset({S.COMPLETE, S.RESTORING, S.HELD}),
    S.RESTORING: frozenset({S.COMPLETE}),
    S.WRITTEN: frozenset({S.RESUMING}),
    S.ABORTING: frozenset({S.ABORTED, S.FAULTED}),
}

FINAL = frozenset({S.COMPLETE, S.REFUSED, S.ABORTED, S.FAULTED})


def may_follow(now: RunState, after: RunState) -> bool:
    """Return True if a run may change from the state `now` to the state `after`.

    The change is permitted if the mapping `FORWARD` lists `after` among the states that may follow `now`. A change to
    ABORTING or FAULTED is permitted from every state except the final ones (COMPLETE, REFUSED, ABORTED and FAULTED).
    """
    if now in FINAL:
        return False
    return after in FORWARD[now] or after in (S.ABORTING, S.FAULTED)
