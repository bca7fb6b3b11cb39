from pathlib import Path

import numpy as np
import pytest

from twin.errors import FormatError
from twin.formats.machine_file import parse_machine
from twin.machine.forward_model import deviation_basis
from twin.machine.volumetric import QuadraticForm, evaluation_grid, rms, volumetric_error

FILE = Path(__file__).parents[3] / "config" / "machines" / "case-study.toml"
TEXT = FILE.read_text(encoding="utf-8")
LEAST = """
name = "small"
chain = "tool-Z-bed-X-Y-workpiece"
[axes.X]
range_mm = [0.0, 500.0]
rapid_mm_per_min = 10000.0
acceleration_mm_per_s2 = 300.0
[axes.Y]
range_mm = [-200.0, 200.0]
travel_mm = [-210.0, 205.0]
rapid_mm_per_min = 10000.0
acceleration_mm_per_s2 = 300.0
[axes.Z]
range_mm = [-400.0, 0.0]
rapid_mm_per_min = 8000.0
acceleration_mm_per_s2 = 200.0
[tools.probe]
offset_mm = [0.0, 0.0, -150.0]
"""


def read_beside(name):
    return (FILE.parent / name).read_text(encoding="utf-8")


def never(name):
    raise AssertionError(f"nothing should be read, not {name}")


def parse(text):
    return parse_machine(text, "m.toml", read_beside)


@pytest.fixture(scope="module")
def case_study():
    return parse_machine(TEXT, FILE.name, read_beside)


def test_the_case_study(case_study):
    model = case_study.model
    assert str(model.chain) == "tool-Y-Z-X-bed-workpiece"
    assert case_study.limits == model.ranges_mm == ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
    assert model.size == 90
    assert case_study.rapid_mm_per_min == (20000.0,) * 3
    assert case_study.acceleration_mm_per_s2 == (500.0,) * 3
    np.testing.assert_array_equal(case_study.tool("probe"), [0.0, 250.0, 0.0])
    assert case_study.family.half_widths[model.index("EXX[1]")] == pytest.approx(8e-3)


def test_the_least_a_file_must_say():
    machine = parse_machine(LEAST, "m.toml", never)
    assert machine.deflection is None
    assert machine.limits[1] == (-210.0, 205.0)
    assert machine.model.ranges_mm[1] == (-200.0, 200.0)
    assert set(machine.model.orders.values()) == {5}
    assert machine.model.cross_effect == ("b1", "b2", "c1")


def test_orders_and_cross_effect_by_choice():
    machine = parse_machine(LEAST + "[model]\norder = { EXX = 7, EBZ = 2 }\ncross_effect = false", "m.toml", never)
    orders = machine.model.orders
    assert (orders["EXX"], orders["EBZ"], orders["EYY"]) == (7, 2, 5)
    assert machine.model.cross_effect == ()
    listed = parse_machine(LEAST + '[model]\ncross_effect = ["c0", "b0"]', "m.toml", never)
    assert listed.model.cross_effect == ("b0", "c0")


def test_family_amplitudes_as_list_or_single_value():
    text = LEAST + "[model.family]\npositioning_um = [4.0, 1.0]\nrotation_urad = 2.0\ndecay = 0.5"
    machine = parse_machine(text, "m.toml", never)
    width = dict(zip(machine.model.names, machine.family.half_widths, strict=True))
    assert [width[f"EXX[{k}]"] for k in (1, 2, 3)] == pytest.approx([4e-3, 1e-3, 0.5e-3])
    assert [width[f"EAZ[{k}]"] for k in (1, 2, 3)] == pytest.approx([2e-6, 1e-6, 0.5e-6])


@pytest.mark.parametrize(
    ("old", "new", "key", "says"),
    [
        ("rapid_mm", "rapit_mm", "axes.X.rapit_mm_per_min", "Did you mean 'rapid_mm_per_min'"),
        ('name = "case-study"', "", "name", "is missing"),
        ("[0.0, 4000.0]", "[4000.0, 0.0]", "axes.X.range_mm", "reversed"),
        ("[0.0, 4000.0]", "[0.0, nan]", "axes.X.range_mm[1]", "finite"),
        ("[0.0, 4000.0]", "[0.0]", "axes.X.range_mm[1]", "value number 2 is missing"),
        ("[0.0, 4000.0]", "[0.0, 5000.0]", "deflection.grid", "does not cover the travel"),
        ("[0.0, 1300.0]", "[0.0, 1300.0]\ntravel_mm = [0.0, 1200.0]", "axes.Y.travel_mm", "exceeds the travel"),
        ("tool-Y-Z-X", "tool-Y-Z-Z", "chain", "axis Z is listed twice"),
        ("order = 5 ", "order = 55 ", "model.order", "less than or equal to 15"),
        ("order = 5 ", "order = { EXQ = 1 } ", "model.order.EXQ", "EXX, EYX"),
        ("effect = true", 'effect = ["b7"]', "model.cross_effect[0]", "'b7'"),
        ("[8.0, 5.0,", "[8.0, -5.0,", "model.family.positioning_um[1]", "greater than or equal to 0"),
        ("case-study-deflection.csv", "absent.csv", "deflection.grid", "'absent.csv' cannot be read: No such file"),
        ("[model]", "[modl]", "modl", "Did you mean 'model'"),
        ("acceleration_mm_per_s2 = 500.0", "acceleration_mm_per_s2 = 0", "axes.X.acceleration_mm_per_s2", "greater"),
    ],
)
def test_each_mistake_names_file_key_and_what_to_do(old, new, key, says):
    assert old in TEXT
    with pytest.raises(FormatError) as caught:
        parse(TEXT.replace(old, new, 1))
    assert (caught.value.where["file"], caught.value.where["key"]) == ("m.toml", key)
    assert says in str(caught.value)


def test_no_tool_and_an_unknown_tool(case_study):
    with pytest.raises(FormatError, match="tools"):
        parse_machine(LEAST.split("[tools", maxsplit=1)[0], "m.toml", never)
    with pytest.raises(ValueError, match=r"no tool 'drill'.*Known tools: probe"):
        case_study.tool("drill")


def test_a_mistake_in_the_grid_names_the_grid():
    with pytest.raises(FormatError, match=r"column 'x_mm' is missing \(file case-study-deflection.csv, row 1\)"):
        parse_machine(TEXT, "m.toml", lambda name: "a,b\n1,2\n")


def test_the_family_with_its_deflection_has_the_published_volumetric_error(case_study):
    grid = evaluation_grid(case_study.model.ranges_mm)
    form = QuadraticForm.build(case_study.model, grid, case_study.tool("probe"))
    form = form.with_field(case_study.deflection.at(grid))
    raw, aligned = form.values(case_study.family.draw(np.random.default_rng(1), 10_000))
    assert 1e3 * np.median(raw) == pytest.approx(11.9, abs=0.1)
    assert 8.5 < 1e3 * np.median(aligned) < 9.7


def test_the_deflection_is_a_plausible_part_and_not_all_of_it_can_be_identified(case_study):
    grid = evaluation_grid(case_study.model.ranges_mm, (24, 12, 12))
    tool = case_study.tool("probe")
    field = case_study.deflection.at(grid)
    alone = volumetric_error(grid + tool, field)
    assert 3.0 < alone.raw_um < 6.0
    points = (grid + tool) / 1000.0
    rigid = np.stack([np.cross(unit, points) for unit in np.eye(3)] + [np.tile(u, (len(grid), 1)) for u in np.eye(3)])
    basis = deviation_basis(case_study.model, grid, tool).reshape(-1, case_study.model.size)
    columns = np.hstack((basis / np.maximum(np.linalg.norm(basis, axis=0), 1e-9), rigid.reshape(6, -1).T))
    fit, *_ = np.linalg.lstsq(columns, field.reshape(-1), rcond=1e-10)
    left = field - (columns @ fit).reshape(-1, 3)
    assert 0.7e-3 < rms(left) < 1.2e-3
