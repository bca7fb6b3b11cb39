"""Comparison of the conversion factors and units stored in a drive with the settings.

They are stored in the objects 0x608F, 0x6091, 0x6092, 0x607E and 0x60A8.

A drive whose factors differ from the settings turns the mount by a wrong angle without any fault. Therefore these
objects are read when the connection to the mount is opened. If a factor differs, opening fails before anything moves.
An object that the drive does not have is skipped, since CiA 402 requires none of these objects.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import structlog

from drivers.canopen_mount import objects
from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.objects import DriveObject
from drivers.canopen_mount.settings import AxisSettings
from drivers.errors import ConfigurationError

_log = structlog.get_logger("canopen_mount")


@dataclass(frozen=True)
class Factor:
    """Conversion factor or unit that a drive must have: one object, or a ratio stored in two sub-indexes of an object.

    `values` contains the expected value or ratio. `key` is the key of the axis settings from which `values` is taken.
    """

    name: str
    entries: tuple[DriveObject, ...]
    values: tuple[int, ...]
    key: str

    def agrees(self, found: tuple[int, ...]) -> bool:
        """Return True if `found`, the value read from the drive, equals the expected value.

        Ratios are compared by their value, so 36:1 equals 72:2.
        """
        if len(found) == 1:
            return found == self.values
        # A ratio with the denominator 0 agrees with nothing.
        return bool(found[1]) and Fraction(*found) == Fraction(*self.values)

    def __str__(self) -> str:
        return f"0x{self.entries[0].index:04X} {self.name}"


def expected_factors(settings: AxisSettings) -> Iterator[Factor]:
    """Yield, according to the settings, the expected value of each object that must be compared with the drive."""
    units = settings.units
    turns = (objects.ENCODER_INCREMENTS, objects.ENCODER_MOTOR_TURNS)
    gear = (objects.GEAR_MOTOR_TURNS, objects.GEAR_SHAFT_TURNS)
    shaft = (settings.gear_motor_revolutions, settings.gear_shaft_revolutions)
    if units.unit_code is not None:
        yield Factor("SI unit position", (objects.POSITION_UNIT,), (units.unit_code,), "units.unit_code")
    if units.velocity_unit_code is not None:
        code = (units.velocity_unit_code,)
        yield Factor("SI unit velocity", (objects.VELOCITY_UNIT,), code, "units.velocity_unit_code")
    if "encoder" in units.compared:
        per_turn = settings.encoder_counts_per_revolution
        yield Factor("position encoder resolution", turns, (per_turn, 1), "encoder_counts_per_revolution")
    if "gear" in units.compared:
        yield Factor("gear ratio", gear, shaft, "gear_motor_revolutions")
    if "feed" in units.compared and units.feed_per_revolution is not None:
        feed = (objects.FEED, objects.FEED_SHAFT_TURNS)
        yield Factor("feed constant", feed, (units.feed_per_revolution, 1), "units.feed_per_revolution")
    if "polarity" in units.compared:
        yield Factor("polarity", (objects.POLARITY,), (units.polarity,), "units.polarity")


def read_factor(node: DriveNode, factor: Factor) -> tuple[int, ...] | None:
    """Return a factor stored in the drive, which may be a ratio; None if the drive does not have the object."""
    found = [node.read_optional(entry) for entry in factor.entries]
    return None if None in found else tuple(value for value in found if value is not None)


def verify_factors(node: DriveNode, settings: AxisSettings) -> None:
    """Verify that the conversion factors and units stored in the drive agree with the settings. The drive does not
    move.

    If the setting `units.write` is true, differing factors are first written to the drive. Raises ConfigurationError if
    a factor still differs; the error names the object and the key of the setting.
    """
    for factor in expected_factors(settings):
        found = read_factor(node, factor)
        if found is not None and not factor.agrees(found) and settings.units.write:
            _log.warning("factor written", object=str(factor), former=_format_values(factor, found), **node.where)
            for entry, value in zip(factor.entries, factor.values, strict=True):
                node.write(entry, value)
            found = read_factor(node, factor)
        if found is not None and not factor.agrees(found):
            raise _mismatch(factor, found).at(**node.where)


def factor_text(node: DriveNode, factor: Factor) -> tuple[bool, str]:
    """Compare an expected factor with the one stored in the drive; return the result and a text for the diagnosis.

    Nothing is written. The result is True if the factor agrees or if the drive does not have the object.
    """
    found = read_factor(node, factor)
    if found is None:
        return True, f"{factor}: the drive has no such object, not compared"
    if factor.agrees(found):
        return True, f"{factor} {_format_values(factor, found)}, as configured"
    stated = _format_values(factor, factor.values)
    return False, f"{factor} is {_format_values(factor, found)} in the drive, {stated} in the settings ({factor.key})"


def _mismatch(factor: Factor, found: tuple[int, ...]) -> ConfigurationError:
    return ConfigurationError(
        f"{factor} is {_format_values(factor, found)} in the drive"
        f" and {_format_values(factor, factor.values)} in the settings",
        key=factor.key,
        object=f"0x{factor.entries[0].index:04X}",
        hint="a turn would end at a wrong angle: correct the wrong value, or set units.write to write it to the drive",
    )


def _format_values(factor: Factor, values: tuple[int, ...]) -> str:
    """Format values as text: a ratio in decimal, a code or bit pattern in hexadecimal."""
    return f"0x{values[0]:X}" if len(factor.entries) == 1 else " : ".join(str(value) for value in values)
