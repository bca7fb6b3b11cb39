"""Invariants that each night with faults must fulfil, judged by its record."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

from agent.results.run_outcome import Decision
from campaigns.faults.excuses import altered_but_better, cannot_be_seen, left_to_a_person, not_shown
from campaigns.faults.night_record import NightRecord

FINAL_STATES = ("complete", "refused", "aborted", "faulted", "written, not active")
ENDED_EARLY = ("aborted", "faulted")
MOVED_MM = 1e-6
BRAKED_AFTER_S = 2.0
"""Time in s that the axes may need to come to rest: braking from 20 m/min at 0.5 m/s² takes 0.7 s."""


def _settled_later(night: NightRecord) -> bool:
    """Return True if the run has said that it could not restore the former table, and was resumed: the resumption is
    judged by what acts after it."""
    return night.told_unrestored and night.later is not None


def _collided(night: NightRecord) -> str:
    struck = Counter(text.partition(" at ")[0] for text in night.struck)
    again = (f"{bodies} again" for bodies, count in struck.items() if count > 1)
    return ", ".join((*night.collisions, *again))


def _moved_after_stop(night: NightRecord) -> str:
    if night.moved_after_end_mm > MOVED_MM or night.motion_at_end in ("moving", "held"):
        return f"{night.motion_at_end} after the end, moved {night.moved_after_end_mm:.6f} mm"
    if night.stopped_s is not None and night.stands_from_s > night.stopped_s + BRAKED_AFTER_S:
        return f"stopped at {night.stopped_s:.2f} s, moved until {night.stands_from_s:.2f} s"
    if night.steps_after_abort:
        return f"steps of the procedure after the abort: {', '.join(night.steps_after_abort[:3])}"
    return ""


def _incomplete_table(night: NightRecord) -> str:
    if not night.complete_table:
        return "the active bank is empty"
    strange = night.active not in (night.former, *night.written)
    if strange and not any(
        excused(night) for excused in (left_to_a_person, cannot_be_seen, altered_but_better, _settled_later)
    ):
        return f"table {night.active:08x} is neither the former one nor one that was written"
    return "" if night.former_intact else "the bank of the former table was changed"


def _unproved(night: NightRecord) -> str:
    if night.morning is None and night.later is not None:
        return ""  # the resumed run proves it or takes it back
    acts = night.active if night.morning is None else night.morning
    if acts == night.former or left_to_a_person(night):
        return ""
    if not night.accepted:
        return f"table {acts:08x} acts and was never proved"
    if night.before_um is None or night.after_um is None or night.after_um >= night.before_um + night.misled_um:
        return f"the accepted table makes the machine worse: {night.before_um} -> {night.after_um} µm"
    return ""


def _unrestored(night: NightRecord) -> str:
    if night.accepted or night.active == night.former or cannot_be_seen(night):
        return ""
    return "" if night.told_unrestored else f"table {night.active:08x} acts at the end and the reason does not say so"


def _lost(night: NightRecord) -> str:
    touches = night.acknowledged_touches - night.journaled_touches
    balls = night.acknowledged_balls - night.journaled_balls
    # The result of the touch during which the disk filled up can no longer be recorded; the run ends at it.
    if touches > (0 if night.journal_writable else 1) or balls > 0:
        return f"{touches} touches and {balls} balls are not in the journal"
    return ""


def _unnamed(night: NightRecord) -> str:
    if night.state not in ENDED_EARLY or not night.reached or not night.faulted:
        return ""
    if not night.reason:
        return "no reason"
    if night.reasons and not any(word in night.reason for word in night.reasons):
        return f"the cause is not named: {night.reason}"
    if not night.step:
        return f"no step is named: {night.reason}"
    if night.needs_place and not night.place:
        return f"no link is named: {night.reason}"
    return ""


def _without_end(night: NightRecord) -> str:
    if night.failures:
        return "; ".join(night.failures)
    if night.hung:
        return f"no end after {night.end_s:.0f} s of machine time"
    if night.raised:
        return f"raised {night.raised}"
    if night.state not in FINAL_STATES:
        return f"ended {night.state!r}"
    if night.journal_writable and (night.journal_state != night.state or not night.journal_closed):
        return f"ended {night.state}, the journal says {night.journal_state}, closed {night.journal_closed}"
    return ""


def _measured_twice(night: NightRecord) -> str:
    return (
        f"{len(night.repeated)} touches were measured again: {', '.join(night.repeated[:3])}" if night.repeated else ""
    )


def _is_confirmed(night: NightRecord) -> bool:
    """Return True if the run has kept the former table because a new one would not be better, or not provably so."""
    kept = night.state == "complete" and night.active == night.former
    return kept and night.reason.startswith(Decision.CONFIRMED.value)


def _not_resumed(night: NightRecord) -> str:
    unfinished = not night.journal_closed if night.killed else night.state == "faulted"
    if night.must_resume and unfinished and night.resume_refused:
        return f"the run could not be resumed: {night.resume_refused}"
    decided = night.accepted or night.state == "refused" or _is_confirmed(night) or not_shown(night)
    if night.must_end_well and not decided:
        return f"nothing disturbed the resumed run, and it ended {night.state}: {night.reason}"
    return ""


INVARIANTS: Mapping[str, Callable[[NightRecord], str]] = {
    "no collision": _collided,
    "no motion after a stop": _moved_after_stop,
    "active table complete": _incomplete_table,
    "former table or a proved one": _unproved,
    "compensation restored": _unrestored,
    "acknowledged means journaled": _lost,
    "fault named": _unnamed,
    "stated end": _without_end,
    "nothing measured twice": _measured_twice,
    "resumed to the end": _not_resumed,
}
"""Invariants by name. Each returns what is wrong in words, or an empty text."""


OF_ENDED_RUNS = ("no motion after a stop", "compensation restored", "fault named", "stated end")
"""Invariants of the end of a run, which a killed process cannot see to."""


def violations(night: NightRecord) -> dict[str, str]:
    """Return what is wrong with the night and its resumed runs, by invariant; empty if nothing is.

    A night that could not be recorded violates only the invariant of its end, because the other facts are not known.
    """
    judged = {"stated end": _without_end} if night.failures else INVARIANTS
    if night.killed and not night.failures:
        judged = {name: judge for name, judge in INVARIANTS.items() if name not in OF_ENDED_RUNS}
    found = {name: judge(night) for name, judge in judged.items()}
    wrong = {name: text for name, text in found.items() if text}
    if night.later is None:
        return wrong
    return {name: f"resumed: {text}" for name, text in violations(night.later).items()} | wrong
