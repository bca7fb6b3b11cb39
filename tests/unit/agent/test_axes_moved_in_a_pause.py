"""Axes that a person has moved in a pause of the run: the next motion was proved from elsewhere, so nothing moves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.execution.engine import Engine
from agent.execution.rig import MOVED_MM, PAUSE_S, Rig
from agent.execution.steps import ActivateBank, AskOperator, Dwell, MoveTo, OrientTo, Plan, Point, Step, TouchTowards
from agent.execution.supervisor import Supervisor
from agent.probing.paths.retreat import Retreat
from agent.probing.recovery import withdraw
from agent.runs.session import open_rig
from drivers.clock import InterruptibleClock, VirtualClock
from drivers.errors import MotionFault
from drivers.roles import MotionState, OperatorRequest, OperatorTask, Orientation, Touch

PLACE, NEXT = (10.0, 20.0, 30.0), (11.0, 20.0, 30.0)
LONG_S = 600.0
OVERTRAVEL_MM = 3.0


class Cell:
    """Machine, probe, mount, store and operator, with a person who jogs X by `jog_mm` at `jog_s`."""

    def __init__(self, jog_mm: float = 0.0, jog_s: float = 0.5 * LONG_S) -> None:
        self.inner = VirtualClock()
        self.supervisor = Supervisor(self.inner)
        self.clock = InterruptibleClock(self.inner, self.supervisor.check)
        self.here: Point = (0.0, 0.0, 0.0)
        self.told: list[str] = []
        self._jog_mm, self._jog_s = jog_mm, jog_s
        self.inner.subscribe(self._person)
        device: Any = self
        self.rig = Rig({}, device, device, {1: device}, device, device, device, self.clock)

    def _person(self, now_s: float) -> None:
        if now_s >= self._jog_s:
            x, y, z = self.here
            self.here, self._jog_mm = (x + self._jog_mm, y, z), 0.0

    def carry_out(self, *steps: Step) -> None:
        def plan() -> Plan[None]:
            for step in steps:
                _ = yield step

        Engine(self.rig.actions()).run(plan())

    def status(self) -> Any:
        return SimpleNamespace(state=MotionState.IDLE, missing=())

    def position(self) -> Any:
        return np.array(self.here)

    def move_to(self, target_mm: Any, **_: object) -> None:
        self.told.append("move")
        self.here = tuple(target_mm.tolist())

    def touch_towards(self, target_mm: Any, **_: object) -> Touch:
        self.told.append("touch")
        x, y, z = target_mm.tolist()
        self.here = (x, y, z)
        return Touch((x, y, z - OVERTRAVEL_MM))

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        self.told.append("turn")
        return Orientation(azimuth_deg, elevation_deg)

    def activate(self, _bank: int) -> None:
        self.told.append("activate")

    def ask(self, _request: OperatorRequest) -> bool:
        return True

    def hold(self) -> None:
        self.told.append("hold")

    def resume(self) -> None:
        self.told.append("resume")


@pytest.mark.parametrize(
    "following",
    [MoveTo("next", NEXT), TouchTowards("next", NEXT, 5.0), OrientTo("next", 1, 90.0, 0.0)],
    ids=["move", "touch", "turn"],
)
def test_after_a_jog_in_a_pause_nothing_moves(following: Step) -> None:
    cell = Cell(jog_mm=2.0 * MOVED_MM)
    with pytest.raises(MotionFault, match=r"the axes stand 2\.0 mm from where .* something else has moved them"):
        cell.carry_out(MoveTo("place", PLACE), Dwell("pause", LONG_S), following)
    assert cell.told == ["move"]


def test_after_a_jog_on_hold_nothing_moves() -> None:
    cell = Cell(jog_mm=-50.0)

    def press(now_s: float) -> None:
        if 0.0 < now_s < LONG_S:
            cell.supervisor.request_hold()
        elif now_s >= LONG_S:
            cell.supervisor.request_resume()

    cell.inner.subscribe(press)
    tracker = SimpleNamespace(may_hold=lambda: True, hold=lambda: None, resume=lambda: None, note=None)
    context: Any = SimpleNamespace(rig=cell.rig, tracker=tracker, supervisor=cell.supervisor)
    with open_rig(context), pytest.raises(MotionFault, match=r"50\.0 mm"):
        cell.carry_out(MoveTo("place", PLACE), Dwell("short", 0.5 * PAUSE_S), MoveTo("next", NEXT))
    assert cell.told == ["move", "hold", "resume"]
    assert cell.clock.now() < PAUSE_S < LONG_S <= cell.inner.now()


@pytest.mark.parametrize("off_mm", [0.0, 0.5 * MOVED_MM])
def test_axes_that_stand_where_they_were_left_go_on(off_mm: float) -> None:
    cell = Cell(jog_mm=off_mm)
    cell.carry_out(MoveTo("place", PLACE), Dwell("pause", LONG_S), MoveTo("next", NEXT))
    assert cell.told == ["move", "move"]


def test_axes_that_braked_beyond_the_trip_of_a_touch_go_on() -> None:
    cell = Cell()
    cell.carry_out(TouchTowards("touch", PLACE, 5.0), Dwell("pause", LONG_S), MoveTo("next", NEXT))
    assert cell.told == ["touch", "move"]


def test_a_person_who_was_asked_may_move_the_axes() -> None:
    cell = Cell(jog_mm=50.0)
    asked = AskOperator("ask", OperatorRequest(OperatorTask.MOVE_ARTEFACT, "Carry it.", 1))
    cell.carry_out(MoveTo("place", PLACE), Dwell("pause", LONG_S), asked, MoveTo("next", NEXT))
    assert cell.told == ["move", "move"]


def test_another_table_may_change_what_is_displayed() -> None:
    cell = Cell(jog_mm=5.0)
    cell.carry_out(MoveTo("place", PLACE), ActivateBank("bank", 1), Dwell("pause", LONG_S), MoveTo("next", NEXT))
    assert cell.told == ["move", "activate", "move"]


def test_the_probe_is_withdrawn_from_where_it_stands_after_such_a_fault() -> None:
    cell = Cell(jog_mm=5.0)
    with pytest.raises(MotionFault, match="something else has moved them"):
        cell.carry_out(MoveTo("place", PLACE), Dwell("pause", LONG_S), MoveTo("next", NEXT))
    retreat = Retreat(retreat_axis=1, retreat_mm=0.0, station_axis=0, park_mm={})
    plan = withdraw(retreat, np.array([0.0, 1.0, 0.0]), 1.0, cell.rig.last_motion)
    Engine(cell.rig.actions()).run(plan)
    assert cell.here == (15.0, 0.0, 30.0)
