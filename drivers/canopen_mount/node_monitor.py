"""Monitor of a CANopen node; it detects restarts, silence, emergency messages and changes of the network state."""

from __future__ import annotations

import structlog

from drivers.canopen_mount.emergency import emergency_text
from drivers.canopen_mount.node import NMT_OPERATIONAL, DriveNode
from drivers.canopen_mount.objects import STATUSWORD
from drivers.clock import Clock
from drivers.errors import MotionFault

_log = structlog.get_logger("canopen_mount")


class NodeMonitor:
    """Monitor of one CANopen node; the driver calls `check` repeatedly during every wait for the drive.

    The age of the latest heartbeat is measured on the given clock. A heartbeat may seem late only because this process
    was busy. Therefore the node is queried by an SDO request before it is declared lost.
    """

    def __init__(self, node: DriveNode, clock: Clock, *, timeout_s: float | None) -> None:
        self._node = node
        self._clock = clock
        self._timeout_s = timeout_s
        self._last_s = clock.now()
        self._silent = False

    def arm(self) -> None:
        self._node.take_boot_up()
        self._node.take_nmt_state()
        self._node.take_emergencies()
        self._last_s = self._clock.now()

    def check(self) -> list[int]:
        """Log and return the error codes of the emergency messages that the node has sent since the last call.

        Raises MotionFault if the node has restarted or left the network state (NMT state) *operational*. Raises
        LinkTimeout or LinkLost if the node no longer answers.
        """
        codes = [code for code in self._node.take_emergencies() if code]
        for code in codes:
            _log.warning("emergency", text=emergency_text(code), **self._node.where)
        if self._node.take_boot_up():
            raise MotionFault(
                "the drive has restarted",
                hint="check its supply; home the mount again before turning it",
                **self._node.where,
            )
        if (state := self._node.take_nmt_state()) not in (None, NMT_OPERATIONAL):
            raise MotionFault(
                f"the node has left the NMT state operational, its heartbeat reports 0x{state:02X}",
                hint="another CANopen master or the drive's own monitoring (0x1029, 0x1016) has stopped it",
                **self._node.where,
            )
        if self._node.take_heartbeat():
            self._note_heartbeat()
        elif self._timeout_s is not None and self._clock.now() - self._last_s > self._timeout_s:
            self._probe_by_sdo()
        return codes

    def _note_heartbeat(self) -> None:
        self._last_s = self._clock.now()
        if self._silent:
            self._silent = False
            _log.info("heartbeat available again", **self._node.where)

    def _probe_by_sdo(self) -> None:
        self._node.read(STATUSWORD)
        self._last_s = self._clock.now()
        if not self._silent:
            self._silent = True
            _log.warning("heartbeat missing, the drive still answers", **self._node.where)
