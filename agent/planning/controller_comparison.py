"""Comparison of the limits that the controller reports with the machine file and with the feeds of the procedure.

A finding whose values the driver cannot read says so and is neither good nor bad (`ok` is None).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from agent.settings.schema import ProcedureSettings
from drivers.roles import AxisLimits, DiagnosticFinding
from twin.machine.kinematic_chain import AXES
from twin.machine.machine_description import MachineDescription

MM_PER_INCH = 25.4
TRAVEL_TOLERANCE_MM = 0.5
"""Largest difference in mm between a soft limit of the controller and that of the machine file that is none."""
_RATIO_TOLERANCE = 0.01

Interval = tuple[float, float]


def compare_with_controller(
    limits: AxisLimits, machine: MachineDescription, procedure: ProcedureSettings
) -> Iterator[DiagnosticFinding]:
    """Yield the findings of the comparison of the controller's `limits` with the description of the machine: travel of
    each axis, rapid traverse, acceleration, and the feeds of the measuring procedure."""
    for number, axis in enumerate(AXES):
        controller = limits.lower_mm[number], limits.upper_mm[number]
        yield DiagnosticFinding(f"travel {axis}", *_travel(axis, controller, machine.limits[number]))
    rapid_mm_per_min = [60.0 * value for value in limits.rapid_mm_per_s]
    for number, axis in enumerate(AXES):
        rapid, acceleration = rapid_mm_per_min[number], limits.acceleration_mm_per_s2[number]
        key, stated = f"axes.{axis}.rapid_mm_per_min", machine.rapid_mm_per_min[number]
        yield DiagnosticFinding(f"rapid {axis}", *_at_most(key, stated, rapid, "mm/min"))
        key, stated = f"axes.{axis}.acceleration_mm_per_s2", machine.acceleration_mm_per_s2[number]
        yield DiagnosticFinding(f"acceleration {axis}", *_at_most(key, stated, acceleration, "mm/s²"))
    names = ("touch_feed_mm_per_min", "first_touch_feed_mm_per_min", "guarded_feed_mm_per_min")
    name = max(names, key=lambda one: getattr(procedure, one))
    slowest = min(rapid_mm_per_min, key=lambda value: value if _was_read(value) else -math.inf)
    yield DiagnosticFinding("feeds", *_at_most(f"procedure.{name}", getattr(procedure, name), slowest, "mm/min"))


def _travel(axis: str, controller: Interval, file: Interval) -> tuple[bool | None, str]:
    key = f"axes.{axis}.travel_mm"
    if not (all(map(math.isfinite, controller)) and controller[0] < controller[1]):
        return None, f"not read from the controller; the machine file has {_text(file)} mm ({key})"
    both = f"controller {_text(controller)} mm, machine file {_text(file)} mm ({key})"
    beyond = [low - high for low, high in ((controller[0], file[0]), (file[1], controller[1]))]
    if max(map(abs, beyond)) <= TRAVEL_TOLERANCE_MM:
        return True, f"{_text(controller)} mm, as in the machine file"
    ratio = (controller[1] - controller[0]) / (file[1] - file[0])
    if _is_close(ratio, MM_PER_INCH) or _is_close(1.0 / ratio, MM_PER_INCH):
        return False, f"{both}: their lengths have the ratio 25.4, an inch/mm confusion; set both to millimetres"
    if max(beyond) <= TRAVEL_TOLERANCE_MM:
        return True, f"{both}: the controller allows more than volcal uses"
    inches = [value / MM_PER_INCH for value in controller]
    if all(abs(value - round(value)) < _RATIO_TOLERANCE for value in inches):
        both += f"; those of the controller are {inches[0]:.0f} … {inches[1]:.0f} inch, perhaps an inch/mm confusion"
    if _is_close(ratio, 1.0):
        return False, (
            f"{both}: the same length, shifted by {controller[0] - file[0]:g} mm; correct the zero of the axis in the "
            f"driver's options or {key}"
        )
    return False, (
        f"{both}: the controller would refuse moves that volcal plans; correct its soft limits, or state what it "
        f"allows in {key} and axes.{axis}.range_mm"
    )


def _at_most(key: str, stated: float, allowed: float, unit: str) -> tuple[bool | None, str]:
    if not _was_read(allowed):
        return None, f"not read from the controller; {key} = {stated:g}"
    both = f"{key} = {stated:g}, the controller allows {allowed:g} {unit}"
    if stated <= allowed * (1.0 + _RATIO_TOLERANCE):
        return True, both
    ratio = stated / allowed
    cause = {MM_PER_INCH: "an inch/mm confusion", 60.0: "a confusion of mm/s and mm/min"}
    named = next(
        (f": the ratio {factor:g} is {text}" for factor, text in cause.items() if _is_close(ratio, factor)), ""
    )
    return False, f"{both}{named}; state at most what the controller allows"


def _was_read(value: float) -> bool:
    return 0.0 < value < math.inf


def _is_close(ratio: float, to: float) -> bool:
    return abs(ratio / to - 1.0) <= _RATIO_TOLERANCE


def _text(interval: Interval) -> str:
    return f"{interval[0]:g} … {interval[1]:g}"
