"""The `$` settings of a simulated GRBL 1.1 or grblHAL.

Source: gnea/grbl, doc/markdown/settings.md and doc/csv/setting_codes_en_US.csv; grblHAL/core, settings.h.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from drivers.roles import AxisLimits
from simulators.wire.grbl.dialect import GRBL_11, GRBL_HAL, GrblDialect

INTEGERS = frozenset({0, 1, 2, 3, 4, 5, 6, 10, 13, 20, 21, 22, 23, 26, 32, 40, 43, 44, 45, 46})
BOOLEANS = frozenset({4, 5, 6, 13, 20, 21, 22, 32})
HAL_DEFAULTS = {10: 511, 21: 0, 40: 0, 43: 1, 44: 4, 45: 3, 46: 0}
"""Settings of grblHAL that GRBL 1.1 lacks or in which its bit mask is longer: ``$44`` to ``$46`` are the axes that home
in each cycle.
"""
HAL_MASKS = frozenset({4, 5, 6, 20, 21, 22})
"""Settings that are one bit in GRBL 1.1 and a bit mask in grblHAL."""
HARD_LIMITS, PULL_OFF = 21, 27
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
SHORTEST_PULSE_US = 3.0

NEGATIVE_VALUE, PULSE_TOO_SHORT, NOT_RECOGNISED, BAD_NUMBER, SOFT_LIMITS_NEED_HOMING = 4, 6, 3, 2, 10


class SettingRefusedError(Exception):
    """Error for a `$` setting that the simulated GRBL refuses. `code` is the number after ``error:``."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class GrblSettings:
    """The `$` settings of a simulated controller, for axes with the limits `limits`.

    Homing and soft limits are enabled. The default resolution is 1000 steps per mm.
    """

    def __init__(self, limits: AxisLimits, steps_per_mm: float = 1000.0, dialect: GrblDialect = GRBL_11) -> None:
        self.dialect = dialect
        self._booleans = BOOLEANS - HAL_MASKS if dialect is GRBL_HAL else BOOLEANS
        self._values: dict[int, float] = {
            0: 10, 1: 255, 2: 0, 3: 0, 4: 0, 5: 0, 6: 0, 10: 1, 11: 0.010, 12: 0.002, 13: 0,
            20: 1, 21: 1, 22: 1, 23: 0, 24: 25.0, 25: 500.0, 26: 250, 27: 1.0, 30: 1000.0, 31: 0.0, 32: 0,
        }  # fmt: skip
        if dialect is GRBL_HAL:
            self._values.update(HAL_DEFAULTS)
        for axis in range(3):
            self._values[STEPS + axis] = steps_per_mm
            self._values[RATE + axis] = 60.0 * limits.rapid_mm_per_s[axis]
            self._values[ACCELERATION + axis] = limits.acceleration_mm_per_s2[axis]
            self._values[TRAVEL + axis] = limits.upper_mm[axis] - limits.lower_mm[axis]

    def __getitem__(self, number: int) -> float:
        return self._values[number]

    def flag(self, number: int) -> bool:
        return bool(self._values[number])

    def axes(self, first: int) -> tuple[float, float, float]:
        """Return the values of X, Y, Z for the group of settings whose number for X is `first`.

        The group 100 holds the steps per mm, 110 the maximum rates, 120 the accelerations, and 130 the travels.
        """
        return self._values[first], self._values[first + 1], self._values[first + 2]

    def change(self, values: Mapping[int, float]) -> None:
        """Store several settings, as a person at a terminal would. Raises SettingRefusedError if GRBL refuses a
        setting.
        """
        for number, value in values.items():
            self.store(number, value)

    def store(self, number: int, value: float) -> None:
        if value < 0.0:
            raise SettingRefusedError(NEGATIVE_VALUE)
        if number not in self._values:
            raise SettingRefusedError(NOT_RECOGNISED)
        if not math.isfinite(value):
            raise SettingRefusedError(BAD_NUMBER)
        if number == 0 and value < SHORTEST_PULSE_US:
            raise SettingRefusedError(PULSE_TOO_SHORT)
        if number == 20 and value and not self._values[22]:
            raise SettingRefusedError(SOFT_LIMITS_NEED_HOMING)
        self._values[number] = float(bool(value)) if number in self._booleans else value
        if number == 22 and not value:
            self._values[20] = 0.0  # soft limits need homing

    def store_line(self, line: str) -> int | None:
        """Store the setting of a line such as ``$13=0``. Return the number after ``error:``, or None."""
        name, separator, value = line[1:].partition("=")
        if not (separator and name.isdecimal()):
            return NOT_RECOGNISED
        try:
            self.store(int(name), float(value))
        except SettingRefusedError as refusal:
            return refusal.code
        except ValueError:
            return BAD_NUMBER
        return None

    def lines(self) -> Iterator[str]:
        for number, value in sorted(self._values.items()):
            yield f"${number}={int(value)}" if number in INTEGERS else f"${number}={value:.3f}"
