"""Record of one night with faults, as the simulated world and the journal tell it, and the invariants that it must
fulfil.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from agent.results.run_outcome import Decision

FINAL_STATES = ("complete", "refused", "aborted", "faulted", "written, not active")
ENDED_EARLY = ("aborted", "faulted")
MOVED_MM = 1e-6


@dataclass(frozen=True)
class NightRecord:
    """Facts of one night, or of its resumed run. Instants are in s of machine time, true errors in µm.

    `kind` is the kind of the first fault of the night, `second` that of its second one or empty; `second_begun` is True
    if that one has begun, in this run or before. `faulted` is True if a fault has begun in this run. `resumed` is how
    many times the run had been resumed, and `later` the record of the next resumption. `resume_refused` is the answer
    to a resumption that was refused. `killed` is True for a run whose process was killed, which therefore has no end of
    its own. `must_resume` is True for a run that has measured and that can be resumed after its faults, `must_end_well`
    for a resumed run that nothing disturbs any more. `repeated` are the keys of touches that were measured again
    although they were acknowledged and not discarded.

    `collisions` are those that must not be, and `struck` those with a ball or a post that a fault has displaced by more
    than the clearance of the paths, which volcal cannot know.

    `stopped_s` is the instant of a fault after which nothing may move; `stands_from_s` is the instant from which the
    axes stood still until the end of the night. `moved_after_end_mm` is the travel of the axes in mm after the end of
    the run. `steps_after_abort` are the keys of the procedure's steps that began after an abort. `active` and `former`
    are the CRC-32 of the tables that act in the controller at the end and that acted before; `morning` is that of the
    table that acts once the fault has been removed and volcal has been started again, which says `morning_says`.
    `written` are those that the run has handed to the controller. `misled_um` is how wrong a table may be because
    the run has used wrong readings of a thermometer. `complete_table` is False if the active bank is empty.
    `reason` is the reason of the end as the journal has it, or as the run told it if the journal could not be
    written. `reasons` are words of which the reason must contain one; it is empty if the fault may be unnoticed.
    `step` is the step that the error of the run names, and `place` the device or link. `raised` is an exception
    that left the run. `unseen` is why nothing could show the run that the former table does not act; it is empty if
    something could.
    """

    seed: int
    night: int
    group: str
    kind: str
    at_s: float
    size: str = ""
    reached: bool = True
    collisions: tuple[str, ...] = ()
    struck: tuple[str, ...] = ()
    stopped_s: float | None = None
    stands_from_s: float = 0.0
    moved_after_end_mm: float = 0.0
    motion_at_end: str = "idle"
    steps_after_abort: tuple[str, ...] = ()
    former: int = 0
    active: int = 0
    morning: int | None = None
    morning_says: str = ""
    complete_table: bool = True
    former_intact: bool = True
    written: tuple[int, ...] = ()
    accepted: bool = False
    before_um: float | None = None
    after_um: float | None = None
    misled_um: float = 0.0
    told_unrestored: bool = False
    unseen: str = ""
    acknowledged_touches: int = 0
    acknowledged_balls: int = 0
    journaled_touches: int = 0
    journaled_balls: int = 0
    state: str = ""
    journal_state: str = ""
    journal_writable: bool = True
    journal_closed: bool = True
    reason: str = ""
    faulted: bool = True
    needs_place: bool = True
    second: str = ""
    second_begun: bool = False
    resumed: int = 0
    resume_refused: str = ""
    killed: bool = False
    must_resume: bool = False
    must_end_well: bool = False
    repeated: tuple[str, ...] = ()
    later: NightRecord | None = None
    reasons: tuple[str, ...] = ()
    error: str = ""
    step: str = ""
    place: str = ""
    raised: str = ""
    hung: bool = False
    end_s: float = 0.0
    failures: tuple[str, ...] = field(default=())
    """Reasons for which the night could not be recorded."""

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> NightRecord:
        """Return the record with the fields of a JSON object."""
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in document.items()
        }
        if fields["later"] is not None:
            fields["later"] = cls.from_json(fields["later"])
        return cls(**fields)

    @property
    def last(self) -> NightRecord:
        """Record of the last resumption, or of the run itself."""
        return self if self.later is None else self.later.last


BRAKED_AFTER_S = 2.0
"""Time in s that the axes may need to come to rest: braking from 20 m/min at 0.5 m/s² takes 0.7 s."""


NOT_SHOWN = "do not show the effect of the table"
"""Words of the reason of a run whose proof could not tell the new table from none."""
LEFT_TO_A_PERSON = "at the controller"
"""Words with which volcal asks a person to activate the former table."""


def left_to_a_person(night: NightRecord) -> bool:
    """Return True if a table of unknown origin acts even in the morning, and both the run, if it could see it, and the
    new start of volcal have said so and what to do.

    A controller that activates another bank than it is asked for can leave this; volcal does not overrule a bank that a
    person may have chosen.
    """
    acts = night.active if night.morning is None else night.morning
    strange = acts not in (night.former, *night.written)
    told = night.told_unrestored or bool(night.unseen)
    return strange and told and LEFT_TO_A_PERSON in night.morning_says


def cannot_be_seen(night: NightRecord) -> bool:
    """Return True if the former table does not act at the end, and neither a reading nor a measurement of the run could
    show that. The next start of volcal must have said so, or have made the former table active again."""
    if not night.unseen or night.active == night.former:
        return False
    return night.morning in (None, night.former) or LEFT_TO_A_PERSON in night.morning_says


def altered_but_better(night: NightRecord) -> bool:
    """Return True if the controller has altered the new table after it was read back, so little that the proof could
    not tell, which has shown that the machine became better. The next start of volcal must have said so."""
    if night.active in (night.former, *night.written) or night.before_um is None or night.after_um is None:
        return False
    return night.accepted and night.after_um < night.before_um and LEFT_TO_A_PERSON in night.morning_says


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


def is_misled(night: NightRecord) -> bool:
    """Return True if an accepted table makes the machine worse, but by no more than the wrong readings of a thermometer
    that the run has used explain."""
    if not night.accepted or night.before_um is None or night.after_um is None:
        return False
    return night.before_um <= night.after_um < night.before_um + night.misled_um


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


def is_not_shown(night: NightRecord) -> bool:
    """Return True if nothing disturbs the resumed run any more, and its proof could not tell the new table from none: a
    table that works is accepted with 95 % only, if so much was forecast."""
    return night.must_end_well and night.state == "complete" and NOT_SHOWN in night.reason


def _not_resumed(night: NightRecord) -> str:
    unfinished = not night.journal_closed if night.killed else night.state == "faulted"
    if night.must_resume and unfinished and night.resume_refused:
        return f"the run could not be resumed: {night.resume_refused}"
    decided = night.accepted or night.state == "refused" or _is_confirmed(night) or is_not_shown(night)
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
