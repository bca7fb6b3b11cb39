"""Random but sensible cases: machine, probe, artefact, mount, stations, procedure, and true errors.

Every case could have been written by an engineer. It may still be inconsistent in a detail. The agent's checks and its
preflight must find such inconsistencies.
"""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.settings.schema import Settings
from simulators.scenario import Scenario, ScenarioDocument, build_scenario
from twin.artefact.position_set import CHECKABLE_BALLS, POSITION_SETS, Position
from twin.collision.measuring_layout import MeasuringLayout

Document = dict[str, Any]
ROLES = ("machine", "probe", "store", "thermometer", "operator", "mount")
CANDIDATES = 24
"""Number of orientations drawn as candidates, of which enough must be within reach."""
CASE_STREAM, KIND_STREAM = 20261, 20275
"""Streams of random numbers: of the dimensions of a case, and of its kind (spindle, kinematic chain and size)."""


@dataclass(frozen=True)
class DrawnCase:
    """Case (machine, artefact, plan and true errors) that was drawn at random.

    `job` contains what the agent knows about the case, and `scenario` contains the true start position, placement and
    errors. `spindle` is the direction of the stylus. In the second run of the plan the event `interruption` (an abort,
    a hold or an emergency stop) happens after the fraction `at_share` of the planned machine time.
    """

    seed: int
    job: Job
    scenario: Scenario
    spindle: Spindle
    interruption: str
    at_share: float


class Dice:
    """Random generator that provides the few kinds of random values needed for a random case. Each `stream` gives
    different values for the same seed.
    """

    def __init__(self, seed: int, stream: int) -> None:
        self._rng = np.random.default_rng([seed, stream])

    def between(self, low: float, high: float, digits: int = 1) -> float:
        return round(float(self._rng.uniform(low, high)), digits)

    def whole(self, low: int, high: int) -> int:
        """Return a random integer between `low` and `high`, both included."""
        return int(self._rng.integers(low, high + 1))

    def chance(self, probability: float) -> bool:
        return bool(self._rng.random() < probability)

    def one_of(self, *values: Any) -> Any:
        return values[int(self._rng.integers(len(values)))]


@dataclass(frozen=True)
class Spindle:
    """Direction of the stylus in a random case: along the machine axis with the index `axis`, in the direction `sign`.

    `station_axis` is the index of the horizontal axis across the stylus along which the stations stand.
    """

    axis: int
    sign: int
    station_axis: int

    @property
    def name(self) -> str:
        return f"{'+' if self.sign > 0 else '-'}{'XYZ'[self.axis]}"

    @property
    def is_vertical(self) -> bool:
        return self.axis == 2

    @property
    def side_axis(self) -> int:
        return 3 - self.axis - self.station_axis

    @property
    def facing_deg(self) -> float:
        """Azimuth at which holders that point along -Y at azimuth 0 point against a horizontal stylus."""
        return {(0, 1): -90.0, (0, -1): 90.0, (1, -1): 180.0}.get((self.axis, self.sign), 0.0)

    def point(self, along_stations: float, depth: float, side: float) -> list[float]:
        """Return a point in mm from its coordinate along the stations, its depth in the direction of the stylus, and
        its coordinate along the third axis.
        """
        out = [0.0, 0.0, 0.0]
        out[self.station_axis], out[self.axis], out[self.side_axis] = along_stations, self.sign * depth, side
        return out


@dataclass(frozen=True)
class Sizes:
    """Dimensions in mm that determine the layout of machine, mount and artefact in a random case.

    `scale` is the size of the case relative to a middle-sized machine, `length` the length of the bar.
    """

    scale: float
    length: float
    probe: Document
    balls: Document
    solid: Document
    ball_diameter: float
    mount: Document
    sweep: float
    offset: float
    park: float


def draw(seed: int, directory: Path) -> DrawnCase:
    """Draw the case with the random seed `seed`, write its files into `directory`, and return the case.

    Raises UserError if the agent refuses these files.
    """
    dice, kind_dice = Dice(seed, CASE_STREAM), Dice(seed, KIND_STREAM)
    spindle = _spindle(kind_dice)
    scale = kind_dice.one_of(1.0, 1.0, kind_dice.between(0.3, 0.7, 2))
    sizes = _sizes(dice, spindle, scale)
    machine, places = _machine(dice, sizes, spindle, kind_dice)
    artefact = _artefact(sizes)
    mount = {**sizes.mount, "table_z_mm": _table_z(dice, sizes, spindle, machine, places)}
    for name, document in (("machine", machine), ("artefact", artefact)):
        (directory / f"{name}.toml").write_text(toml(document))
    settings = {
        "machine": str(directory / "machine.toml"),
        "artefact": str(directory / "artefact.toml"),
        "state_directory": str(directory / "state"),
        "devices": {"twin": {"driver": "simulated"}},
        "roles": dict.fromkeys(ROLES, "twin"),
        "mount": mount,
        "probe": sizes.probe,
        "stations": {
            "places_mm": places,
            "standing_at": dice.one_of(None, dice.whole(1, len(places))),
            "park_distance_mm": sizes.park,
        },
        **_procedure(dice, sizes),
    }
    job = _with_positions(dice, settings, directory, spindle)
    return DrawnCase(
        seed,
        job,
        _scenario(dice, settings, machine, spindle, seed),
        spindle,
        dice.one_of("abort", "abort", "abort", "hold", "fault"),
        dice.between(0.0, 1.0, 4),
    )


def _spindle(dice: Dice) -> Spindle:
    """Return one of the six directions of the stylus; that of vertical mills is drawn more often."""
    axis, sign = dice.one_of((0, 1), (0, -1), (1, 1), (1, 1), (1, -1), (2, -1), (2, -1), (2, -1), (2, 1))
    along = dice.whole(0, 1)
    return Spindle(axis, sign, along if axis == 2 else 1 - axis)


def _sizes(dice: Dice, spindle: Spindle, scale: float) -> Sizes:
    def between(low: float, high: float) -> float:
        return round(scale * dice.between(low, high), 1)

    length, balls = between(300, 1800), dice.one_of(3, 3, 3, 3, 4, 5)
    diameter = max(5.0, between(8, 30))
    holder = between(max(35.0, 1.5 * diameter / scale), 120)
    tip = max(0.5, between(1, 4))
    stem_length, body = between(50, 200), between(15, 32)
    reach = round(stem_length + 2 * body + between(5, 120), 1)
    bar_radius = between(6, 18)
    shaft = between(max(80.0, bar_radius / scale + 50.0), 250)
    sweep = math.hypot(0.5 * length, holder) + shaft + 40.0
    half_width = between(50, 120)
    probe = {
        "tip_radius_mm": tip,
        "stem_radius_mm": round(tip * dice.between(0.4, 0.75, 2), 2),
        "stem_length_mm": stem_length,
        "body_radius_mm": body,
        "reach_mm": reach,
        "ram_half_width_mm": half_width,
        "ram_length_mm": between(500, 2500),
    }
    shaft_radius = between(10, 25)
    solid = {
        "beam": {"radius_mm": bar_radius, "overhang_mm": between(5, 40)},
        "holders": {"radius_mm": dice.between(min(1.5, 0.2 * diameter), 0.25 * diameter)},
    }
    mount: Document = {
        "shaft_mm": shaft,
        "shaft_radius_mm": shaft_radius,
        "pedestal_radius_mm": between(25, 60),
        "head_mm": between(0, 50),
    }
    tilt_deg = dice.one_of(0.0, dice.between(0, 25))
    on_bar: Document = {"bar": {"balls": balls, "length_mm": length, "tilt_deg": tilt_deg, "holder_length_mm": holder}}
    if spindle.is_vertical and dice.chance(0.5):
        mount["shaft_direction"] = [0.0, 0.0, -float(spindle.sign)]
    if spindle.is_vertical and dice.chance(0.8):
        on_bar = {"balls": _balls_towards_spindle(balls, length, math.radians(tilt_deg), holder, spindle)}
    offset = round(reach + dice.one_of(0.0, between(0, 30)), 1)
    park = round(sweep + half_width + between(10, 200), 1)
    return Sizes(scale, length, probe, on_bar, solid, diameter, mount, sweep, offset, park)


def _balls_towards_spindle(
    count: int, length: float, tilt_rad: float, holder: float, spindle: Spindle
) -> list[list[float]]:
    """Return the balls of a bar whose holders point against a vertical stylus, tilted alternately to both sides."""
    up = -spindle.sign * holder * math.cos(tilt_rad)
    aside = holder * math.sin(tilt_rad)
    return [
        [round(length * (number / (count - 1) - 0.5), 3), round((-1) ** number * aside, 3), round(up, 3)]
        for number in range(count)
    ]


def _machine(dice: Dice, sizes: Sizes, spindle: Spindle, kind_dice: Dice) -> tuple[Document, list[list[float]]]:
    """Return a machine whose travel surrounds the stations, and the stations' locations in mm.

    In the direction of the stylus the travel extends from the retreat plane, in front of the artefact, towards its far
    end behind the mount.
    """
    stations, near = dice.whole(1, 4), dice.between(100, 700)
    gap = round(sizes.scale * kind_dice.one_of(near, near, kind_dice.between(700, 1500)), 1)
    half, sweep = 0.5 * sizes.length, sizes.sweep
    first_low, depth_low, side_low = (dice.one_of(0.0, dice.between(-600, 300)) for _ in range(3))
    depth = dice.between(0.4 if spindle.is_vertical else 0.95, 1.15, 3) * sweep + 30.0
    across = sweep if spindle.is_vertical else half
    first = round(first_low + dice.between(0.3, 1.0, 3) * sweep, 1)
    last = first + gap * (stations - 1)
    place_side = round(side_low + dice.between(0.6, 1.1, 3) * across + 40.0, 1)
    low = spindle.point(first_low, depth_low, side_low)
    high = spindle.point(
        round(last + sizes.park + dice.between(5, 300), 1),
        round(depth_low + depth + dice.between(0.0, 0.9, 3) * half + 30.0, 1),
        round(place_side + dice.between(0.6, 1.1, 3) * across + 40.0, 1),
    )
    rapid, acceleration = dice.between(8000, 40000, 0), dice.between(300, 3000, 0)
    axes = {
        axis: {
            "range_mm": sorted(ends),
            "rapid_mm_per_min": rapid,
            "acceleration_mm_per_s2": round(acceleration * dice.one_of(1.0, 0.7), 0),
        }
        for axis, *ends in zip("XYZ", low, high, strict=True)
    }
    machine = {
        "name": "drawn",
        "chain": _chain(kind_dice),
        "axes": axes,
        "tools": {"probe": {"offset_mm": spindle.point(0.0, sizes.offset, 0.0)}},
    }
    place_depth = round(depth_low + sizes.offset + depth, 1)
    places = [spindle.point(round(first + gap * number, 1), place_depth, place_side) for number in range(stations)]
    return machine, places


def _chain(dice: Dice) -> str:
    """Return one of the 24 kinematic chains of three linear axes."""
    links = ["X", "Y", "Z"]
    order = [links.pop(dice.whole(0, len(links) - 1)) for _ in range(3)]
    order.insert(dice.whole(0, 3), "bed")
    return "-".join(("tool", *order, "workpiece"))


def _table_z(dice: Dice, sizes: Sizes, spindle: Spindle, machine: Document, places: list[list[float]]) -> float:
    """Return the height of the table, below everything that turns, and below the ram if it comes from below."""
    if (spindle.axis, spindle.sign) == (2, 1):
        lowest_tip = machine["axes"]["Z"]["range_mm"][0] + sizes.offset
        bottom: float = lowest_tip - sizes.probe["reach_mm"] - sizes.probe["ram_length_mm"]
        return round(bottom - dice.between(50, 300), 1)
    return round(places[0][2] - sizes.sweep - sizes.scale * dice.between(150, 500), 1)


def _artefact(sizes: Sizes) -> Document:
    return {
        "name": "drawn",
        "cte_per_k": 11.5e-6,
        "cte_standard_uncertainty_per_k": 3e-7,
        "ball_diameter_mm": sizes.ball_diameter,
        "standard_uncertainty_um": 0.8,
        **sizes.balls,
        **sizes.solid,
    }


def _procedure(dice: Dice, sizes: Sizes) -> Document:
    """Return a procedure whose limits are wide enough for the drawn noise, because this campaign tests only motion."""
    approach = dice.between(1.5, 6)
    touches = dice.one_of(*[3] * 8, *[5] * 18, 9, 9, 13, 25)
    return {
        "procedure": {
            "touches_per_ball": touches,
            "repeat_first_ball": touches != 3 or approach < 3.0,
            "touch_feed_mm_per_min": dice.between(150, 900),
            "approach_mm": approach,
            "search_mm": dice.between(1.5, 6),
            "wide_approach_mm": round(approach + dice.between(2, 6), 1),
            "wide_search_mm": dice.between(4, 10),
            "recentre_mm": dice.between(0.2, 0.6, 2),
            "retract_mm": round(sizes.ball_diameter + dice.between(10, 120), 1),
            "touch_stages": dice.one_of(1, 1, 2),
            "paths": dice.one_of("shortest", "shortest", "plain"),
            "guarded_feed_mm_per_min": dice.between(500, 6000),
            "clearance_mm": dice.between(1, 5),
            "first_touch_feed_mm_per_min": dice.between(600, 2000),
            "back_off_mm": dice.between(0.5, 2),
            "form_limit_um": 30.0,
            "touch_limit_um": 20.0,
            "pole_limit_um": 40.0,
            "radius_limit_um": 40.0,
            "drift_limit_um": 20.0,
        },
        "probe_check": {"enabled": dice.chance(0.15), "touches": 3, "limit_um": 6.0},
        "qualification": {"enabled": dice.chance(0.1) or touches == 3},
        "reversal": {"enabled": dice.chance(0.1)},
    }


def _with_positions(dice: Dice, settings: Document, directory: Path, spindle: Spindle) -> Job:
    """Return a job with orientations that are within reach: from sets S1 to S3, from a grid, or arbitrary ones."""
    places = len(settings["stations"]["places_mm"])
    stations = sorted({dice.whole(1, places) for _ in range(dice.whole(1, 2))})
    provisional = {**settings, "procedure": {**settings["procedure"], "position_set": "S3", "stations": stations}}
    layout = prepare_job(Settings.model_validate(provisional), directory).layout
    wanted, listed = dice.one_of(1, 1, 1, 1, 1, 1, 2, 3), list[Position]()
    held_at = dice.one_of(*stations)
    held: list[float] | None = None
    for _ in range(CANDIDATES):
        station, (azimuth, elevation) = dice.one_of(*stations), _orientation(dice, spindle)
        position = Position(held_at if held is None else station, azimuth, elevation)
        if layout.reachable(position, layout.nominal(position)).sum() < 3 or position in listed:
            continue
        if held is None:
            held = [azimuth, elevation]
        elif [azimuth, elevation] != held:
            listed.append(_with_chosen_balls(position, layout))
        if len(listed) == wanted:
            break
    settings["verification"] = {"positions_deg": [held or [30.0, 30.0]], "stations": [held_at]}
    settings["procedure"] |= {"position_set": _position_file(dice, listed, directory), "stations": stations}
    return prepare_job(Settings.model_validate(settings), directory)


def _with_chosen_balls(position: Position, layout: MeasuringLayout) -> Position:
    """Return `position` with every second ball within reach, if it stands at an odd azimuth and enough balls remain for
    the check of the touches."""
    balls = np.flatnonzero(layout.reachable(position, layout.nominal(position)))[::2].tolist()
    if round(position.azimuth_deg) % 2 == 0 or len(balls) < CHECKABLE_BALLS:
        return position
    return replace(position, balls=tuple(balls))


def _orientation(dice: Dice, spindle: Spindle) -> tuple[float, float]:
    """Return an azimuth and an elevation in degrees, mostly with the holders on the side of the spindle."""
    azimuth, elevation = _orientation_towards_y(dice)
    if spindle.facing_deg and dice.chance(0.9):
        azimuth = round(azimuth + spindle.facing_deg, 3)
    return azimuth - 360.0 * math.ceil((azimuth - 180.0) / 360.0), elevation


def _orientation_towards_y(dice: Dice) -> tuple[float, float]:
    match dice.whole(0, 3):
        case 0:
            named: tuple[float, float] = dice.one_of(*POSITION_SETS["S1"], *POSITION_SETS["S2"], *POSITION_SETS["S3"])
            return named
        case 1:
            return 22.5 * dice.whole(-4, 4), 22.5 * dice.whole(-4, 4)
        case 2:
            return dice.between(-70, 70), dice.between(-70, 70)
        case _:
            return dice.between(-180, 180), dice.between(-90, 90)


def _position_file(dice: Dice, listed: list[Position], directory: Path) -> str:
    """Write the positions as CSV or TOML and return the file's path; return a named set if no drawn position is in
    reach.
    """
    if not listed:
        return str(dice.one_of("S1", "S2", "S3"))
    listed.sort(key=lambda p: p.station)
    if dice.chance(0.5):
        path = directory / "positions.csv"
        rows = [f"{p.station},{p.azimuth_deg},{p.elevation_deg},{' '.join(map(str, p.balls or ()))}" for p in listed]
        path.write_text("\n".join(["station,azimuth_deg,elevation_deg,balls", *rows]) + "\n")
        return str(path)
    path = directory / "positions.toml"
    keys = ("station", "azimuth_deg", "elevation_deg", "balls")
    tables = [{key: value for key in keys if (value := getattr(p, key)) is not None} for p in listed]
    path.write_text(toml({"positions": tables}))
    return str(path)


def _scenario(dice: Dice, settings: Document, machine: Document, spindle: Spindle, seed: int) -> Scenario:
    """Return the scenario of the true world, with errors up to one and a half times those of the shipped scenario."""
    low = [machine["axes"][axis]["range_mm"][0] for axis in "XYZ"]
    high = [machine["axes"][axis]["range_mm"][1] for axis in "XYZ"]
    retreated = (low if spindle.sign > 0 else high)[spindle.axis]
    start = [
        retreated + spindle.sign * dice.one_of(0.0, dice.between(0, 40))
        if axis == spindle.axis
        else dice.between(low[axis], high[axis])
        for axis in range(3)
    ]
    reach_m = settings["mount"]["shaft_mm"] * 1e-3 + 1.0
    document = ScenarioDocument.model_validate(
        {
            **{name: settings[name] for name in ("machine", "artefact", "mount", "probe")},
            "stations_mm": settings["stations"]["places_mm"],
            "standing_at": settings["stations"]["standing_at"] or dice.whole(1, len(settings["stations"]["places_mm"])),
            "start_mm": start,
            "seed": seed % 2**31,
            "truth": {
                "seed": seed % 2**31,
                "legendre_order": 5,
                "scale": dice.one_of(0.0, 0.0, 0.0, dice.between(0, 4)),
                "deflection": False,
            },
            "trigger": {
                "pretravel_um": dice.between(0, 15),
                "lobing_um": dice.between(0, 1),
                "touch_sigma_um": dice.between(0.1, 1.5),
                "overtravel_mm": dice.between(4, 8),
            },
            "axes": {"repeatability_um": dice.between(0, 0.6), "backlash_um": dice.between(0, 2)},
            "mount_behaviour": {
                "index_error_deg": dice.between(0, 0.015 / reach_m, 4),
                "wobble_um": dice.between(0, 30),
                "place_error_mm": dice.between(0, 0.45, 2),
                "place_error_deg": dice.between(0, 0.045 / reach_m, 4),
            },
            "temperatures": {"artefact_c": dice.between(17, 25), "machine_c": dice.between(17, 25)},
        }
    )
    return build_scenario(document, Path("/"))


def with_start(scenario: Scenario, start_mm: tuple[float, float, float]) -> Scenario:
    return dataclasses.replace(scenario, settings=scenario.settings.model_copy(update={"start_mm": start_mm}))


def toml(document: Document) -> str:
    """Return `document` as TOML text with one line for each top-level key.

    Nested dictionaries become inline tables. Top-level keys with the value None are omitted.
    """
    return "".join(f"{name} = {_inline(value)}\n" for name, value in document.items() if value is not None)


def _inline(value: object) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_inline(part)}" for name, part in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(part) for part in value) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return json.dumps(value)
