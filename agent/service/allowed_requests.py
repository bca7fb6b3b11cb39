"""Which requests make sense in which state, as data. PackML names of the states are in `agent.execution.states`.

Faulted and aborted are sticky: nothing but a reset leads out of them. Complete and refused are not: a person who reads
"complete" may start again.
"""

from __future__ import annotations

from agent.execution.states import RunState

S = RunState

START, RESUME_RUN = "start", "resume_run"
HOLD, RESUME, ABORT, RESET, ANSWER = "hold", "resume", "abort", "reset", "answer"

STICKY = frozenset({S.ABORTED, S.FAULTED})
AT_REST = frozenset({S.IDLE, S.COMPLETE, S.REFUSED, S.WRITTEN}) | STICKY

_BETWEEN_RUNS = frozenset({START, RESUME_RUN})

MAY: dict[RunState, frozenset[str]] = {
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


def may(state: RunState, *, unfinished: bool, asked: bool) -> frozenset[str]:
    """The requests that make sense now. `unfinished`: a run broke off and can be resumed; `asked`: a question waits."""
    allowed = MAY[state]
    if not unfinished:
        allowed -= {RESUME_RUN}
    return allowed | {ANSWER} if asked else allowed
