"""Plausible ranges of all lengths, masses and times of the settings file, the machine file and the artefact file.

The files themselves refuse only what is impossible. A value outside its plausible range is possible but probably has
the wrong unit or a wrong decimal point, and causes a warning. A value of 0 says that something is absent or switched
off, and is always plausible.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from agent.files import read_text
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError

UNITS = {
    "_mm_per_min": "mm/min",
    "_mm_per_s2": "mm/s²",
    "_mm": "mm",
    "_um": "µm",
    "_kg": "kg",
    "_gpa": "GPa",
    "_mm4": "mm⁴",
    "_minutes": "min",
    "_days": "days",
    "_hours": "h",
    "_ms": "ms",
    "_s": "s",
}
"""Unit by the end of a key. A key with one of these ends is a length, speed, acceleration, mass, time or stiffness."""

COORDINATE_MM = 30_000.0


@dataclass(frozen=True)
class PlausibleRange:
    """Plausible values of a key from `lowest` to `highest`.

    Each number of a list is compared or, if there is a `measure`, its value for the whole list, which is called
    `quantity`.
    """

    lowest: float
    highest: float
    measure: Callable[[Sequence[float]], float] | None = None
    quantity: str = "value"


def _span(ends: Sequence[float]) -> float:
    return max(ends) - min(ends)


def _length(vector: Sequence[float]) -> float:
    return math.hypot(*vector)


_COORDINATES = PlausibleRange(-COORDINATE_MM, COORDINATE_MM)
_OF_PART = PlausibleRange(-5000.0, 5000.0)
_TRAVEL = PlausibleRange(40.0, COORDINATE_MM, _span, "travel")
_ERROR_OF_MACHINE = PlausibleRange(0.01, 2000.0)
_CERTIFIED = PlausibleRange(30.0, 5000.0)
_CERTIFIED_SIGMA = PlausibleRange(0.02, 1000.0)
_HOLDER = PlausibleRange(1.0, 500.0)

SETTINGS_RANGES: Mapping[str, PlausibleRange] = {
    "mount.shaft_mm": PlausibleRange(5.0, 1000.0),
    "mount.shaft_radius_mm": PlausibleRange(1.0, 200.0),
    "mount.pedestal_radius_mm": PlausibleRange(5.0, 500.0),
    "mount.head_mm": PlausibleRange(-1000.0, 500.0),
    "mount.table_z_mm": _COORDINATES,
    "probe.tip_radius_mm": PlausibleRange(0.25, 10.0),
    "probe.stem_radius_mm": PlausibleRange(0.1, 10.0),
    "probe.stem_length_mm": PlausibleRange(3.0, 600.0),
    "probe.body_radius_mm": PlausibleRange(3.0, 100.0),
    "probe.reach_mm": PlausibleRange(15.0, 3000.0),
    "probe.ram_half_width_mm": PlausibleRange(5.0, 1000.0),
    "probe.ram_length_mm": PlausibleRange(20.0, 10_000.0),
    "stations.places_mm": _COORDINATES,
    "stations.park_distance_mm": PlausibleRange(5.0, 5000.0),
    "stations.placement_tolerance_mm": PlausibleRange(0.2, 30.0),
    "procedure.touch_feed_mm_per_min": PlausibleRange(5.0, 2000.0),
    "procedure.approach_mm": PlausibleRange(0.3, 30.0),
    "procedure.search_mm": PlausibleRange(0.3, 10.0),
    "procedure.wide_approach_mm": PlausibleRange(0.5, 50.0),
    "procedure.wide_search_mm": PlausibleRange(0.5, 20.0),
    "procedure.guarded_feed_mm_per_min": PlausibleRange(50.0, 6000.0),
    "procedure.recentre_mm": PlausibleRange(0.01, 5.0),
    "procedure.retract_mm": PlausibleRange(2.0, 500.0),
    "procedure.clearance_mm": PlausibleRange(0.1, 50.0),
    "procedure.first_touch_feed_mm_per_min": PlausibleRange(20.0, 3000.0),
    "procedure.back_off_mm": PlausibleRange(0.05, 10.0),
    "procedure.touch_sigma_um": PlausibleRange(0.05, 50.0),
    "procedure.radius_limit_um": PlausibleRange(0.5, 500.0),
    "procedure.form_limit_um": PlausibleRange(0.3, 500.0),
    "procedure.touch_limit_um": PlausibleRange(0.3, 500.0),
    "procedure.pole_limit_um": PlausibleRange(0.3, 500.0),
    "procedure.drift_limit_um": PlausibleRange(0.3, 500.0),
    "probe_check.limit_um": PlausibleRange(0.1, 100.0),
    "qualification.limit_um": PlausibleRange(0.5, 500.0),
    "qualification.ball_radius_sigma_um": PlausibleRange(0.01, 10.0),
    "reversal.limit_um": PlausibleRange(0.3, 500.0),
    "table.step_mm": PlausibleRange(5.0, 2000.0),
    "table.anchor_mm": _COORDINATES,
    "gates.max_correction_um": PlausibleRange(5.0, 10_000.0),
    "nightly.slot_minutes": PlausibleRange(1.0, 600.0),
    "nightly.reserve_minutes": PlausibleRange(0.05, 60.0),
    "nightly.drift_um": PlausibleRange(0.01, 50.0),
    "temperature.poll_interval_s": PlausibleRange(5.0, 600.0),
    "temperature.max_wait_minutes": PlausibleRange(1.0, 720.0),
    "temperature.drift_warning_um": PlausibleRange(0.3, 100.0),
    "timing.command_latency_s": PlausibleRange(0.0001, 5.0),
    "timing.touch_latency_s": PlausibleRange(0.0005, 10.0),
    "timing.turn_latency_s": PlausibleRange(0.005, 60.0),
    "timing.relocation_minutes": PlausibleRange(0.05, 120.0),
    "service.warm_up_minutes": PlausibleRange(0.5, 720.0),
    "service.answer_timeout_minutes": PlausibleRange(0.5, 1440.0),
    "service.hang_timeout_s": PlausibleRange(5.0, 600.0),
    "service.computation_timeout_minutes": PlausibleRange(0.2, 240.0),
    "service.stop_timeout_s": PlausibleRange(5.0, 600.0),
    "service.idle_read_period_s": PlausibleRange(0.0, 3600.0),
    "history.timeout_s": PlausibleRange(0.1, 60.0),
    "opcua.calibration_interval_days": PlausibleRange(1.0, 730.0),
    "history.ve_bare_tolerance_um": PlausibleRange(0.1, 2000.0),
    "history.ve_tolerance_um": PlausibleRange(0.1, 2000.0),
    "history.held_out_tolerance_um": PlausibleRange(0.1, 2000.0),
    "history.whole_days": PlausibleRange(0.5, 3650.0),
    "gateway.idle_timeout_s": PlausibleRange(1.0, 3600.0),
    "gateway.panel_timeout_s": PlausibleRange(2.0, 600.0),
    "notifications.max_age_hours": PlausibleRange(0.5, 720.0),
    "notifications.*.timeout_s": PlausibleRange(2.0, 120.0),
}
"""Plausible range of each length, mass and time of the settings file, by key."""

MACHINE_RANGES: Mapping[str, PlausibleRange] = {
    "axes.*.range_mm": _TRAVEL,
    "axes.*.travel_mm": _TRAVEL,
    "axes.*.rapid_mm_per_min": PlausibleRange(100.0, 200_000.0),
    "axes.*.feed_mm_per_min": PlausibleRange(10.0, 100_000.0),
    "axes.*.acceleration_mm_per_s2": PlausibleRange(5.0, 50_000.0),
    "axes.*.guide.shoes_mm": PlausibleRange(20.0, 5000.0),
    "axes.*.guide.centre_mm": _OF_PART,
    "feet.at_mm": _COORDINATES,
    "tools.*.offset_mm": PlausibleRange(10.0, 3000.0, _length, "length of the vector"),
    "model.family.positioning_um": _ERROR_OF_MACHINE,
    "model.family.straightness_um": _ERROR_OF_MACHINE,
    "model.family.cross_displacement_um": _ERROR_OF_MACHINE,
    "beams.supports_mm": _COORDINATES,
    "beams.reference_mm": _OF_PART,
    "beams.crossbeam.here_mm": _COORDINATES,
    "beams.crossbeam.other_mm": _COORDINATES,
    "beams.loads.centre_mm": _OF_PART,
    "beams.loads.mass_kg": PlausibleRange(0.1, 100_000.0),
    "beams.youngs_modulus_gpa": PlausibleRange(1.0, 1000.0),
    "beams.shear_modulus_gpa": PlausibleRange(0.4, 400.0),
    "beams.second_moment_mm4": PlausibleRange(1e3, 1e13),
    "beams.torsion_constant_mm4": PlausibleRange(1e3, 1e13),
}
"""Plausible range of each length, mass, time and stiffness of a machine file, by key; * stands for one name."""

ARTEFACT_RANGES: Mapping[str, PlausibleRange] = {
    "ball_diameter_mm": PlausibleRange(2.0, 120.0),
    "standard_uncertainty_um": _CERTIFIED_SIGMA,
    "holder_length_mm": _HOLDER,
    "sag_um": PlausibleRange(0.1, 5000.0),
    "sag_standard_uncertainty_um": PlausibleRange(0.01, 1000.0),
    "end_length_mm": _CERTIFIED,
    "end_length_standard_uncertainty_um": _CERTIFIED_SIGMA,
    "bar.length_mm": _CERTIFIED,
    "bar.holder_length_mm": _HOLDER,
    "reference_lengths.length_mm": _CERTIFIED,
    "reference_lengths.standard_uncertainty_um": _CERTIFIED_SIGMA,
    "holders.radius_mm": PlausibleRange(0.3, 60.0),
    "holders.length_mm": _HOLDER,
    "holders.feet_mm": _OF_PART,
    "beam.radius_mm": PlausibleRange(1.0, 200.0),
    "beam.overhang_mm": PlausibleRange(0.5, 1000.0),
    "bodies.radius_mm": PlausibleRange(0.3, 500.0),
    "bodies.*_mm": _OF_PART,
}
"""Plausible range of each length of an artefact file, by key. The coordinates of the balls have none of their own: they
must agree with the lengths."""


def implausible_values(settings: Settings, file: Path) -> Iterator[str]:
    """Yield a warning for each implausible value of the settings, which were read from `file`, and of the machine file
    and the artefact files that they name."""
    document = settings.model_dump(exclude={"devices", "roles"})
    yield from _warnings(document, SETTINGS_RANGES, file)
    yield from _warnings(_parsed(settings.machine), MACHINE_RANGES, settings.machine)
    for artefact in dict.fromkeys((settings.artefact, *(settings.stations.artefacts or ()))):
        yield from _warnings(_parsed(artefact), ARTEFACT_RANGES, artefact)


def _parsed(file: Path) -> dict[str, Any]:
    return tomllib.loads(read_text(file, error=ConfigurationError))


def _warnings(document: Mapping[str, Any], ranges: Mapping[str, PlausibleRange], file: Path) -> Iterator[str]:
    for key, value in _values(document):
        expected = next((allowed for pattern, allowed in ranges.items() if fnmatchcase(key, pattern)), None)
        unit = next((unit for end, unit in UNITS.items() if key.endswith(end)), "")
        if expected is None:
            continue
        for number in _numbers(value, expected):
            if number != 0.0 and not expected.lowest <= number <= expected.highest:
                yield (
                    f"{file}, key {key}: the {expected.quantity} {number:g} {unit} is not plausible; check the number "
                    f"and its unit ({expected.lowest:g} to {expected.highest:g} {unit} are usual)"
                )


def _values(document: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the dotted key and the value of each entry; the tables of an array of tables have the same keys."""
    for name, value in document.items():
        tables = [value] if isinstance(value, Mapping) else value if isinstance(value, list) else []
        if tables and all(isinstance(table, Mapping) for table in tables):
            for table in tables:
                yield from _values(table, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def _numbers(value: object, expected: PlausibleRange) -> Iterator[float]:
    """Yield the numbers to be compared with a range: those of a list, its measure, or a single one."""
    if isinstance(value, bool) or value is None:
        return
    if isinstance(value, int | float):
        yield float(value)
    elif isinstance(value, list | tuple):
        if expected.measure is not None and all(isinstance(item, int | float) for item in value):
            yield expected.measure(value)
            return
        for item in value:
            yield from _numbers(item, expected)
