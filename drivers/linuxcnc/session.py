"""Session with LinuxCNC that all parts of the driver share.

It contains the link to the bridge, the clock, the settings and the properties of the machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.clock import Clock, Deadline
from drivers.errors import CommandRejected, ConfigurationError, LinkLost, ProtocolError
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.linuxcnc.snapshot import ON, Snapshot, parse_snapshot
from drivers.roles import AxisLimits, HomingDirections, Permission

XYZ = "XYZ"
XYZ_MASK = 0b111


@dataclass(frozen=True)
class MachineProperties:
    """Properties of the machine that do not change while LinuxCNC runs.

    `absolute_encoders` is True if every joint has an absolute encoder. `homing_directions` are the signs of
    HOME_SEARCH_VEL of the joints 0 to 2, which move X, Y and Z on a machine of three slides.
    """

    limits: AxisLimits
    mm_per_unit: float
    servo_period_s: float
    absolute_encoders: bool
    homing_directions: HomingDirections
    machine_name: str


class LinuxCncSession:
    """Session with LinuxCNC, which is open while the bridge process runs.

    Positions are in mm for any setting of LINEAR_UNITS in the INI file.
    """

    def __init__(self, link: BridgeLink, clock: Clock, settings: LinuxCncSettings) -> None:
        self.link = link
        self.clock = clock
        self.settings = settings
        self.where = link.where
        self._properties: MachineProperties | None = None
        self._pins = settings.pins()

    def open(self, *, look_only: bool = False) -> None:
        """Start the bridge process and read the properties of the machine. If `look_only` is True, only queries are
        possible until the link is closed.

        Raises LinkLost if LinuxCNC does not run. Raises ConfigurationError if the machine that LinuxCNC controls is not
        the one named in the settings, or if it lacks one of the axes X, Y and Z.
        """
        self.link.open(look_only=look_only)
        self._properties = self._read_properties()
        expected = self.settings.machine_name
        if expected is not None and self._properties.machine_name != expected:
            raise ConfigurationError(
                f"LinuxCNC runs machine {self._properties.machine_name!r}, not {expected!r}",
                hint=f"started from {self.link.hello['ini']}",
                key="machine_name",
                **self.where,
            )

    @property
    def properties(self) -> MachineProperties:
        if self._properties is None:
            raise LinkLost("the device is not open", hint="open it first", **self.where)
        return self._properties

    def read_snapshot(self) -> Snapshot:
        return parse_snapshot(self.link.ask("status", pins=self._pins), self.properties.mm_per_unit, self.where)

    def permissions(self, snapshot: Snapshot) -> dict[Permission, bool]:
        """Return, for each permission to move the machine, True if it is granted and False otherwise.

        A permission is a condition that must be met before the machine may move, for example closed doors. It follows
        from the state of LinuxCNC in `snapshot`. If a HAL pin is configured for the permission, this pin must also be
        true.
        """
        on = snapshot.task_state == ON
        given = dict.fromkeys(Permission, True) | {
            Permission.AUTOMATIC: on,
            Permission.SPINDLE_STOPPED: not snapshot.spindle,
            Permission.PROGRAM_IDLE: snapshot.mode != "auto" or snapshot.idle,
            Permission.REFERENCED: snapshot.homed,
            Permission.NO_FAULT: not snapshot.fault,
        }
        named = self.settings.permissions.named()
        for permission, value in zip(named, snapshot.pins, strict=False):
            given[permission] = bool(value) and given[permission]
        return given

    def probe_healthy(self, snapshot: Snapshot) -> bool:
        """Return True if the HAL pin for the health of the probe is true, or if no such pin is configured."""
        return self.settings.probe_healthy is None or bool(snapshot.pins[-1])

    def home(self) -> None:
        """Home all joints in the sequence of the INI file, and return when they are homed. The axes may move.

        Raises CommandRejected if homing fails, and DeadlineExpired if it takes too long.
        """
        self.link.ask("home")
        deadline = Deadline.after(self.clock, self.settings.homing_timeout_s)
        messages: tuple[str, ...] = ()
        try:
            while True:
                snapshot = self.read_snapshot()
                messages += snapshot.errors
                if snapshot.homed and not snapshot.homing:
                    return
                if messages and not snapshot.homing:
                    raise CommandRejected(f"homing failed: {'; '.join(messages)}", hint="check LinuxCNC", **self.where)
                deadline.raise_if_expired("the joints to be homed", hint="check LinuxCNC", **self.where)
                self.clock.sleep(self.settings.poll_interval_s)
        except BaseException:
            if self.link.connected:
                self.link.ask("abort")
            raise

    def _read_properties(self) -> MachineProperties:
        hello = self.link.hello
        if hello["axis_mask"] & XYZ_MASK != XYZ_MASK:
            raise ConfigurationError("LinuxCNC has no axes X, Y, Z", hint="see [TRAJ]COORDINATES", **self.where)
        mm = 1.0 / self._number(hello["linear_units"], "linear_units")
        axes = [(f"AXIS_{name}", key) for name in XYZ for key in ("MAX_VELOCITY", "MAX_ACCELERATION")]
        encoders = [(f"JOINT_{number}", "HOME_ABSOLUTE_ENCODER") for number in range(hello["joints"])]
        searches = [(f"JOINT_{number}", "HOME_SEARCH_VEL") for number in range(3)]
        single = [("EMCMOT", "SERVO_PERIOD"), ("EMC", "MACHINE"), ("TRAJ", "MAX_LINEAR_VELOCITY")]
        reported = self.link.ask("ini", keys=[*axes, *encoders, *searches, *single])["values"]
        values = dict(zip([*axes, *encoders, *searches, *single], reported, strict=True))
        dynamics = [self._number(values[key], f"[{key[0]}]{key[1]}") * mm for key in axes]
        fastest = values["TRAJ", "MAX_LINEAR_VELOCITY"]
        cap = math.inf if fastest is None else self._number(fastest, "[TRAJ]MAX_LINEAR_VELOCITY") * mm
        limits = hello["limits"]
        vx, ax, vy, ay, vz, az = dynamics
        return MachineProperties(
            limits=AxisLimits(
                lower_mm=(limits[0][0] * mm, limits[1][0] * mm, limits[2][0] * mm),
                upper_mm=(limits[0][1] * mm, limits[1][1] * mm, limits[2][1] * mm),
                rapid_mm_per_s=(min(vx, cap), min(vy, cap), min(vz, cap)),
                acceleration_mm_per_s2=(ax, ay, az),
            ),
            mm_per_unit=mm,
            servo_period_s=1e-9 * self._number(values["EMCMOT", "SERVO_PERIOD"], "[EMCMOT]SERVO_PERIOD"),
            absolute_encoders=all(values[key] == "2" for key in encoders),
            homing_directions=_signs(*(values[key] for key in searches)),
            machine_name=values["EMC", "MACHINE"] or "",
        )

    def _number(self, reported: object, place: str) -> float:
        """Parse a positive number from the INI file or the status. Raises ProtocolError if it is not one."""
        try:
            value = float(str(reported).split("#")[0])
        except ValueError:
            value = math.nan
        if not 0.0 < value < math.inf:
            raise ProtocolError(f"LinuxCNC states {place} as {reported!r}", hint="check its INI file", **self.where)
        return value


def _signs(x: str | None, y: str | None, z: str | None) -> HomingDirections:
    return _sign(x), _sign(y), _sign(z)


def _sign(reported: str | None) -> int:
    """Return the sign of a number from the INI file; 0 if it is missing or no number."""
    try:
        value = float(str(reported).split("#")[0])
    except ValueError:
        return 0
    return (value > 0.0) - (value < 0.0)
