"""Record of one night with faults, as the simulated world and the journal tell it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


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
