"""Tests of the driver with a LinuxCNC of which a process has ended or stands still.

One LinuxCNC serves all of them; the last test ends its task for good.
"""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from live import Live, until
from requirements import requires_linuxcnc

from drivers.clock import wall_seconds
from drivers.errors import LinkLost
from drivers.linuxcnc.device import LinuxCnc
from drivers.roles import MotionState

START = np.array([3000.0, 100.0, 200.0])
END = np.array([100.0, 100.0, 200.0])
FEED = 100.0
HEARTBEAT_S = 20.0
"""Long, since the processes of LinuxCNC do not run in real time here and share the computer with other tests."""
BOUNDED_S = 60.0

pytestmark = [
    requires_linuxcnc,
]


def kill(live: Live, signal: str, name: str) -> None:
    """Send a signal to the process of this LinuxCNC with the given name."""
    found = subprocess.run(live.process.inside("pgrep", "-x", name), check=True, capture_output=True, text=True)
    for pid in found.stdout.split():
        subprocess.run(live.process.inside("kill", f"-{signal}", pid), check=False, capture_output=True)


@contextmanager
def stopped(live: Live, name: str) -> Iterator[Callable[[], None]]:
    """Return the function that stops a process; it continues at the end."""
    try:
        yield lambda: kill(live, "STOP", name)
    finally:
        kill(live, "CONT", name)


def fails_during(live: Live, device: LinuxCnc, stop: Callable[[], None]) -> LinkLost:
    """Start a long move, call `stop` when it is under way, and return the error with which the move ends."""
    device.move_to(START, feed_mm_per_s=None, guarded=True)
    with live.bystander() as other:
        moving = threading.Thread(target=_when_moving, args=(live, other, stop))
        moving.start()
        with pytest.raises(LinkLost) as caught:
            device.move_to(END, feed_mm_per_s=FEED, guarded=True)
        moving.join()
    return caught.value


def _when_moving(live: Live, other, stop: Callable[[], None]) -> None:
    until(lambda: other.get("joint.0.motor-pos-cmd") < START[0] - 20.0)
    stop()


def pin(live: Live, name: str) -> float:
    done = subprocess.run(live.process.inside("halcmd", "getp", name), check=True, capture_output=True, text=True)
    return float(done.stdout)


def test_task_that_stands_still_is_a_fault_and_the_motion_is_held(live: Live) -> None:
    with live.opened(heartbeat_timeout_s=HEARTBEAT_S) as device:
        with stopped(live, "milltask") as stop:
            error = fails_during(live, device, stop)
            assert "LinuxCNC's task has been stopped by a signal" in str(error)
            assert "restart LinuxCNC" in error.hint
            assert "its motion is held" in "".join(error.__notes__)
            until(lambda: pin(live, "motion.current-vel") == 0.0)
            assert END[0] + 100.0 < pin(live, "joint.0.motor-pos-cmd") < START[0]
            with pytest.raises(LinkLost, match="task"):
                device.status()
            began_s = wall_seconds()
            with pytest.raises(LinkLost, match="task"):
                device.stop()
            assert wall_seconds() - began_s < BOUNDED_S
        until(lambda: "volcal-hold" in device.status().fault)
        assert device.status().state is MotionState.FAULT
        here = device.position()
        device.reset()
        assert device.status().state is MotionState.IDLE
        assert device.position() == pytest.approx(here, abs=1e-3)
        device.move_to(START, feed_mm_per_s=None, guarded=True)


def test_motion_that_stands_still_is_a_fault(live: Live) -> None:
    with live.opened(heartbeat_timeout_s=HEARTBEAT_S) as device:
        with stopped(live, "rtapi_app") as stop:
            error = fails_during(live, device, stop)
            assert f"LinuxCNC's motion has stopped: no heartbeat for {HEARTBEAT_S:.0f}" in str(error)
            assert "nothing but the emergency stop" in "".join(error.__notes__)
        device.stop()
        until(lambda: device.status().state is MotionState.IDLE)


def test_tool_process_that_stands_still_stops_the_motion(live: Live) -> None:
    """It carries the emergency stop to the task, so nothing may move without it."""
    with live.opened(heartbeat_timeout_s=HEARTBEAT_S) as device:
        with stopped(live, "io") as stop:
            error = fails_during(live, device, stop)
            assert "LinuxCNC's tool and e-stop I/O has been stopped" in str(error)
            assert "its motion was aborted" in "".join(error.__notes__)
        until(lambda: device.status().state is not MotionState.MOVING)
        assert device.position()[0] > END[0] + 100.0


def test_nothing_needs_the_server_for_remote_programs(live: Live) -> None:
    with live.opened(heartbeat_timeout_s=HEARTBEAT_S) as device:
        device.move_to(START, feed_mm_per_s=None, guarded=True)
        kill(live, "KILL", "linuxcncsvr")
        device.move_to(START - [200.0, 0.0, 0.0], feed_mm_per_s=FEED, guarded=True)


def test_killed_task_is_a_fault_and_the_device_can_be_closed(live: Live) -> None:
    device = live.device(heartbeat_timeout_s=HEARTBEAT_S)
    device.open()
    error = fails_during(live, device, lambda: kill(live, "KILL", "milltask"))
    assert "LinuxCNC's task has ended" in str(error)
    with pytest.raises(LinkLost, match="has ended; its motion is held"):
        device.stop()
    began_s = wall_seconds()
    device.close()
    assert wall_seconds() - began_s < BOUNDED_S
    with pytest.raises(LinkLost, match="task has ended"):
        device.open()
    findings = device.diagnose()
    assert [(finding.subject, finding.ok) for finding in findings] == [("bridge", False)]
    assert "task has ended" in findings[0].text
