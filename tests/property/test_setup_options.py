"""Every value that `volcal init` is given comes back in a file, or it is refused."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent.planning.new_machine.answers import SetupAnswers
from agent.planning.new_machine.field import ProposalsOnly
from agent.planning.new_machine.fields import FIELDS, option_texts, parse_travels
from agent.planning.new_machine.machine_class import MACHINE_CLASSES
from agent.planning.new_machine.setup_files import checked_files
from agent.planning.new_machine.spindle import SPINDLES, parse_spindle
from drivers.errors import UserError
from twin.artefact.artefact import Artefact
from twin.formats.artefact_file import parse_artefact
from twin.machine.kinematic_chain import parse_chain

Options = Mapping[str, Any]


class Written:
    """Files of a new machine, parsed."""

    def __init__(self, texts: Mapping[str, str]) -> None:
        self.texts = texts
        self.machine = tomllib.loads(texts["machine.toml"])
        self.settings = tomllib.loads(texts["volcal.toml"])
        self.scenario = tomllib.loads(texts["simulator.toml"])
        self.artefact_document = tomllib.loads(texts["artefact.toml"])
        self.artefact: Artefact = parse_artefact(texts["artefact.toml"], "artefact.toml")

    def axes(self, key: str) -> tuple[Any, ...]:
        return tuple(self.machine["axes"][axis][key] for axis in "XYZ")

    @property
    def stylus(self) -> tuple[float, ...]:
        return tuple(self.machine["tools"]["probe"]["offset_mm"])

    @property
    def size_mm(self) -> float:
        """Extent of the artefact: of a bar between its end balls, of other shapes between two corners of one side."""
        bar = self.artefact_document.get("bar")
        if bar is not None:
            return float(bar["length_mm"])
        balls = np.array(self.artefact_document["balls"])
        name = self.artefact_document["name"]
        last = {"ball-plate": math.isqrt(len(balls)) - 1, "tetrahedron": 1}.get(name.rsplit("-", 1)[0])
        difference = balls[-1 if last is None else last] - balls[0]
        return float(abs(difference[0]) if last is None else np.linalg.norm(difference))

    @property
    def certified(self) -> tuple[float, float] | None:
        document = self.artefact_document
        if "end_length_mm" in document:
            return document["end_length_mm"], document["end_length_standard_uncertainty_um"]
        for one in document.get("reference_lengths", []):
            return one["length_mm"], one["standard_uncertainty_um"]
        return None

    @property
    def calibration(self) -> str:
        nominal = self.artefact_document["certificate"].startswith("nominal")
        return "certificate" if nominal else "none" if self.certified is None else "length"

    @property
    def connection(self) -> str | None:
        device = self.settings["devices"]["cnc"]
        options = device["options"]
        if "clock" in self.settings or device["driver"] == "linuxcnc":
            return None
        return str(options["port"]) if device["driver"] == "serial-cnc" else f"{options['host']}:{options['port']}"

    @property
    def controller(self) -> str:
        return "simulated" if "clock" in self.settings else str(self.settings["devices"]["cnc"]["driver"])


def close(one: object, other: object) -> bool:
    return bool(np.allclose(np.array(one, dtype=float), np.array(other, dtype=float), rtol=1e-12, atol=1e-9))


def in_both(written: Written, section: str, key: str, value: float) -> bool:
    """True if the settings and the scenario have the same stated value."""
    return written.settings[section][key] == value == written.scenario[section][key]


FOUND: dict[str, Callable[[Written, Any], bool]] = {
    "machine_class": lambda w, v: f"class {v} " in " ".join(w.texts["machine.toml"].replace("\n#", "").split()),
    "name": lambda w, v: w.machine["name"] == v.strip(),
    "controller": lambda w, v: w.controller == v,
    "address": lambda w, v: w.connection in {v, f"{v}:502"},
    "travel": lambda w, v: tuple(map(tuple, w.axes("range_mm"))) == parse_travels(" ".join(v)),
    "spindle": lambda w, v: close(w.stylus, np.linalg.norm(w.stylus) * parse_spindle(v).stylus_axis),
    "chain": lambda w, v: parse_chain(w.machine["chain"]) == parse_chain(v),
    "stylus": lambda w, v: sum(abs(part) for part in w.stylus) == v,
    "tip_diameter": lambda w, v: in_both(w, "probe", "tip_radius_mm", 0.5 * v),
    "stem": lambda w, v: in_both(w, "probe", "stem_length_mm", v),
    "probe_diameter": lambda w, v: in_both(w, "probe", "body_radius_mm", 0.5 * v),
    "rapid": lambda w, v: w.axes("rapid_mm_per_min") == v,
    "feed": lambda w, v: w.axes("feed_mm_per_min") == v,
    "acceleration": lambda w, v: w.axes("acceleration_mm_per_s2") == v,
    "artefact": lambda w, v: w.texts["artefact.toml"] == Path(v).read_text(encoding="utf-8"),
    "shape": lambda w, v: ("bar" if v.endswith("bar") else v) in w.artefact_document["name"],
    "size": lambda w, v: abs(w.size_mm - v) < 2e-4,
    "balls": lambda w, v: w.artefact.count == v,
    "tilt": lambda w, v: _first_holder(w)[1] == pytest.approx(v, abs=0.01),
    "holder": lambda w, v: _first_holder(w)[0] == pytest.approx(v, abs=1e-4),
    "ball_diameter": lambda w, v: w.artefact_document["ball_diameter_mm"] == v,
    "calibration": lambda w, v: w.calibration == v,
    "certified_length": lambda w, v: w.certified is not None and w.certified[0] == v,
    "length_uncertainty": lambda w, v: w.certified is not None and w.certified[1] == v,
    "placement": lambda w, v: ("placed_by_hand" in w.settings["stations"]) == (v == "by-hand"),
    "mount_at": lambda w, v: (
        w.settings["stations"]["places_mm"][0] == list(v) == w.scenario["stations_mm"][w.scenario["standing_at"] - 1]
    ),
    "shaft": lambda w, v: in_both(w, "mount", "shaft_mm", v),
    "table_z": lambda w, v: in_both(w, "mount", "table_z_mm", v),
    "stations": lambda w, v: len(w.settings["stations"]["places_mm"]) == v == len(w.scenario["stations_mm"]),
    "position_set": lambda w, v: w.settings["procedure"]["position_set"] == v,
    "touches": lambda w, v: w.settings["procedure"]["touches_per_ball"] == int(v),
}
"""For each option: whether its value is in the files."""


def _first_holder(written: Written) -> tuple[float, float]:
    """Return length in mm and tilt in degrees of the holder of ball 0, which is tilted sideways."""
    document = written.artefact_document
    if "bar" in document:
        return document["bar"]["holder_length_mm"], document["bar"]["tilt_deg"]
    if "holders" in document:
        return document["holders"]["length_mm"], 0.0
    _, sideways, out = document["balls"][0]
    return abs(out), math.degrees(math.asin(min(1.0, abs(sideways / out))))


def written_files(options: Options, folder: Path) -> Written:
    """Return the files that `volcal init` writes for these options. Raises UserError if they are refused."""
    setup = SetupAnswers(option_texts(options), ProposalsOnly(), folder).collect()
    texts, _ = checked_files(setup, folder)
    return Written(texts)


def lost(options: Options, written: Written) -> list[str]:
    """Return the names of the options whose values are not in the files."""
    return [name for name, value in options.items() if not FOUND[name](written, value)]


MILL: Options = {"machine_class": "mill", "travel": ("800", "500", "400")}


def test_every_option_has_a_reader() -> None:
    assert set(FOUND) == set(FIELDS)


NUMBERS = st.floats(-500.0, 1500.0, allow_nan=False) | st.integers(-500, 1500).map(float)
AXIS = st.integers(300, 1200).map(str) | st.tuples(st.integers(-900, 0), st.integers(200, 900)).map(
    lambda ends: f"{ends[0]}:{ends[1]}"
)
DYNAMICS = st.tuples(*[st.floats(50.0, 30000.0)] * 3)
VALUES: dict[str, st.SearchStrategy[Any]] = {
    "machine_class": st.sampled_from(sorted(MACHINE_CLASSES)),
    "name": st.text("abcÄ\"'\\#= ", min_size=0, max_size=8),
    "controller": st.sampled_from(["simulated", "linuxcnc"]),
    "address": st.sampled_from(["plc", "192.0.2.7:1502", "/dev/ttyUSB0", "", "plc:", "plc:0"]),
    "travel": st.tuples(AXIS, AXIS, AXIS),
    "spindle": st.sampled_from(SPINDLES),
    "chain": st.sampled_from(["tool-Z-bed-Y-X-workpiece", "tool-X-Z-bed-Y-workpiece", "tool-Z-bed-workpiece"]),
    "stylus": st.floats(20.0, 400.0),
    "tip_diameter": st.floats(-1.0, 10.0),
    "stem": st.floats(-1.0, 120.0),
    "probe_diameter": st.floats(-1.0, 70.0),
    "rapid": DYNAMICS,
    "feed": DYNAMICS,
    "acceleration": DYNAMICS,
    "shape": st.sampled_from(["tilted-bar", "straight-bar", "ball-plate", "tetrahedron"]),
    "size": st.floats(80.0, 800.0) | st.integers(80, 800).map(float),
    "balls": st.integers(2, 25),
    "tilt": st.floats(0.0, 60.0) | st.just(0.0),
    "holder": st.floats(5.0, 90.0) | st.sampled_from([0.0, -5.0]),
    "ball_diameter": st.floats(4.0, 30.0),
    "calibration": st.sampled_from(["certificate", "length", "none"]),
    "certified_length": st.floats(80.0, 800.0),
    "length_uncertainty": st.floats(0.1, 5.0),
    "placement": st.sampled_from(["mount", "by-hand"]),
    "mount_at": st.tuples(st.floats(-300.0, 900.0), st.floats(0.0, 600.0), st.floats(-120.0, 60.0)),
    "shaft": st.floats(0.0, 200.0),
    "table_z": st.floats(-400.0, 50.0),
    "stations": st.integers(1, 6),
    "position_set": st.sampled_from(["S1", "S3", "S1+S3", "S9"]),
    "touches": st.sampled_from(["5", "9", "13", "25"]),
}


@st.composite
def options_of_init(draw: st.DrawFn) -> Options:
    """Draw a mill or another machine, with up to five more options."""
    names = draw(st.sets(st.sampled_from(sorted(set(VALUES) - set(MILL))), min_size=1, max_size=5))
    machine = draw(st.sampled_from([MILL, None]))
    base = machine or {name: draw(VALUES[name]) for name in MILL}
    return {**base, **{name: draw(VALUES[name]) for name in sorted(names)}}


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(options_of_init())
def test_every_stated_value_comes_back_in_a_file_or_is_refused(options: Options) -> None:
    with TemporaryDirectory() as folder:
        try:
            written = written_files(options, Path(folder))
        except UserError:
            return
        assert lost(options, written) == []


NEEDED: dict[str, Options] = {
    "length_uncertainty": {"calibration": "length"},
    "address": {"controller": "modbus-cnc"},
}
"""Options without which another has no meaning."""
GOOD: Options = {
    **MILL,
    "name": 'Halle "2"',
    "controller": "linuxcnc",
    "address": "127.0.0.1:1",
    "spindle": "+Y",
    "chain": "tool-Z-bed-X-Y-workpiece",
    "stylus": 162.5,
    "tip_diameter": 5.0,
    "stem": 61.25,
    "probe_diameter": 38.0,
    "rapid": (10000.0, 9000.5, 8000.0),
    "feed": (1000.0, 2000.0, 1500.25),
    "acceleration": (900.0, 800.0, 700.5),
    "shape": "ball-plate",
    "size": 390.5,
    "balls": 7,
    "tilt": 12.5,
    "holder": 42.5,
    "ball_diameter": 19.05,
    "calibration": "none",
    "certified_length": 400.0131,
    "length_uncertainty": 0.35,
    "placement": "by-hand",
    "mount_at": (302.5, 251.25, -30.75),
    "shaft": 82.25,
    "table_z": -210.5,
    "stations": 4,
    "position_set": "S1+S2",
    "touches": "13",
}


@pytest.mark.parametrize("name", GOOD)
def test_a_good_value_of_each_option_is_accepted_and_comes_back(tmp_path: Path, name: str) -> None:
    options = {**MILL, name: GOOD[name], **NEEDED.get(name, {})}
    assert lost(options, written_files(options, tmp_path)) == []


@pytest.mark.parametrize(
    ("stated", "option", "words"),
    [
        ({"mount_at": (4000.0, 250.0, -30.0)}, "--mount-at", "X = 4000 mm is beyond the reach of the stylus"),
        ({"mount_at": (990.0, 250.0, -30.0)}, "--mount-at", "if the mount stands at (990, 250, -30)"),
        ({"holder": 0.0}, "--holder", "not a length"),
        ({"holder": -5.0}, "--holder", "not a length"),
        ({"tilt": 10.0, "shape": "straight-bar"}, "--tilt", "are not tilted"),
        ({"tilt": 10.0, "shape": "tetrahedron"}, "--tilt", "are not tilted"),
        ({"length_uncertainty": 0.5}, "--length-uncertainty", "no meaning"),
        ({"certified_length": 400.0, "calibration": "none"}, "--certified-length", "no meaning"),
        ({"shaft": math.nan}, "--shaft", "a number of at least 0"),
        ({"mount_at": (math.nan, 250.0, -30.0)}, "--mount-at", "three numbers"),
        ({"name": " "}, "--name", "is empty"),
    ],
)
def test_a_value_that_no_file_can_contain_is_refused(tmp_path: Path, stated: Options, option: str, words: str) -> None:
    with pytest.raises(UserError) as refused:
        written_files({**MILL, **stated}, tmp_path)
    assert words in str(refused.value)
    assert refused.value.where.get("option", "") == option


ARTEFACT_VALUES = (
    "shape", "size", "balls", "tilt", "holder", "ball_diameter", "calibration", "certified_length",
    "length_uncertainty",
)  # fmt: skip


@pytest.mark.parametrize("name", ARTEFACT_VALUES)
def test_an_artefact_file_has_no_values_beside_it(tmp_path: Path, name: str) -> None:
    file = tmp_path / "mine.toml"
    file.write_text(written_files(MILL, tmp_path).texts["artefact.toml"])
    assert lost({**MILL, "artefact": file}, written_files({**MILL, "artefact": file}, tmp_path)) == []
    with pytest.raises(UserError, match="names the file of another") as refused:
        written_files({**MILL, "artefact": file, name: GOOD[name]}, tmp_path)
    assert refused.value.where["option"] == FIELDS[name].flag


@pytest.mark.parametrize(
    ("x_mm", "count", "others"),
    [
        (186.0, 3, [400.0, 614.0]),
        (400.0, 3, [186.0, 614.0]),
        (614.0, 2, [186.0]),
        (300.0, 4, [186.0, 457.0, 614.0]),
        (50.0, 3, [332.0, 614.0]),
        (402.5, 1, []),
    ],
)
def test_the_other_stations_are_spread_around_the_stated_place(
    tmp_path: Path, x_mm: float, count: int, others: list[float]
) -> None:
    written = written_files({**MILL, "mount_at": (x_mm, 251.5, -30.0), "stations": count}, tmp_path)
    assert written.settings["stations"]["places_mm"] == [[x, 251.5, -30.0] for x in (x_mm, *others)]
    ends = sorted(range(count), key=lambda index: [x_mm, *others][index])
    assert written.settings["verification"]["stations"] == sorted({ends[0] + 1, ends[-1] + 1})
