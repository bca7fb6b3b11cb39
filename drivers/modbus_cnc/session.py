"""Communication session with one Modbus controller: status images, heartbeats in both directions, commands and
acknowledgements.
"""

from __future__ import annotations

from collections.abc import Mapping

from drivers.clock import Clock, Deadline, wall_seconds
from drivers.errors import (
    CommandRejected,
    ConfigurationError,
    LinkLost,
    LinkTimeout,
    PermissionMissing,
    ProtocolError,
)
from drivers.links.modbus import ModbusLink
from drivers.links.reconnection import LINK_FAILURES, Reconnection
from drivers.modbus_cnc.codec import NumberFormat
from drivers.modbus_cnc.codes import (
    ACCEPTED,
    FAULT_HEARTBEAT_LOST,
    PERMISSION_MISSING,
    CommandCode,
    fault_text,
    result_text,
)
from drivers.modbus_cnc.registers import BlockLayouts, CommandBlock, ControllerLimits, StatusImage
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.roles import MotionState

# The controller writes an image within one cycle, so a second read normally finds it complete.
HALF_WRITTEN_READS = 5
MOST_OVERTAKEN = 4
"""Number of commands without an acknowledgement that are remembered; a stop and its repetitions overtake no more."""
URGENT_WITHIN_S = 1.0
"""Wall-clock time within which HOLD, RESUME and STOP must be acknowledged."""


class ModbusSession:
    """Communication session with one Modbus controller.

    All traffic passes through the session, so only the session sets the sequence numbers of commands and the driver's
    heartbeat.
    """

    def __init__(self, link: ModbusLink, clock: Clock, settings: ModbusCncSettings) -> None:
        self.link = link
        self.reconnection = link.reconnection or Reconnection(clock, max_attempts=0, max_s=0.0, where=link.where)
        self.reconnection.verify = self._require_same_controller
        self.clock = clock
        self.settings = settings
        self.where: Mapping[str, str] = link.where
        self.layouts = BlockLayouts(
            NumberFormat(settings.number_format, settings.number_scale, settings.word_order, settings.byte_order)
        )
        self._heartbeat = 0
        self._peer = PeerHeartbeat(clock, settings.heartbeat_timeout_s, link.where)
        self._sequence = 0
        self._results: dict[int, int] = {}
        self._unacknowledged = 0
        self._acknowledged = 0
        self._overtaken: list[int] = []
        """Numbers of commands that were not acknowledged when a later one was sent, or when the link was lost. The
        controller may still take them."""
        self._interruptions_at_send = 0

    def open(self, *, look_only: bool = False, tables: bool = False) -> StatusImage:
        """Connect, verify protocol and version of the register map, and continue from the sequence number that the
        controller last acknowledged.

        A number that this session has sent is not used again, as the controller may take that command only now: it
        would ignore another command with the same number, and its acknowledgement would be taken for that of the other.

        If the controller is in a fault only because the heartbeat of an earlier session was lost, the fault is cleared.
        If `look_only` is True, nothing is written, so the fault remains, and all commands are refused. With `tables`,
        the block that the read window shows can still be selected.
        """
        with self.reconnection.suspended():
            self.link.open(look_only=look_only, selectors=self.settings.blocks.selectors() if tables else ())
            status = self.read_status_unchecked()
        self._note_unacknowledged()
        if status.acknowledge not in (self._acknowledged, *self._overtaken) or self._has_restarted(status):
            self._sequence, self._overtaken = status.acknowledge, []
        self._acknowledged = status.acknowledge
        self._results = {status.acknowledge: status.result}
        if not look_only and status.state is MotionState.FAULT and status.fault_code == FAULT_HEARTBEAT_LOST:
            status = self.command(CommandBlock(CommandCode.RESET))
        return status

    def close(self) -> None:
        self.link.close()

    def status(self) -> StatusImage:
        """Read one status image. Writes nothing.

        The method checks that the controller's heartbeat has not stopped, and that the session knows the acknowledged
        sequence number.
        """
        return self._check_status(self.read_status_unchecked())

    def read_status_unchecked(self) -> StatusImage:
        """Read one status image without checking its heartbeat and acknowledgement.

        The two are not checked because another client may be using the controller.
        """
        return self._consistent_status(self._read_status())

    @property
    def interrupted_since_command(self) -> bool:
        """True if the link was interrupted and restored after the last command reached the controller."""
        return self.reconnection.count != self._interruptions_at_send

    @property
    def poll_wire_time_s(self) -> float:
        """Transmission time of one poll (write of the heartbeat and read of the status block) in s, or 0 if it is
        unknown.
        """
        return self.link.exchange_wire_time_s(1, self.layouts.status.size)

    def poll(self) -> StatusImage:
        """Write a new value of the driver's heartbeat, and read and check one status image."""
        return self.write_and_read_status(
            self.settings.blocks.command, self._next_heartbeat().to_bytes(2, "big"), idempotent=True
        )

    def write_and_read_status(self, register: int, data: bytes, *, idempotent: bool) -> StatusImage:
        blocks = self.settings.blocks
        answer = self.link.exchange(register, data, blocks.status, self.layouts.status.size, idempotent=idempotent)
        return self._check_status(self._consistent_status(answer))

    def command(self, command: CommandBlock, *, within_s: float | None = None) -> StatusImage:
        """Send a command, wait for its acknowledgement, and return the status image that contains it.

        Raises CommandRejected or PermissionMissing if the controller refuses the command.
        """
        return self.start(command, within_s=within_s)[1]

    def start(self, command: CommandBlock, *, within_s: float | None = None) -> tuple[int, StatusImage]:
        """Send a command, wait for its acknowledgement, and return its sequence number and the latest status image.

        The sequence number identifies the outcome of the command. The method raises the same exceptions as `command`.
        """
        sequence = self._next_sequence()
        status = self._send(command, sequence)
        allowed_s = within_s or self.settings.acknowledge_timeout_s
        deadline = Deadline.after(self.clock, allowed_s)
        pause_s = self.settings.fine_poll_interval_s
        while sequence not in self._results:
            if deadline.expired:
                raise self._not_acknowledged(CommandCode(command.code), allowed_s)
            self.clock.sleep(min(pause_s, deadline.remaining_s))
            pause_s = min(2.0 * pause_s, self.settings.poll_interval_s)
            status = self.poll()
        return sequence, self._accepted(command, self._results[sequence], status)

    def send_urgent(self, code: CommandCode) -> StatusImage:
        """Send the command HOLD, RESUME or STOP, and wait for the acknowledgement without sleeping on the clock.

        A hold or an abort may be requested from inside a sleep of the clock, and a second sleep there would recurse.
        HOLD and RESUME first wait until an earlier command is acknowledged. STOP does not wait, so it may overwrite an
        earlier command.
        """
        with self.reconnection.suspended():
            if code is not CommandCode.STOP and self._unacknowledged:
                self._await_without_sleeping(self._unacknowledged, code)
            sequence = self._next_sequence()
            status = self._send(CommandBlock(code), sequence)
            if sequence not in self._results:
                status = self._await_without_sleeping(sequence, code)
        return self._accepted(CommandBlock(code), self._results[sequence], status)

    def read_limits(self) -> ControllerLimits:
        data = self.link.read(self.settings.blocks.limits, self.layouts.limits.size)
        return ControllerLimits(*self.layouts.limits.unpack(data))

    def _require_same_controller(self) -> None:
        """Raise ProtocolError if the controller behind a restored link is not in the state in which it was left."""
        status = self.read_status_unchecked()
        # Another number means that another master has sent commands, or that the controller has restarted.
        if status.acknowledge not in (self._acknowledged, self._unacknowledged or self._acknowledged, *self._overtaken):
            raise self._foreign_sequence(status.acknowledge)

    def _send(self, command: CommandBlock, sequence: int) -> StatusImage:
        try:
            block = self.layouts.command.pack((self._next_heartbeat(), *command, sequence))
        except ValueError as error:
            raise ConfigurationError(
                f"{CommandCode(command.code).label}: a value does not fit the controller's registers",
                hint="set number to float64, or use a larger number_scale",
                **self.where,
            ) from error
        self._note_unacknowledged()
        self._unacknowledged = sequence
        self._interruptions_at_send = self.reconnection.count
        try:
            return self.write_and_read_status(self.settings.blocks.command, block, idempotent=False)
        except LINK_FAILURES as failure:
            if isinstance(failure, LinkLost) and not self.reconnection.available:
                raise
            # The acknowledged number tells whether the command was taken; reading it restores a lost connection.
            status = self.status()
        if sequence in self._results:
            return status
        # The request was lost, so send it again. If it did arrive: no number is executed twice (map, section 6).
        self._interruptions_at_send = self.reconnection.count
        return self.write_and_read_status(self.settings.blocks.command, block, idempotent=True)

    def _note_unacknowledged(self) -> None:
        """Note that the last command may still be taken, although it is not waited for any longer."""
        if self._unacknowledged:
            self._overtaken = [*self._overtaken, self._unacknowledged][-MOST_OVERTAKEN:]
            self._unacknowledged = 0

    def _await_without_sleeping(self, sequence: int, code: CommandCode) -> StatusImage:
        give_up_s = wall_seconds() + URGENT_WITHIN_S
        while True:
            status = self.poll()
            if sequence in self._results:
                return status
            if wall_seconds() > give_up_s:
                raise self._not_acknowledged(code, URGENT_WITHIN_S)

    def _accepted(self, command: CommandBlock, result: int, status: StatusImage) -> StatusImage:
        if result == ACCEPTED:
            return status
        label = CommandCode(command.code).label
        if result == PERMISSION_MISSING:
            missing = [name.value for name, given in status.permissions.items() if not given]
            raise PermissionMissing(
                f"{label} refused: {', '.join(missing) or 'a permission is missing'}",
                hint="grant the permission at the controller",
                **self.where,
            )
        fault = f"; controller in fault: {fault_text(status.fault_code)}" if status.fault_code else ""
        raise CommandRejected(f"{label} refused: {result_text(result)}{fault}", result=result, **self.where)

    def _not_acknowledged(self, code: CommandCode, allowed_s: float) -> LinkTimeout:
        return LinkTimeout(
            f"{code.label} (command {self._unacknowledged}) not acknowledged within {allowed_s:g} s",
            hint="check that the controller's program runs and handles commands",
            **self.where,
        )

    def _check_status(self, status: StatusImage) -> StatusImage:
        """Check the heartbeat and the acknowledgement of an image."""
        self._peer.observe(status.heartbeat)
        if status.acknowledge == self._unacknowledged != 0:
            self._results[status.acknowledge] = status.result
            self._acknowledged, self._unacknowledged = status.acknowledge, 0
            self._overtaken.clear()  # the controller handles one number at a time, and this one came last
            # a STOP may overtake a command, so a few earlier results are still asked for; older ones never are
            while len(self._results) > 4:
                del self._results[next(iter(self._results))]
        elif status.acknowledge in self._overtaken:
            self._results[status.acknowledge] = status.result
            self._acknowledged = status.acknowledge
            self._overtaken.remove(status.acknowledge)
        elif status.acknowledge not in self._results or self._has_restarted(status):
            raise self._foreign_sequence(status.acknowledge)
        return status

    def _is_own(self, status: StatusImage) -> bool:
        """Return True if the image acknowledges a command of this session, or if no session is open yet."""
        known = not self._results or status.acknowledge in (*self._results, self._unacknowledged, *self._overtaken)
        return known and not self._has_restarted(status)

    def _has_restarted(self, status: StatusImage) -> bool:
        """Return True if the controller has forgotten the acknowledged commands (map, section 6: 0 at power-up)."""
        return status.acknowledge == 0 != self._acknowledged

    def _foreign_sequence(self, acknowledged: int) -> ProtocolError:
        if acknowledged == 0:
            return ProtocolError(
                f"the controller was restarted: it has forgotten command {self._acknowledged}, which it had "
                "acknowledged",
                hint="reference the axes, check with `volcal doctor` which table is active, then continue with "
                "`volcal resume`",
                **self.where,
            )
        return ProtocolError(
            f"stale or foreign sequence number {acknowledged} acknowledged, last sent {self._sequence}",
            hint="another client sends commands; only one master is allowed",
            **self.where,
        )

    def _consistent_status(self, data: bytes) -> StatusImage:
        """Decode a status image. It is read again while it is half-written, and once if its contents are not possible,
        because Modbus TCP does not protect them against an altered byte.
        """
        doubted = False
        for _ in range(HALF_WRITTEN_READS):
            try:
                status = self._decoded(data)
            except ProtocolError:
                if doubted:
                    raise
                doubted = True
            else:
                if status.is_consistent and (doubted or self._is_own(status)):
                    return status
                doubted = doubted or status.is_consistent
            data = self._read_status()
        status = self._decoded(data)
        if status.is_consistent:
            return status
        raise ProtocolError(
            f"the status image remains half-written: heartbeat {status.heartbeat}, copy {status.heartbeat_copy}",
            register=self.settings.blocks.status,
            **self.where,
        )

    def _read_status(self) -> bytes:
        return self.link.read(self.settings.blocks.status, self.layouts.status.size)

    def _decoded(self, data: bytes) -> StatusImage:
        return self.layouts.decode_status(data, self.where, self.settings.blocks.status)

    def _next_heartbeat(self) -> int:
        self._heartbeat = (self._heartbeat + 1) & 0xFFFF
        return self._heartbeat

    def _next_sequence(self) -> int:
        # 1 … 65535: 0 means that the controller has acknowledged nothing yet
        self._sequence = self._sequence % 0xFFFF + 1
        return self._sequence


class PeerHeartbeat:
    """Monitor that raises LinkLost if a controller's heartbeat (a counter) has not changed for more than `lost_after_s`
    seconds.

    If more than `lost_after_s` seconds pass between two calls of `observe`, an unchanged heartbeat proves nothing, and
    the monitor restarts its measurement of time.
    """

    def __init__(self, clock: Clock, lost_after_s: float, where: Mapping[str, str]) -> None:
        self._clock = clock
        self._lost_after_s = lost_after_s
        self._where = where
        self._value = -1
        self._changed_s = 0.0
        self._observed_s = float("-inf")

    def observe(self, value: int) -> None:
        now_s = self._clock.now()
        watching = now_s - self._observed_s <= self._lost_after_s
        self._observed_s = now_s
        if value != self._value or not watching:
            self._value, self._changed_s = value, now_s
        elif now_s - self._changed_s > self._lost_after_s:
            raise LinkLost(
                f"the controller's heartbeat has been stuck at {value} for {now_s - self._changed_s:.1f} s",
                hint="its Modbus server answers, but its program does not run; check the controller",
                **self._where,
            )
