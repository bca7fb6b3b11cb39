"""Moves of a resumed run until its first contact with a ball.

A ball may have been displaced by the collision that ended the run, or by a person while it stood still, and between two
balls the axes move at rapid traverse. A guarded move stops within the overtravel of the probe only at the feed of
guarded moves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from agent.execution.engine import Action
from agent.execution.steps import MoveTo, TouchTowards
from drivers.roles import Miss, Touch


def slow_until_contact(actions: Mapping[type, Action], feed_mm_per_s: float, return_prefix: str) -> dict[type, Action]:
    """Return `actions` with which a guarded rapid move is made at `feed_mm_per_s` until a touch has met a ball.

    The steps of the return, whose keys begin with `return_prefix`, are left as they are: they have paths of their own,
    and touch a ball that was measured before.
    """
    met = False

    def move(step: MoveTo) -> object:
        slow = not met and step.guarded and step.feed_mm_per_s is None and not step.key.startswith(return_prefix)
        return actions[MoveTo](replace(step, feed_mm_per_s=feed_mm_per_s) if slow else step)

    def touch(step: TouchTowards) -> Touch | Miss:
        nonlocal met
        found: Touch | Miss = actions[TouchTowards](step)
        met = met or (isinstance(found, Touch) and not step.key.startswith(return_prefix))
        return found

    return {**actions, MoveTo: move, TouchTowards: touch}
