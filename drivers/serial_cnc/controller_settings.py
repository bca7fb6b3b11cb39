"""Settings of a GRBL or grblHAL controller (``$`` numbers), and checks for values that would make probing wrong or
impossible.

Sources: gnea/grbl, doc/markdown/settings.md; grblHAL/core settings.h (`reportmask_t`) for bits that GRBL does not have,
machine_limits.c (`limits_set_work_envelope`) for its soft limits.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from drivers.roles import AxisLimits, DiagnosticFinding, HomingDirections, Vector
from drivers.serial_cnc.lines import MessageLine, SettingLine

REPORT_MASK, REPORT_INCHES = 10, 13
SOFT_LIMITS, HARD_LIMITS, HOMING, HOMING_DIRECTION, PULL_OFF = 20, 21, 22, 23, 27
HOMING_CYCLES = (44, 45, 46)
"""Settings of grblHAL with the axes that home in each cycle."""
IDLE_DELAY, DIRECTION, LASER_MODE = 1, 3, 32
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
NEEDED = (REPORT_MASK, REPORT_INCHES, SOFT_LIMITS, HOMING, *(b + a for b in (100, 110, 120, 130) for a in range(3)))

ALWAYS_ON_MS = 255
COARSEST_STEP_MM = 0.0011
"""Largest acceptable motor step in mm.

A latched position is a whole number of steps, and it is reported with three decimals.
"""
HAL_FIELDS = {1: "machine position", 16: "input pins", 32: "work offset", 128: "probe result"}
HAL_ORIGIN_AT_HOME = 8
"""Bit of ``$22`` in grblHAL that puts machine zero at the home position.

In GRBL this is a build option, reported by ``Z`` in ``[OPT:``.
"""
AXES = "XYZ"
HOMING_OFF = (
    "$22=0: homing is off, so the machine zero is not reproducible; set $22=1 and home the machine ($H), or set "
    "manual_referencing if the machine has no homing switches"
)
REPORT_ROUNDING_MM = 5e-4
"""Half of the last decimal of a reported position."""
SINGLE_PRECISION = 2.0**-24
"""Largest relative rounding error of a number of single precision."""


@dataclass(frozen=True)
class ControllerSettings:
    """Settings of a GRBL or grblHAL controller, read from its answers to ``$$`` and ``$I``.

    `values` maps the ``$`` number of each setting to its value. `hal` is True for grblHAL, whose bit masks have more
    bits than those of GRBL.
    """

    values: Mapping[int, float]
    version: str
    options: str
    hal: bool

    @classmethod
    def of(cls, lines: Iterable[MessageLine | SettingLine]) -> ControllerSettings:
        """Return the settings contained in `lines`. Settings that are not numbers (names, passwords) are omitted."""
        values: dict[int, float] = {}
        version = options = ""
        hal = False
        for line in lines:
            match line:
                case SettingLine(number, text) if (value := _number(text)) is not None:
                    values[number] = value
                case MessageLine("VER", text):
                    version = text.strip(":")
                case MessageLine("OPT", text):
                    options = text
                case MessageLine("FIRMWARE", text):
                    hal = "HAL" in text
                case _:
                    pass
        return cls(values, version, options, hal)

    @property
    def missing(self) -> tuple[int, ...]:
        return tuple(number for number in NEEDED if number not in self.values)

    @property
    def homes(self) -> bool:
        return bool(int(self.values[HOMING]) & 1)

    @property
    def homing_directions(self) -> HomingDirections:
        """Direction in which X, Y and Z search their switches: 1 towards the upper end of travel, -1 towards the lower
        end if the bit of the axis in ``$23`` is set."""
        x, y, z = (-1 if int(self.values.get(HOMING_DIRECTION, 0.0)) >> axis & 1 else 1 for axis in range(3))
        return x, y, z

    @property
    def position_in_machine(self) -> bool:
        """True if status reports give machine positions (MPos) instead of work positions (WPos)."""
        return bool(int(self.values[REPORT_MASK]) & 1)

    @property
    def inches(self) -> bool:
        return bool(self.values[REPORT_INCHES])

    def step_mm(self, axis: int) -> float:
        return 1.0 / self.values[STEPS + axis]

    def stand_at(self, reported_mm: Vector, target_mm: Vector) -> bool:
        """Return True if axes with the reported position may stand on the steps of `target_mm`.

        Both are machine coordinates in mm, shape (3,). The report is rounded to three decimals, and the controller
        computes in single precision.
        """
        for axis, (reported, target) in enumerate(zip(reported_mm.tolist(), target_mm.tolist(), strict=True)):
            step = self.step_mm(axis)
            rounding = REPORT_ROUNDING_MM + self.values[TRAVEL + axis] * SINGLE_PRECISION
            if abs(step * round(target / step) - reported) > rounding:
                return False
        return True

    def _pull_off_mm(self, axis: int) -> float:
        """Return the distance by which the soft limits of grblHAL end before the switches.

        With hard limits it keeps away from the switches of the axes that it homes.
        """
        homed = [int(self.values[number]) for number in HOMING_CYCLES if number in self.values]
        homes = not homed or any(mask >> axis & 1 for mask in homed)
        keeps_away = self.hal and homes and int(self.values.get(HARD_LIMITS, 0.0)) & 1
        return self.values.get(PULL_OFF, 0.0) if keeps_away else 0.0

    def limits(self, axis_zero_mm: tuple[float, float, float]) -> AxisLimits:
        """Return the travel in displayed axis positions, and the limits of speed and acceleration.

        `axis_zero_mm` holds the machine coordinates of the displayed position 0. Machine zero is at the upper end of
        travel, unless the controller sets machine zero at the home position.
        """
        at_home = int(self.values[HOMING]) & HAL_ORIGIN_AT_HOME if self.hal else "Z" in self.options.split(",")[0]
        lower, upper = [], []
        for axis, zero in enumerate(axis_zero_mm):
            travel, pull_off = self.values[TRAVEL + axis], self._pull_off_mm(axis)
            upwards = at_home and int(self.values.get(HOMING_DIRECTION, 0.0)) >> axis & 1
            lower.append((0.0 if upwards else pull_off - travel) - zero)
            upper.append((travel - pull_off if upwards else 0.0 if at_home else -pull_off) - zero)
        rates = [self.values[RATE + axis] / 60.0 for axis in range(3)]
        accelerations = [self.values[ACCELERATION + axis] for axis in range(3)]
        return AxisLimits(_triple(lower), _triple(upper), _triple(rates), _triple(accelerations))

    def fatal(self) -> str:
        """Return the reason why probing is impossible, or an empty string if it is possible.

        Probing is impossible if a setting is missing or invalid, or if the controller reports positions in inches or as
        work positions.
        """
        if self.missing:
            return f"the controller does not report ${', $'.join(map(str, self.missing))}"
        if self.inches:
            return "$13=1: positions are reported in inches, to 2.5 µm; set $13=0"
        if not self.position_in_machine:
            return f"$10={self.values[REPORT_MASK]:g}: reports give work positions, not machine positions; add 1 to $10"
        if min(self.values[base + axis] for base in (STEPS, RATE, ACCELERATION, TRAVEL) for axis in range(3)) <= 0.0:
            return "steps, rates, accelerations and travels ($100 to $132) must be positive"
        return ""

    def findings(self, *, manual_referencing: bool) -> Iterator[DiagnosticFinding]:
        """Yield one diagnostic finding for each group of settings. The finding about an unsuitable setting states the
        value to set.
        """
        fatal = self.fatal()
        if fatal:
            yield DiagnosticFinding("settings", ok=False, text=fatal)
        if self.missing:
            return
        yield self._reports()
        homes = self.homes or manual_referencing
        text = "homes with switches" if self.homes else HOMING_OFF
        by_hand = "referenced by hand" if not self.homes else f"{text} (referenced by hand)"
        yield DiagnosticFinding("homing", ok=homes, text=by_hand if manual_referencing else text)
        soft = bool(self.values[SOFT_LIMITS])
        yield DiagnosticFinding(
            "soft limits",
            ok=soft,
            text="on" if soft else "$20=0: the controller does not guard the travel; set $20=1",
        )
        yield self._directions()
        yield self._steps()
        yield self._idle()
        if self.values.get(LASER_MODE):
            yield DiagnosticFinding(
                "laser mode", ok=False, text="$32=1: motion does not stop for the spindle; set $32=0"
            )

    def _reports(self) -> DiagnosticFinding:
        mask = int(self.values[REPORT_MASK])
        missing_fields = [name for bit, name in HAL_FIELDS.items() if self.hal and not mask & bit]
        if missing_fields:
            required_mask = mask | sum(HAL_FIELDS)
            return DiagnosticFinding(
                "reports", ok=False, text=f"$10={mask} leaves out {', '.join(missing_fields)}; set $10={required_mask}"
            )
        return DiagnosticFinding("reports", ok=bool(mask & 1), text=f"$10={mask}, $13={self.values[REPORT_INCHES]:g}")

    def _directions(self) -> DiagnosticFinding:
        """State where the axes home and which are inverted; only a jog shows whether this agrees with the machine."""
        lower = int(self.values.get(HOMING_DIRECTION, 0.0))
        ends = ", ".join(f"{name} {'lower' if lower >> axis & 1 else 'upper'}" for axis, name in enumerate(AXES))
        shrunk = [f"{name} {self._pull_off_mm(axis):g} mm" for axis, name in enumerate(AXES) if self._pull_off_mm(axis)]
        pull_off = f"; soft limits end before the switches ($21, $27): {', '.join(shrunk)}" if shrunk else ""
        text = f"homing ends ($23): {ends}; inverted axes: $3={self.values.get(DIRECTION, 0.0):g}{pull_off}"
        return DiagnosticFinding("directions", ok=True, text=f"{text}; jog each axis towards + and watch it")

    def _steps(self) -> DiagnosticFinding:
        sizes = [self.step_mm(axis) if self.values[STEPS + axis] > 0.0 else math.inf for axis in range(3)]
        text = ", ".join(f"{axis} {1e3 * size:.3g} µm" for axis, size in zip(AXES, sizes, strict=True))
        fine = max(sizes) <= COARSEST_STEP_MM
        return DiagnosticFinding(
            "steps", ok=fine, text=text if fine else f"{text}: limits the resolution of a touch ($100 to $102)"
        )

    def _idle(self) -> DiagnosticFinding:
        delay = self.values.get(IDLE_DELAY, float(ALWAYS_ON_MS))
        on = delay >= ALWAYS_ON_MS
        text = f"$1={delay:g}" + ("" if on else ": motors are released at rest and axes may shift; set $1=255")
        return DiagnosticFinding("motors at rest", ok=on, text=text)


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _triple(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z
