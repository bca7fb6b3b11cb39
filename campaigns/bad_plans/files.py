"""Bad plans whose files are wrong: well-formed but wrong settings, or invalid machine, artefact or position files."""

from __future__ import annotations

import math
from collections.abc import Callable

from agent.errors import PlanRefused
from campaigns.bad_plans.mutation import BadPlan, CaseFiles, Change, artefact, machine, positions, setting
from drivers.errors import ConfigurationError, InputError

HELD_OUT = "verification.positions_deg"
OFFSET = "tools.probe.offset_mm"


def config(name: str, change: Change, *words: str) -> BadPlan:
    return BadPlan(name, change, ConfigurationError, words)


def combine(*changes: Change) -> Change:
    def change(files: CaseFiles) -> None:
        for one in changes:
            one(files)

    return change


def _stations() -> list[BadPlan]:
    nowhere = [[700.0, 5000.0, 750.0]] * 4
    return [
        config("station of the set that is not there", setting("procedure.stations", [9]), "station 9"),
        config("station of the proof that is not there", setting("verification.stations", [7]), "station 7"),
        config("stands at a station that is not there", setting("stations.standing_at", 6), "station 6"),
        config("station counted from zero", setting("procedure.stations", [0]), "procedure.stations"),
        config("places out of reach", setting("stations.places_mm", nowhere), "three balls"),
        config("place in metres", setting("stations.places_mm", [[0.7, 1.0, 0.75]]), "stations.places_mm"),
        config("place with two coordinates", setting("stations.places_mm", [[700.0, 1000.0]]), "stations.places_mm[0]"),
        config("place not a number", setting("stations.places_mm.0.1", math.nan), "stations.places_mm[0][1]"),
        config("no place", setting("stations.places_mm", []), "stations.places_mm"),
        config("no room to park", setting("stations.park_distance_mm", 9000.0), "stations.park_distance_mm"),
        config("mount of one station missing", setting("roles.mount", {"1": "mount"}), "roles.mount"),
        config("no such device", setting("roles.machine", "cnc2"), "'cnc2'", "roles.machine"),
    ]


def _positions() -> list[BadPlan]:
    def listed(
        name: str, kind: type[ConfigurationError] | type[InputError], rows: tuple[str, ...], *words: str
    ) -> BadPlan:
        return BadPlan(f"positions: {name}", positions(*rows), kind, ("positions.csv", *words))

    return [
        listed("unreachable entry", ConfigurationError, ("1,45,0", "1,90,0"), "position 2", "within reach"),
        listed(
            "bar hidden behind its mount", ConfigurationError, ("1,45,0", "1,180,0"), "position 2", "three are needed"
        ),
        listed("station without a place", ConfigurationError, ("7,45,0",), "station 7", "stations.places_mm"),
        listed("twice", InputError, ("1,45,0", "1,45,0"), "row 3"),
        listed("none", InputError, (), "no position is listed"),
        listed("no number", InputError, ("1,up,0",), "row 2", "azimuth_deg"),
        listed("NaN", InputError, ("1,nan,0",), "row 2", "azimuth_deg"),
        listed("infinite", InputError, ("1,45,inf",), "row 2", "elevation_deg"),
        listed("half a station", InputError, ("1.5,45,0",), "row 2", "station"),
        listed("station zero", InputError, ("0,45,0",), "stations count from 1", "row 2"),
        listed("azimuth too large", InputError, ("1,190,0",), "outside ±180°", "row 2"),
        listed("elevation too large", InputError, ("1,0,91",), "±90°", "row 2"),
        listed("cell missing", InputError, ("1,45",), "row 2", "elevation_deg"),
        config("also held out", combine(positions("1,45,0", "1,20,25")), HELD_OUT),
        config("held out beyond the mount", setting(HELD_OUT, [[20.0, 95.0]]), "95"),
        config("held out out of reach", setting(HELD_OUT, [[90.0, 0.0]]), "verification.positions_deg"),
        config("nothing held out", setting(HELD_OUT, []), HELD_OUT),
        config("held out NaN", setting(HELD_OUT, [[math.nan, 0.0]]), HELD_OUT),
        config("unknown set", setting("procedure.position_set", "S9"), "'S9'", "S1, S2, S3"),
        BadPlan("no such position file", setting("procedure.position_set", "none.csv"), InputError, ("none.csv",)),
    ]


def _artefact() -> list[BadPlan]:
    balls = "balls.1"
    return [
        config("balls overlap", artefact(balls, [-745.0, -60.0, 15.5]), "balls 0 and 1", "artefact.toml"),
        config("ball listed twice", artefact(balls, [-750.0442, -60.0414, 15.5245]), "balls 0 and 1"),
        config("one ball", artefact("balls", [[0.0, -60.0, 0.0]]), "balls", "artefact.toml"),
        config("ball of no size", artefact("ball_diameter_mm", 0.0), "ball_diameter_mm"),
        config("ball of negative size", artefact("ball_diameter_mm", -25.0), "ball_diameter_mm"),
        config("balls so large that they meet", artefact("ball_diameter_mm", 160.0), "apart"),
        config("ball with two coordinates", artefact(balls, [-600.0, -75.0]), "balls[1]", "artefact.toml"),
        config("ball not a number", artefact(balls, [math.nan, -75.0, 0.0]), "balls[1]"),
        config("ball infinite", artefact(balls, [-600.0, math.inf, 0.0]), "balls[1]"),
        config("expansion of ice cream", artefact("cte_per_k", 0.5), "cte_per_k"),
        config("negative uncertainty", artefact("standard_uncertainty_um", -1.0), "standard_uncertainty_um"),
        config("two uncertainties", artefact("covariance_file", "c.csv"), "covariance_file"),
        config("unknown key", artefact("colour", "red"), "colour", "artefact.toml"),
        config("balls and bar", artefact("bar", {"balls": 5, "length_mm": 900.0}), "balls"),
        config("balls inside their own bar", _sunk, "three"),
    ]


def _sunk(files: CaseFiles) -> None:
    """Set the length of the ball holders to zero, which puts every ball inside the bar, out of reach of the probe."""
    for ball in files.artefact["balls"]:
        ball[1:] = [0.0, 0.0]


def _machine() -> list[BadPlan]:
    return [
        config("axis without length", machine("axes.X.range_mm", [4000.0, 4000.0]), "axes.X.range_mm"),
        config("axis reversed", machine("axes.Y.range_mm", [1300.0, 0.0]), "axes.Y.range_mm"),
        config("range beyond the travel", machine("axes.Z.travel_mm", [0.0, 1000.0]), "axes.Z.travel_mm"),
        config("rapid of nothing", machine("axes.X.rapid_mm_per_min", 0.0), "axes.X.rapid_mm_per_min"),
        config("rapid backwards", machine("axes.X.rapid_mm_per_min", -1.0), "axes.X.rapid_mm_per_min"),
        config("infinite acceleration", machine("axes.Y.acceleration_mm_per_s2", math.inf), "acceleration_mm_per_s2"),
        config("chain that does not exist", machine("chain", "tool-Y-Q-X-bed-workpiece"), "chain", "'Q'"),
        config("no tool", machine("tools", {}), "tools"),
        config("tool with NaN", machine(OFFSET, [0.0, math.nan, 0.0]), "offset_mm"),
        config("tool shorter than the probe", machine(OFFSET, [0.0, 40.0, 0.0]), "too short", "probe.reach_mm"),
        config(
            "tool aside", machine(OFFSET, [40.0, 250.0, 0.0]), "not parallel to a machine axis", "tools.probe.offset_mm"
        ),
        config("tool backwards", machine(OFFSET, [0.0, -250.0, 0.0]), "three"),
        config("other tool", setting("tool", "drill"), "'drill'", "key tool"),
        config("tool so long that nothing is reached", machine(OFFSET, [0.0, 2500.0, 0.0]), "three balls"),
        config("travel too short for any ball", machine("axes.Y.range_mm", [0.0, 200.0]), "three"),
    ]


def _geometry() -> list[BadPlan]:
    return [
        config("stem longer than the probe", setting("probe.stem_length_mm", 240.0), "too short", "probe.reach_mm"),
        config(
            "reach shorter than the body",
            setting("probe", {"reach_mm": 60.0, "stem_length_mm": 50.0}),
            "too short",
            "reach_mm",
        ),
        config("datum ball that is not there", setting("qualification", {"ball": 11}), "no ball 11"),
        config("table above the bar", setting("mount.table_z_mm", 900.0), "hits the table", "stations.places_mm"),
        config("pedestal in front of the balls", setting("mount.pedestal_radius_mm", 900.0), "three"),
        config("bar as thick as its holders are long", artefact("beam.radius_mm", 90.0), "three"),
        config("holders as thick as balls", artefact("holders.radius_mm", 14.0), "three"),
        config("stem thicker than the gap", setting("probe.stem_radius_mm", 200.0), "three"),
        BadPlan(
            "geometry: ram into the table",
            setting("mount.table_z_mm", -60.0),
            PlanRefused,
            ("preflight: collision", "ram with table"),
            {"step": "measure"},
        ),
        config("ram that fills the workspace", setting("probe.ram_half_width_mm", 4000.0), "three"),
    ]


def file_plans() -> list[BadPlan]:
    groups: tuple[Callable[[], list[BadPlan]], ...] = (_stations, _positions, _artefact, _machine, _geometry)
    return [bad for group in groups for bad in group()]
