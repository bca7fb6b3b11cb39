"""Connection to the controller during the set-up. It only reads: travel, positions and probe input; the axes are jogged
by a person with the controller's own panel."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Lock

from agent.planning.new_machine.controller_setup import ControllerSetup
from agent.service.setup.axis_check import Jog, ProbeFinding, judge_trigger
from drivers.errors import CommandRejected, DeviceError, LinkLost
from drivers.roles import AxisLimits, Device, Machine, Probe

NOT_CONNECTED = "the controller is not connected"
CONNECT = "connect to it in the step of the controller"
Triple = tuple[float, float, float]


class ControllerWatch:
    """Connection to one controller at a time. It is safe to use from any thread, and commands no motion."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._lock = Lock()
        self._device: Device | None = None
        self._reference: Triple | None = None
        self._asked = ""
        self._deflected: list[bool] = []
        self.controller: ControllerSetup | None = None
        self.limits: AxisLimits | None = None

    @property
    def connected(self) -> bool:
        return self._device is not None

    def connect(self, controller: ControllerSetup) -> AxisLimits:
        """Connect to the controller, and return the travel and the dynamics that it reports.

        Raises DeviceError if it cannot be reached, and ConfigurationError if its driver is not a machine.
        """
        with self._lock:
            self._close()
            device, limits = controller.open(self._directory)
            self._device, self.controller, self.limits = device, controller, limits
            return limits

    def close(self) -> None:
        """Disconnect, and forget what was read."""
        with self._lock:
            self._close()
            self.controller = self.limits = None

    def limits_of(self, controller: ControllerSetup, _: Path) -> AxisLimits:
        """Return what was read from `controller`. Raises DeviceError if nothing was."""
        if self.limits is None or self.controller != controller:
            raise LinkLost(NOT_CONNECTED, hint=CONNECT)
        return self.limits

    def position_mm(self) -> Triple:
        """Return the axis positions. Raises DeviceError if the controller is not connected or does not answer."""
        with self._lock:
            return self._position()

    def begin_jog(self, axis: str) -> None:
        """Record the present position as the start of a jog of `axis` by a person."""
        with self._lock:
            self._reference, self._asked = self._position(), axis

    def jog(self) -> Jog | None:
        """Return the jog since `begin_jog`, None if none was begun."""
        with self._lock:
            if self._reference is None:
                return None
            x, y, z = (now - former for now, former in zip(self._position(), self._reference, strict=True))
            return Jog(self._asked, (x, y, z))

    def begin_touch(self) -> None:
        """Forget the states of the probe input that were seen so far."""
        with self._lock:
            self._deflected.clear()

    def look_at_probe(self) -> ProbeFinding:
        """Read the probe input once more, and return what the states seen so far say.

        Raises CommandRejected if the controller has no probe input.
        """
        with self._lock:
            device = self._opened()
            if not isinstance(device, Probe):
                raise CommandRejected("this controller reports no probe input", hint="state how it was checked")
            with self._closed_on_failure():
                deflected = device.probe_status().deflected
            if deflected not in self._deflected[-1:]:
                self._deflected.append(deflected)
            return judge_trigger(self._deflected)

    @property
    def probe_finding(self) -> ProbeFinding:
        """Result of the states of the probe input seen so far."""
        return judge_trigger(tuple(self._deflected))

    def _position(self) -> Triple:
        device = self._opened()
        if not isinstance(device, Machine):
            raise CommandRejected("this controller reports no axis positions")
        with self._closed_on_failure():
            x, y, z = device.position().tolist()
        return x, y, z

    def _opened(self) -> Device:
        if self._device is None:
            raise LinkLost(NOT_CONNECTED, hint=CONNECT)
        return self._device

    @contextmanager
    def _closed_on_failure(self) -> Iterator[None]:
        """Close a device that fails in the `with` block, so that the next attempt connects anew. What was read remains
        known."""
        try:
            yield
        except DeviceError:
            self._close()
            raise

    def _close(self) -> None:
        device, self._device = self._device, None
        self._reference = None
        self._deflected.clear()
        if device is not None:
            device.close()
