"""Rotary mount with two drives that turn and stop together; angles in degrees."""

from __future__ import annotations

from collections.abc import Sequence

import structlog

from drivers.canopen_mount.description import load_description
from drivers.canopen_mount.diagnosis import diagnose_drive
from drivers.canopen_mount.drive import POLL_S, Drive
from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import Clock, Deadline
from drivers.errors import CommandRejected, DeviceError, LinkLost, VolcalError
from drivers.links.can_adapters import CanAddress
from drivers.links.can_bus import PROCESS_NETWORKS, CanLink, CanNetworks
from drivers.reached_position import ROUNDING, require_reached
from drivers.registry import DeviceContext
from drivers.roles import DiagnosticFinding, Orientation

MAX_POLL_S = 0.4
"""Longest pause in s between two polls of a turning drive."""

LISTEN_S = 0.5
"""Wall time in s for which the bus is listened to before it is read; a client that turns a drive polls more often."""

_log = structlog.get_logger("canopen_mount")


class CanopenMount:
    """Rotary mount whose two drives are on a CAN bus.

    `stop` may be called while another thread waits for the end of a motion.
    """

    def __init__(
        self, settings: CanopenMountSettings, context: DeviceContext, networks: CanNetworks = PROCESS_NETWORKS
    ) -> None:
        self._settings = settings
        self._context = context
        self._clock: Clock = context.clock
        self._networks = networks
        self._address = CanAddress.of(settings.interface, settings.channel, settings.options)
        self._link: CanLink | None = None
        self._drives: tuple[Drive, ...] = ()
        self._look_only = False
        self._turning = False

    def open(self) -> None:
        """Connect to the bus, verify the identity and the units of both drives, and start their heartbeats.

        The drives do not move.
        """
        if self._link is not None:
            return
        self._connect()
        try:
            for drive in self._drives:
                drive.verify()
            for drive in self._drives:
                drive.prepare()
        except BaseException:
            self._disconnect()
            raise

    def why_no_look(self) -> str:
        return ""

    def open_to_look(self, *, tables: bool = False) -> None:
        """Connect to the bus and read the identity, state and angle of both drives by SDO uploads alone. No other frame
        is sent, so the nodes keep their network state.

        A drive has one SDO channel, on which two clients would take each other's answers. So the bus is listened to
        first. Raises CommandRejected if another client exchanges data with a drive.
        """
        if self._link is not None:
            return
        self._connect(look_only=True)
        try:
            self._require_no_other_client()
            for drive in self._drives:
                drive.look()
        except BaseException as error:
            self._disconnect()
            if isinstance(error, DeviceError):
                error.at(device=self._context.name)
            raise

    def _require_no_other_client(self) -> None:
        link = self._link
        busy = None if link is None else link.await_exchange([drive.node.node_id for drive in self._drives], LISTEN_S)
        if busy is not None:
            raise CommandRejected(
                f"another program exchanges data with node {busy}, so the mount is not read meanwhile",
                hint="wait until it has ended",
                link=self._address.name,
            )

    def close(self) -> None:
        """Switch off the power of both motors and release the bus.

        If a drive cannot be reached, the failure is logged and no error is raised.
        """
        for drive in self._drives:
            try:
                drive.release()
            except DeviceError as error:
                _log.warning("drive not released", error=str(error))
        self._disconnect()

    def stop(self) -> None:
        """Command a quick stop of both drives; repeated calls have no further effect.

        The second drive is stopped even if the first one cannot be stopped. If the link is lost, the bus is opened
        again for the stop; the mount must be opened again afterwards. The first error is raised after all attempts.
        Does nothing if the mount is open only to look.
        """
        if self._look_only:
            return
        failures = self._quick_stop()
        if any(isinstance(failure, LinkLost) for failure in failures):
            self._disconnect()
            try:
                self._connect()
                failures = self._quick_stop()
            except DeviceError as error:
                failures = [error]
            finally:
                self._disconnect()
        if failures:
            raise failures[0].at(device=self._context.name)

    def _quick_stop(self) -> list[DeviceError]:
        """Command a quick stop of both drives and return the errors."""
        failures: list[DeviceError] = []
        for drive in self._drives:
            try:
                drive.quick_stop()
            except DeviceError as error:
                failures.append(error)
        return failures

    def impairments(self) -> list[str]:
        """Return one text for each drive whose heartbeat is missing although it answers."""
        return [text for drive in self._drives if (text := drive.impairment())]

    def home(self) -> None:
        """Home the drives that need homing, one after the other.

        A drive with an absolute encoder needs no homing; it is only enabled.
        """
        drives = self._require_open_for_a_run()
        try:
            for drive in drives:
                drive.enable()
                self._home_one(drive)
        except BaseException as error:
            self._stop_after_error(error)
            raise

    def orient_to(self, azimuth_deg: float, elevation_deg: float) -> Orientation:
        """Turn both axes together, wait until they are in position and settled, and return their encoder angles.

        Raises CommandRejected, before anything is sent, if a limit is exceeded or an axis is not homed. Raises
        MotionFault, DeadlineExpired or LinkError if the turn fails. If an exception ends the wait, both drives are
        stopped before the exception propagates.
        """
        drives = self._require_open_for_a_run()
        targets = (azimuth_deg, elevation_deg)
        for drive, target in zip(drives, targets, strict=True):
            drive.require_within_limits(target)
            drive.require_homed()
        try:
            for drive in drives:
                drive.enable()
            durations = [drive.start_turn(target) for drive, target in zip(drives, targets, strict=True)]
            self._turning = True
            try:
                self._await_end_of_turn(max(durations))
            finally:
                self._turning = False
            self._clock.sleep(self._settings.settle_s)
            return self._settled(targets)
        except BaseException as error:
            self._stop_after_error(error)
            raise

    def hold_turn(self) -> None:
        """Brake the turn of both axes. Does nothing if no turn is in progress; a homing cannot be held."""
        for drive in self._drives if self._turning else ():
            drive.hold_turn()

    def resume_turn(self) -> None:
        for drive in self._drives if self._turning else ():
            drive.resume_turn()

    def orientation(self) -> Orientation:
        azimuth, elevation = self._require_open()
        return Orientation(azimuth.angle_deg(), elevation.angle_deg())

    def diagnose(self) -> list[DiagnosticFinding]:
        """Diagnose the CAN adapter and the drives by reading only.

        If the mount is closed, it is connected for the diagnosis and disconnected afterwards.
        """
        was_open = self._link is not None
        try:
            if not was_open:
                self._connect()
            return [*self._adapter(), *(finding for drive in self._drives for finding in diagnose_drive(drive))]
        except VolcalError as error:
            return [DiagnosticFinding(self._address.name, ok=False, text=str(error))]
        finally:
            if not was_open:
                self._disconnect()

    def _adapter(self) -> list[DiagnosticFinding]:
        text = self._link.adapter_status_text() if self._link is not None else ""
        return [DiagnosticFinding(self._address.name, ok=text.endswith("no error"), text=text)] if text else []

    def _connect(self, *, look_only: bool = False) -> None:
        self._link = link = self._networks.acquire(self._address)
        self._look_only = look_only
        drives: list[Drive] = []
        try:
            for axis in ("azimuth", "elevation"):
                drives.append(self._drive(link, axis))
        except BaseException:
            self._disconnect()
            raise
        self._drives = tuple(drives)

    def _drive(self, link: CanLink, axis: str) -> Drive:
        settings = self._settings.azimuth if axis == "azimuth" else self._settings.elevation
        description = load_description(settings, self._context.base_path)
        node = DriveNode(
            link,
            settings.node_id,
            axis,
            description.dictionary,
            sdo_timeout_s=self._settings.sdo_timeout_s,
            look_only=self._look_only,
        )
        return Drive(
            node,
            description.with_identity(settings),
            self._clock,
            heartbeat_ms=self._settings.heartbeat_ms,
            heartbeat_timeout_s=self._settings.heartbeat_timeout_s,
            tolerated_emergencies=self._settings.tolerated_emergencies,
        )

    def _disconnect(self) -> None:
        self._drives, self._look_only = (), False
        link, self._link = self._link, None
        if link is not None:
            link.close()

    def _require_open(self) -> tuple[Drive, Drive]:
        if len(self._drives) != 2:
            raise LinkLost("the mount is not open", device=self._context.name, hint="open the device first")
        azimuth, elevation = self._drives
        return azimuth, elevation

    def _require_open_for_a_run(self) -> tuple[Drive, Drive]:
        drives = self._require_open()
        if self._look_only:
            raise CommandRejected(
                "refused by a mount that was opened only to read",
                hint="close it and open it for a run",
                device=self._context.name,
            )
        return drives

    def _home_one(self, drive: Drive) -> None:
        homing = drive.settings.homing
        if homing is None:
            return
        drive.start_homing(homing)
        deadline = Deadline.after(self._clock, homing.timeout_s)
        while not drive.homing_ended():
            deadline.raise_if_expired(
                "homing to end", hint="check the reference switch and its cable", **drive.node.where
            )
            self._clock.sleep(POLL_S)

    def _await_end_of_turn(self, predicted_s: float) -> None:
        """Sleep in slices until the predicted end, then poll every 20 ms until both targets are reached."""
        predicted = Deadline.after(self._clock, predicted_s)
        deadline = Deadline.after(self._clock, 1.5 * predicted_s + self._settings.turn_margin_s)
        turning = list(self._drives)
        while turning:
            self._clock.sleep(max(POLL_S, min(MAX_POLL_S, predicted.remaining_s)))
            turning = [drive for drive in turning if not drive.turn_ended()]
            for drive in self._drives:
                drive.check_in_motion()
            if turning and deadline.expired:
                late = turning[0]
                deadline.raise_if_expired(
                    f"{late.node.axis} to reach its target (statusword bit 10), {late.describe_unreached_target()}",
                    hint="check that the mount is free to turn, its brake is released and nothing is jammed",
                    **late.node.where,
                )

    def _settled(self, targets: tuple[float, float]) -> Orientation:
        deadline = Deadline.after(self._clock, self._settings.in_position_timeout_s)
        while True:
            angles = [drive.angle_deg() for drive in self._drives]
            limits = [drive.settings.in_position_deg for drive in self._drives]
            outside = [abs(a - t) - w for a, t, w in zip(angles, targets, limits, strict=True)]
            if max(outside) <= ROUNDING:
                return Orientation(*angles)
            if deadline.expired:
                self._raise_not_reached(outside.index(max(outside)), angles, targets)
            self._clock.sleep(POLL_S)
            for other in self._drives:
                other.check_in_motion()

    def _raise_not_reached(self, number: int, angles: Sequence[float], targets: Sequence[float]) -> None:
        drive = self._drives[number]
        require_reached(
            (angles[number],),
            (targets[number],),
            drive.settings.in_position_deg,
            "the turn",
            {**drive.node.where, "device": self._context.name},
            key="in_position_deg",
            axes=(drive.node.axis,),
            unit="degrees",
            hint="check that the mount is free to turn and balanced, the brake, the controller gains of the drive, and "
            "that the encoder is not slipping",
        )

    def _stop_after_error(self, error: BaseException) -> None:
        """Stop both drives before `error` propagates; if a stop fails, add a note to `error`."""
        if isinstance(error, DeviceError):
            error.at(device=self._context.name)
        try:
            self.stop()
        except DeviceError as failure:
            _log.error("quick stop failed", error=str(failure))
            error.add_note(f"quick stop failed too: {failure}")
