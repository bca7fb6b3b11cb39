"""Requests to the service (start, hold, abort and others) that are allowed in each state of a run. The PackML names of
the states are in `agent.execution.states`.

The states faulted and aborted are sticky: only a reset leaves them. The states complete and refused are not sticky: a
new run may be started from them.
"""

from __future__ import annotations

from agent.execution.states import RunState

S = RunState

START, RESUME_RUN = "start", "resume_run"
RESTORE_FORMER, GIVE_UP = "restore_former", "give_up"
HOLD, RESUME, ABORT, RESET, ANSWER = "hold", "resume", "abort", "reset", "answer"

STICKY = frozenset({S.ABORTED, S.FAULTED})
AT_REST = frozenset({S.IDLE, S.COMPLETE, S.REFUSED, S.WRITTEN}) | STICKY

_BETWEEN_RUNS = frozenset({START, RESUME_RUN})

ALLOWED: dict[RunState, frozenset[str]] = {
    S.IDLE: _BETWEEN_RUNS,
    S.PREFLIGHT: frozenset({ABORT}),
    S.RESUMING: frozenset({ABORT}),
    S.MEASURING: frozenset({HOLD, ABORT}),
    S.HELD: frozenset({RESUME, ABORT}),
    S.IDENTIFYING: frozenset({ABORT}),
    S.STAGING: frozenset({ABORT}),
    S.ACTIVATING: frozenset({ABORT}),
    S.VERIFYING: frozenset({HOLD, ABORT}),
    S.RESTORING: frozenset({ABORT}),
    S.WRITTEN: _BETWEEN_RUNS,
    S.COMPLETE: _BETWEEN_RUNS | {RESET},
    S.REFUSED: _BETWEEN_RUNS | {RESET},
    S.ABORTING: frozenset(),
    S.ABORTED: frozenset({RESET}),
    S.FAULTED: frozenset({RESET}),
}


def allowed_in(
    state: RunState, *, unfinished: bool, question_open: bool, unproved: bool = False, alarm_open: bool = False
) -> frozenset[str]:
    """Return the requests that are allowed in `state`.

    `unfinished` is True if an interrupted run can be resumed; it may be given up instead. `unproved` is True if a table
    is active that was never proved; no run starts then, and the former table may be reactivated or the run given up.
    `alarm_open` is True if an alarm is open; it can then be acknowledged between runs too, although a run may start.
    `question_open` is True if a question that the run asks a person has not been answered yet.
    """
    allowed = ALLOWED[state]
    if not unfinished:
        allowed -= {RESUME_RUN}
    elif RESUME_RUN in allowed:
        allowed |= {GIVE_UP}
    if unproved and START in allowed:
        allowed -= {START}
        allowed |= {RESTORE_FORMER, GIVE_UP, RESET}  # a reset also tries to restore, as panels need
    if alarm_open and START in allowed:
        allowed |= {RESET}
    return allowed | {ANSWER} if question_open else allowed
