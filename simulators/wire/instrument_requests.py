"""Requests of the control channel to measure the simulated machine with a virtual instrument.

Lengths are in mm in requests; figures and curves are in µm in answers, and a squareness is in µrad. Each figure comes
with the standard uncertainty that the instrument states for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from drivers.errors import InputError
from simulators.instruments.ballbar import Circle, CircularTest, measure_circle
from simulators.instruments.interferometer import LineMeasurement, measure_line
from simulators.instruments.machine_under_test import MachineUnderTest, machine_of_world
from simulators.instruments.straightness_interferometer import (
    StraightnessMeasurement,
    measure_squareness,
    measure_straightness,
)
from simulators.instruments.target_line import TargetLine
from simulators.wire.request_values import number
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World
from twin.arrays import Array
from twin.machine.kinematic_chain import AXES
from twin.units import UM_PER_MM

Answer = dict[str, Any]
INSTRUMENT_KEYS: Mapping[str, tuple[str, ...]] = {
    "interferometer": ("from_mm", "to_mm", "targets", "runs", "bank", "seed"),
    "straightness": ("from_mm", "to_mm", "across", "targets", "runs", "bank", "seed"),
    "squareness": ("lines_mm", "plane", "targets", "runs", "bank", "seed"),
    "ballbar": ("centre_mm", "radius_mm", "plane", "runs", "bank", "seed"),
}
"""Keys of the requests, in addition to `do`."""
_DIGITS = 4
_URAD_PER_RAD = 1e6
_TARGETS, _RUNS, _REVOLUTIONS = 11, 5, 3
_BEYOND_MM = 10.0
"""Way beyond the travel that a request may state. Farther out, the errors are extrapolated, not those of a machine."""
_SKEW = 0.01
"""Largest sine of the angle in rad between a line and the axis along which it must run."""


class VirtualInstruments:
    """Instruments in front of the machine of a simulated world. They do not advance its time."""

    def __init__(self, shared: SharedWorld[World]) -> None:
        self._shared = shared

    def measure(self, request: Answer) -> Answer:
        """Return the answer to a request. Raises InputError if the request is invalid."""
        with self._shared.lock:
            machine = machine_of_world(self._shared.world, _integer(request, "bank", 0), _seed(request))
            _require_within_travel(request, self._shared.world)
            return answer_of(machine, request)


def answer_of(machine: MachineUnderTest, request: Answer) -> Answer:
    """Measure `machine` as a request asks, whatever bank it states. Raises InputError if the request is invalid."""
    seed = _seed(request)
    match request["do"]:
        case "interferometer":
            return _line_answer(measure_line(machine, _line(request), seed))
        case "straightness":
            across = _axis(request.get("across"), "across")
            line = _line(request)
            if abs(line.direction[across]) > _SKEW:
                raise InputError("straightness is measured across its line, not along it", key="across")
            return _straightness_answer(measure_straightness(machine, line, across, seed))
        case "squareness":
            return _squareness(machine, request, seed)
        case _:
            circle = Circle(
                _point(request.get("centre_mm"), "centre_mm"),
                number(request.get("radius_mm"), "radius_mm"),
                _plane(request),
                _integer(request, "runs", _REVOLUTIONS),
            )
            return _circle_answer(measure_circle(machine, circle, seed))


def _require_within_travel(request: Answer, world: World) -> None:
    """Raise InputError if a position of the request is far outside the travel, or is none."""
    limits = world.controller.limits()
    low, high = np.array(limits.lower_mm) - _BEYOND_MM, np.array(limits.upper_mm) + _BEYOND_MM
    for key, point in _positions(request):
        if (point < low).any() or (point > high).any():
            travel = ", ".join(
                f"{name} {lowest:g} to {highest:g}"
                for name, lowest, highest in zip(AXES, limits.lower_mm, limits.upper_mm, strict=True)
            )
            raise InputError(f"{key} leaves the travel of the machine", hint=f"in mm: {travel}", key=key)


def _positions(request: Answer) -> Iterator[tuple[str, Array]]:
    """Yield the positions (3,) in mm of a request with their keys."""
    match request:
        case {"do": "squareness", "lines_mm": [[*first], [*second]]}:
            yield from (("lines_mm", _point(end, "lines_mm")) for end in (*first, *second))
        case {"do": "ballbar"}:
            centre = _point(request.get("centre_mm"), "centre_mm")
            yield "centre_mm", centre
            radial = np.zeros(3)
            radial[list(_plane(request))] = number(request.get("radius_mm"), "radius_mm")
            yield from (("radius_mm", centre + sign * radial) for sign in (-1.0, 1.0))
        case {"do": "interferometer" | "straightness"}:
            yield from ((key, _point(request.get(key), key)) for key in ("from_mm", "to_mm"))


def _seed(request: Answer) -> int:
    """Return the seed that selects the errors of instrument and set-up, and the scatter of the axes."""
    return _integer(request, "seed", 1)


def _squareness(machine: MachineUnderTest, request: Answer, seed: int) -> Answer:
    ends, targets = request.get("lines_mm", []), request.get("targets", [_TARGETS, _TARGETS])
    if not (_are_two(ends) and all(_are_two(one) for one in ends)):
        raise InputError("lines_mm must be two lines, each with its two ends", key="lines_mm")
    if not _are_two(targets):
        raise InputError("targets must be two numbers, one for each line", key="targets")
    first, second = (
        _line({**request, "from_mm": start, "to_mm": end, "targets": count}, "lines_mm")
        for (start, end), count in zip(ends, targets, strict=True)
    )
    axes = _plane(request)
    for line, axis in zip((first, second), axes, strict=True):
        if np.linalg.norm(line.direction - np.eye(3)[axis]) > _SKEW:
            raise InputError(
                f"the lines of a squareness run upwards along the axes of its plane, the first along {AXES[axes[0]]} "
                f"and the second along {AXES[axes[1]]}",
                key="lines_mm",
            )
    found = measure_squareness(machine, (first, second), axes, seed)
    return {
        "squareness_urad": round(_URAD_PER_RAD * found.angle_rad, _DIGITS),
        "squareness_u_urad": round(_URAD_PER_RAD * found.angle_u_rad, _DIGITS),
        "duration_s": round(found.duration_s, 1),
    }


def _are_two(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2


def _line_answer(found: LineMeasurement) -> Answer:
    return {
        "m_um": _um(found.mean_range),
        "m_u_um": _um(found.mean_range_u),
        "e_um": _um(found.systematic),
        "e_u_um": _um(found.mean_range_u),
        "a_um": _um(found.accuracy),
        "a_u_um": _um(found.mean_range_u),
        "r_um": _um(found.repeatability),
        "r_u_um": _um(2.0 * found.reading_u),
        "b_um": _um(found.reversal),
        "b_u_um": _um(found.reading_u),
        "position_mm": [round(one, _DIGITS) for one in found.along_mm.tolist()],
        "mean_um": _curve(found.mean),
        "duration_s": round(found.duration_s, 1),
    }


def _straightness_answer(found: StraightnessMeasurement) -> Answer:
    return {
        "straightness_um": _um(found.span),
        "straightness_u_um": _um(found.span_u),
        "position_mm": [round(one, _DIGITS) for one in found.along_mm.tolist()],
        "mean_um": _curve(found.deviations),
        "duration_s": round(found.duration_s, 1),
    }


def _circle_answer(found: CircularTest) -> Answer:
    return {
        "g_mean_um": _um(found.g_mean),
        "g_mean_u_um": _um(found.g_mean_u),
        "g_clockwise_um": _um(found.g_clockwise),
        "g_counter_clockwise_um": _um(found.g_counter_clockwise),
        "g_bidirectional_um": _um(found.g_bidirectional),
        "h_um": _um(found.hysteresis),
        "radius_um": _um(found.radius),
        "radius_u_um": _um(found.radius_u),
        "mean_angle_rad": [round(one, 6) for one in found.mean_angles.tolist()],
        "mean_um": _curve(found.mean),
        "angle_rad": [round(one, 6) for one in found.angles.tolist()],
        "clockwise_um": _curve(found.clockwise),
        "counter_clockwise_um": _curve(found.counter_clockwise),
        "duration_s": round(found.duration_s, 1),
    }


def _line(request: Answer, key: str = "") -> TargetLine:
    """Return the line of a request; `key` is named in errors instead of that of an end."""
    return TargetLine(
        _point(request.get("from_mm"), key or "from_mm"),
        _point(request.get("to_mm"), key or "to_mm"),
        _integer(request, "targets", _TARGETS),
        _integer(request, "runs", _RUNS),
    )


def _point(value: Any, key: str) -> Array:
    if not (isinstance(value, list) and len(value) == 3):
        raise InputError(f"{key} must be three numbers, got {value!r}", key=key)
    return np.array([number(one, key) for one in value])


def _integer(request: Answer, key: str, default: int) -> int:
    value = request.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise InputError(f"{key} must be an integer, at least 0, got {value!r}", key=key)
    return value


def _axis(name: Any, key: str) -> int:
    if name not in AXES:
        raise InputError(f"{key} must be X, Y or Z, got {name!r}", key=key)
    return AXES.index(name)


def _plane(request: Answer) -> tuple[int, int]:
    plane = request.get("plane")
    if not (isinstance(plane, str) and len(plane) == 2 and plane[0] != plane[1]):
        raise InputError(f"plane must be two axes, as XY, got {plane!r}", key="plane")
    return _axis(plane[0], "plane"), _axis(plane[1], "plane")


def _um(value_mm: float) -> float:
    return round(UM_PER_MM * value_mm, _DIGITS)


def _curve(values_mm: Array) -> list[float]:
    return [round(one, _DIGITS) for one in (UM_PER_MM * values_mm).tolist()]
