"""Excuses of nights with faults: what looks like a violation of an invariant, and why volcal is not to blame for it.

Each excuse is counted, so that a campaign says how many of its nights needed it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from campaigns.faults.night_record import NightRecord

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


def misled_by_a_thermometer(night: NightRecord) -> bool:
    """Return True if an accepted table makes the machine worse, but by no more than the wrong readings of a thermometer
    that the run has used explain."""
    if not night.accepted or night.before_um is None or night.after_um is None:
        return False
    return night.before_um <= night.after_um < night.before_um + night.misled_um


def not_shown(night: NightRecord) -> bool:
    """Return True if nothing disturbs the resumed run any more, and its proof could not tell the new table from none: a
    table that works is accepted with 95 % only, if so much was forecast."""
    return night.must_end_well and night.state == "complete" and NOT_SHOWN in night.reason


def struck_a_displaced_ball(night: NightRecord) -> bool:
    """Return True if the stylus met a ball or a post that a fault has displaced by more than the clearance of the
    paths, which volcal cannot know before it has met it once."""
    return bool(night.struck)


EXCUSES: Mapping[str, Callable[[NightRecord], bool]] = {
    "left_to_a_person": left_to_a_person,
    "cannot_be_seen": cannot_be_seen,
    "misled_by_a_thermometer": misled_by_a_thermometer,
    "not_shown": not_shown,
    "altered_but_better": altered_but_better,
    "struck_a_displaced_ball": struck_a_displaced_ball,
}
"""Excuses by the name with which they are counted."""
