import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from twin.artefact.artefact_body import Rod
from twin.artefact.position_set import Position
from twin.errors import DataError, FormatError
from twin.formats.artefact_file import format_artefact, parse_artefact
from twin.formats.position_set_file import format_positions, parse_positions

SHIPPED = Path(__file__).parents[3] / "config" / "artefacts" / "ball-bar-1500.toml"
TEXT = """
name = "pair"
cte_per_k = 11.5e-6
cte_standard_uncertainty_per_k = 0.3e-6
ball_diameter_mm = 20.0
balls = [[-50.0, 0.0, 0.0], [50.0, 0.0, 0.0]]
standard_uncertainty_um = 0.8
"""


def test_the_shipped_bar_is_the_case_study() -> None:
    artefact = parse_artefact(SHIPPED.read_text(encoding="utf-8"), str(SHIPPED))
    assert artefact.count == 11
    assert np.linalg.norm(artefact.balls[-1] - artefact.balls[0]) == pytest.approx(1500.0, abs=1.0)
    assert np.sqrt(np.diag(artefact.covariance)) == pytest.approx(np.full(33, 0.8e-3))


def test_a_bar_section_is_worked_out() -> None:
    bar = "[bar]\nballs = 5\nlength_mm = 400.0\ntilt_deg = 30.0\nholder_length_mm = 50.0\n"
    artefact = parse_artefact(TEXT.replace("balls = [[-50.0, 0.0, 0.0], [50.0, 0.0, 0.0]]", "") + bar, "b.toml")
    assert artefact.balls[1] == pytest.approx([-100.0, -75.0, 0.0])


def test_a_covariance_file_is_read_in_square_micrometres() -> None:
    rows = "\n".join(",".join("4.0" if i == j else "0.0" for j in range(6)) for i in range(6))
    text = TEXT.replace("standard_uncertainty_um = 0.8", 'covariance_file = "c.csv"')
    artefact = parse_artefact(text, "a.toml", {"c.csv": rows}.__getitem__)
    assert artefact.covariance == pytest.approx(np.eye(6) * 4e-6)
    with pytest.raises(FormatError, match=r"'x' is not a finite number \(file c.csv, row 1, column 1\)"):
        parse_artefact(text, "a.toml", {"c.csv": rows.replace("4.0", "x", 1)}.__getitem__)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("cte_per_k", "cte_per_kelvin", "cte_per_kelvin"),
        ("standard_uncertainty_um = 0.8", "", "standard_uncertainty_um"),
        ("[50.0, 0.0, 0.0]", "[50.0, 0.0]", "balls"),
        ("[50.0, 0.0, 0.0]", "[nan, 0.0, 0.0]", "balls"),
        ("[50.0, 0.0, 0.0]", "[5e200, 0.0, 0.0]", "balls"),
        ("20.0", "-20.0", "ball_diameter_mm"),
        ("[50.0, 0.0, 0.0]", "[-45.0, 0.0, 0.0]", "balls 0 and 1"),
    ],
)
def test_a_wrong_file_names_itself_and_the_place(old: str, new: str, told: str) -> None:
    with pytest.raises((FormatError, DataError)) as caught:
        parse_artefact(TEXT.replace(old, new), "pair.toml")
    assert "pair.toml" in str(caught.value)
    assert told in str(caught.value)


PLATE = """
[holders]
direction = [0.0, 0.0, 2.0]
length_mm = 30.0
radius_mm = 3.0
[[bodies]]
name = "plate"
lower_mm = [-60.0, -20.0, -50.0]
upper_mm = [60.0, 20.0, -30.0]
[[bodies]]
from_mm = [0.0, 0.0, -50.0]
to_mm = [0.0, 0.0, -90.0]
radius_mm = 8.0
"""


def test_the_solid_parts_of_any_artefact_are_data_of_its_file() -> None:
    bar = parse_artefact(TEXT, "bar.toml")
    assert [rod.name for rod in bar.rods] == ["post 0", "post 1", "bar"]
    assert (bar.half_span_mm, bar.reach_mm) == (65.0, 80.0)
    plate = parse_artefact(TEXT + PLATE, "plate.toml")
    assert [rod.name for rod in plate.rods] == ["post 0", "post 1", "plate", "plate", "frame"]
    assert plate.rods[0].start_mm == (-50.0, 0.0, -30.0)
    # the rods of the box contain its corners, and protrude little from its large faces
    for corner in itertools.product((-60.0, 60.0), (-20.0, 20.0), (-50.0, -30.0)):
        assert any(distance(rod, corner) <= 1e-9 for rod in plate.rods)
    assert all(distance(rod, (0.0, y, -25.8)) > 0.0 for rod in plate.rods[2:] for y in (-10.0, 0.0, 10.0))


def distance(rod: Rod, point: tuple[float, float, float]) -> float:
    base, axis, first, last = rod.line
    along = min(max(float(np.array(point) @ axis), first), last)
    return float(np.linalg.norm(base + along * axis - point)) - rod.radius_mm


@pytest.mark.parametrize(
    ("added", "told"),
    [
        ("[holders]\ndirection = [0, 0, 1]\n", "'length_mm' together"),
        ("[holders]\ndirection = [0, 0, 0]\nlength_mm = 3\n", "must not be zero"),
        ("[holders]\nfeet_mm = [[0, 0, -9]]\n", "[beam] for a bar"),
        ("bodies = []\n[holders]\nfeet_mm = [[0, 0, -9]]\n", "1 feet of holders for 2 balls"),
        ("[[bodies]]\nfrom_mm = [0, 0, 0]\n", "bodies[0]"),
        ("[[bodies]]\nlower_mm = [0, 0, 0]\nupper_mm = [1, 1, 0]\n", "'frame' needs a lower corner"),
        ('[[bodies]]\nname = "ball 1"\nfrom_mm = [0, 0, 0]\nto_mm = [1, 0, 0]\nradius_mm = 1\n', "named 'ball 1'"),
        ("sag_um = 3\nbodies = []\n", "sag_um"),
        ("sag_standard_uncertainty_um = 1\nbodies = []\n", "sag_standard_uncertainty_um"),
        ("sag_standard_uncertainty_um = -1\n", "sag_standard_uncertainty_um"),
    ],
)
def test_wrong_solid_parts_are_refused(added: str, told: str) -> None:
    with pytest.raises((FormatError, DataError)) as caught:
        parse_artefact(TEXT + added, "pair.toml")
    assert "pair.toml" in str(caught.value)
    assert told in str(caught.value)


@pytest.mark.parametrize(
    ("added", "sag_mm", "doubt_mm"),
    [
        ("sag_um = 3\n", 0.003, 0.0),
        ("sag_um = 0\n", 0.0, 0.0),
        ("sag_um = 3\nsag_standard_uncertainty_um = 0.5\n", 0.003, 0.0005),
        ("sag_standard_uncertainty_um = 7\n", 0.0, 0.007),
        ("bodies = []\n", 0.0, 0.0),
        ("[beam]\nradius_mm = 15.0\n", 0.0, 0.002),  # two balls 300 mm apart: less than 0.1 µm by its weight
    ],
)
def test_a_sag_that_is_not_stated_is_as_uncertain_as_the_shape_allows(
    added: str, sag_mm: float, doubt_mm: float
) -> None:
    artefact = parse_artefact(TEXT + added, "pair.toml")
    assert artefact.sag_mm == pytest.approx(sag_mm)
    assert artefact.sag_standard_uncertainty_mm == pytest.approx(doubt_mm)


def test_positions_survive_writing_and_reading() -> None:
    positions = (Position(2, -45.0, 35.264), Position(1, 0.1 + 0.2, -math.degrees(0.5)))
    again = parse_positions(format_positions(positions), "p.csv")
    assert [position.station for position in again] == [position.station for position in positions]
    for read, written in zip(again, positions, strict=True):
        assert (read.azimuth_deg, read.elevation_deg) == pytest.approx((written.azimuth_deg, written.elevation_deg))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("station,azimuth\n1,2\n", "station,azimuth_deg,elevation_deg"),
        ("station,azimuth_deg,elevation_deg\n1,2,x\n", "row 2, column elevation_deg"),
        ("station,azimuth_deg,elevation_deg\n1,2\n", "row 2, column elevation_deg"),
        ("station,azimuth_deg,elevation_deg\n1,2,3\n1.5,2,3\n", "row 3, column station"),
        ("station,azimuth_deg,elevation_deg\n1,2,3\n1,2,95\n", "row 3"),
        ("station,azimuth_deg,elevation_deg\n1,2,3\n1,2,3\n", "is already listed as number 1"),
        ("station,azimuth_deg,elevation_deg\n", "no position"),
        ("", "missing"),
    ],
)
def test_a_wrong_position_file_names_row_and_column(text: str, told: str) -> None:
    with pytest.raises(FormatError) as caught:
        parse_positions(text, "p.csv")
    assert told in str(caught.value)
    assert "p.csv" in str(caught.value)


def test_two_ways_of_giving_the_same_are_refused_in_words() -> None:
    with pytest.raises(FormatError, match=r"^give either 'standard_uncertainty_um' or 'covariance_file'"):
        parse_artefact(TEXT + 'covariance_file = "c.csv"\n', "a.toml")


@pytest.mark.parametrize("name", [r"bar\nsag_um = 900.0", r"bar \u007f", r"bar\u0001", r"bar\rend", r"\u2028bar"])
def test_an_artefact_of_any_name_is_written_readable(name: str) -> None:
    """The file of a calibrated artefact has its name in a comment, too."""
    numbers = "cte_per_k = 1e-5\ncte_standard_uncertainty_per_k = 1e-7\nball_diameter_mm = 20.0\n"
    balls = "balls = [[0, 0, 0], [100, 0, 0], [200, 0, 0]]\nstandard_uncertainty_um = 0.5\nsag_um = 1.5\n"
    stated = parse_artefact(f'name = "{name}"\n{numbers}{balls}', "bar.toml")
    text, covariance = format_artefact(stated, "covariance.csv", (f"{stated.name}, calibrated",))
    read = parse_artefact(text, "artefact.toml", lambda _: covariance)
    assert (read.name, read.sag_mm) == (stated.name, stated.sag_mm)
    assert text.splitlines()[0].endswith(", calibrated")
