"""Whole procedure on the simulated machine, stopped in the middle of its steps: every exit path is free."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nights import document

from agent.execution import steps as s
from agent.execution.device_assembly import assemble
from agent.execution.engine import Engine
from agent.execution.rig import Rig
from agent.planning.cycle_time import expected_plan
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.planning.stand_ins import stand_in_answers
from agent.probing.recovery import withdraw
from agent.probing.run_plan import MEASURED, VERIFIED, MeasuredPositions
from agent.runs.kinds.calibrate import calibration_of
from agent.settings.schema import Settings
from drivers.clock import VirtualClock
from drivers.errors import GuardTripped
from simulators.backend import SimulatedMachineDevice

EVERY = 17
"""Prime to the rhythm of touches, so that every kind of step is stopped at one ball or another."""
POSITIONS = "station,azimuth_deg,elevation_deg\n1,45,0\n1,0,45\n1,90,-45\n"


class Interrupted:
    """Carries a plan out. Of the steps that move, each `EVERY`-th is also stopped, on the way and at its end, on a copy
    of the machine, and left from there."""

    def __init__(self, job: Job, rig: Rig) -> None:
        self._job, self._rig = job, rig
        self._actions = rig.actions()
        self._count = 0
        self.left: list[str] = []
        self.touching = 0

    def actions(self) -> dict[type, Any]:
        watched = dict.fromkeys((s.MoveTo, s.TouchTowards, s.OrientTo), self._watched)
        return {**self._actions, **stand_in_answers(), **watched}

    def _watched(self, step: Any) -> Any:
        self._count += 1
        if self._count % EVERY == 0:
            for share in (0.15, 0.6, 1.0):
                self._stopped(step, share)
        return self._actions[type(step)](step)

    def _stopped(self, step: Any, share: float) -> None:
        rig = copy.deepcopy(self._rig)
        device = rig.devices["twin"]
        assert isinstance(device, SimulatedMachineDevice)
        begin(rig, device, step)
        ends_s = device._controller.motion_ends_s or max(mount.settled_s for mount in device.world.mounts.values())
        if ends_s <= device.world.now:
            return
        rig.clock.sleep(share * (ends_s - device.world.now))
        self.touching += device.probe_status().deflected
        rig.stop()
        rig.await_standstill()
        self._left(rig, device, step)

    def _left(self, rig: Rig, device: SimulatedMachineDevice, step: Any) -> None:
        rules = self._job.rules
        axis = np.asarray(rules.probing.stylus_axis)
        Engine(rig.actions()).run(withdraw(rules.retreat, axis, rules.probing.retract_mm, rig.last_motion))
        assert device.world.collisions == [], step.key
        assert device.position()[rules.retreat.retreat_axis] == pytest.approx(rules.retreat.retreat_mm), step.key
        assert not device.probe_status().deflected, step.key
        self.left.append(step.key)


def begin(rig: Rig, device: SimulatedMachineDevice, step: Any) -> None:
    """Begin the motion as the rig does, without waiting for its end."""
    device._catch_up()
    if isinstance(step, s.OrientTo):
        for mount in device.world.mounts.values():
            mount.begin_turn("azimuth", step.azimuth_deg)
            mount.begin_turn("elevation", step.elevation_deg)
        return
    rig.last_motion.begin(step.target_mm, touch=isinstance(step, s.TouchTowards))
    target = np.array(step.target_mm)
    if isinstance(step, s.TouchTowards):
        device._controller.begin_touch(target, step.feed_mm_per_s)
    else:
        device._controller.begin_move(target, step.feed_mm_per_s, step.guarded)


@pytest.mark.parametrize("paths", ["shortest", "plain"])
def test_from_every_step_the_exit_path_is_free(state: Path, paths: str) -> None:
    listed = state.parent / "positions.csv"
    listed.write_text(POSITIONS)
    chosen = {"position_set": str(listed), "stations": [1], "paths": paths}
    sections = {"procedure": chosen, "verification": {"stations": [1], "positions_deg": [[20.0, 25.0]]}}
    job = prepare_job(Settings.model_validate(document(state, **sections)), Path.cwd())
    rig = assemble(job.settings, VirtualClock(), Path.cwd())
    rig.open()
    interrupted = Interrupted(job, rig)
    measured: dict[str, MeasuredPositions] = {}

    def observe(step: s.Step, result: object) -> None:
        if isinstance(result, MeasuredPositions):
            measured[step.key] = result

    Engine(interrupted.actions(), observer=observe).run(expected_plan(calibration_of(job)))
    assert len(measured[MEASURED].positions) == 4
    assert len(measured[VERIFIED].positions) == 1
    device = rig.devices["twin"]
    assert isinstance(device, SimulatedMachineDevice)
    assert device.world.collisions == []
    assert len(interrupted.left) > 200
    assert interrupted.touching > 5
    kinds = {key.rsplit("/")[-1].rstrip("0123456789-") for key in interrupted.left}
    assert {"touch", "start"} <= kinds


def test_a_trip_on_the_way_is_left_the_way_the_tip_came(state: Path) -> None:
    """A guarded move hits an unknown obstacle: the first motion of the withdrawal goes back."""
    job = prepare_job(Settings.model_validate(document(state)), Path.cwd())
    rig = assemble(job.settings, VirtualClock(), Path.cwd())
    rig.open()
    device = rig.devices["twin"]
    assert isinstance(device, SimulatedMachineDevice)
    run = Engine(rig.actions()).run
    device.orient_to(0.0, 0.0)
    ball = np.array(device.world.workpiece.snapshot(0.0).balls[5]) - np.array(job.tool_offset_mm)
    beside = ball + np.array([60.0, 0.0, 0.0])

    def into_the_ball() -> s.Plan[None]:
        yield s.ReadPosition("here")
        yield s.MoveTo("back", (float(beside[0]), 0.0, float(beside[2])))
        yield s.MoveTo("in", tuple(beside.tolist()))
        yield s.MoveTo("across", tuple(ball.tolist()), 10.0)

    with pytest.raises(GuardTripped):
        run(into_the_ball())
    seen: list[s.Step] = []
    engine = Engine(rig.actions(), observer=lambda step, _: seen.append(step))
    axis = np.asarray(job.rules.probing.stylus_axis)
    engine.run(withdraw(job.rules.retreat, axis, job.rules.probing.retract_mm, rig.last_motion))
    first = next(step for step in seen if isinstance(step, s.MoveTo))
    assert first.target_mm[0] - ball[0] == pytest.approx(job.rules.probing.contact_mm + 3.0, abs=0.2)
    assert first.target_mm[1:] == pytest.approx(tuple(ball[1:]), abs=1e-3)
    assert device.world.collisions == []
    assert device.position()[1] == pytest.approx(job.rules.retreat.retreat_mm)
