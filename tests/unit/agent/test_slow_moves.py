"""A resumed run moves slowly until it has met a ball."""

from __future__ import annotations

from collections.abc import Iterator

from agent.execution.steps import MoveTo, Step, TouchTowards
from agent.runs.resume.slow_moves import slow_until_contact
from drivers.roles import Miss, Touch

TOUCH = Touch((1.0, 2.0, 3.0))


def test_guarded_rapid_moves_are_slow_until_a_ball_is_met() -> None:
    done: list[Step] = []
    answers: Iterator[Touch | Miss] = iter([TOUCH, Miss((3.0, 1.0, 1.0)), TOUCH])

    def touched(step: TouchTowards) -> Touch | Miss:
        done.append(step)
        return next(answers)

    actions = slow_until_contact({MoveTo: done.append, TouchTowards: touched}, 50.0, "resume-1/")
    rapid = MoveTo("measure/ball-07/touch-0/via-0", (1.0, 1.0, 1.0))
    back = MoveTo("resume-1/beside", (0.0, 0.0, 0.0))
    unguarded = MoveTo("measure/off", (0.0, 0.0, 5.0), guarded=False)
    fed = MoveTo("measure/ball-07/touch-0/start", (2.0, 1.0, 1.0), 10.0)
    datum = TouchTowards("resume-1/datum/touch-0", (0.0, 0.0, 0.0), 5.0)
    towards = TouchTowards("measure/ball-07/touch-0", (3.0, 1.0, 1.0), 5.0)
    for step in (back, datum, rapid, unguarded, fed, towards, rapid, towards, rapid):
        actions[type(step)](step)
    slow = MoveTo(rapid.key, rapid.target_mm, 50.0)
    assert done == [back, datum, slow, unguarded, fed, towards, slow, towards, rapid]


def test_other_actions_are_left_as_they_are() -> None:
    actions = slow_until_contact({MoveTo: print, TouchTowards: print, str: repr}, 50.0, "resume-1/")
    assert actions[str] is repr
