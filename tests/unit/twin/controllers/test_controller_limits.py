"""Tables that a format cannot represent are refused with the reason, the location and a hint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from estimated_machine import CASE_STUDY, TOOL, known, source_of

from twin.compensation.controllers.export_format import ExportSource, TableEstimate
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.grids import require_small_corrections, resample_table
from twin.compensation.controllers.loss import require_same_machine
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable
from twin.errors import DataError
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.cross_term import CrossTerm

EVEN = ("siemens-lec", "siemens-cec", "heidenhain-com", "fanuc-pitch", "fanuc-3d")


def refused(name: str, source: ExportSource, **choices: object) -> DataError:
    with pytest.raises(DataError) as caught:
        FORMATS[name].export(source, ExportOptions(choices))
    assert caught.value.hint
    return caught.value


def alone(table: CompensationTable) -> ExportSource:
    return ExportSource(table)


def thin() -> CompensationTable:
    return resample_table(known(1).table, (21, 14, 16))


def test_error_motions_do_not_contain_the_cross_effect_of_other_beams() -> None:
    rail = CrossTerm("CROSS[rail.EZX]", "EZX", AxisPolynomial((((1, 1, 0), 1.0),)))
    model = replace(CASE_STUDY.model, structure=(rail,))
    error = refused("isg-volcomp", source_of(model, np.zeros(model.size)))
    assert "contains only the cross-effect of column and ram, not CROSS[rail.EZX]" in str(error)
    assert FORMATS["neutral"].export(source_of(model, np.zeros(model.size)), ExportOptions({})).files


@pytest.mark.parametrize(
    ("name", "points", "fitting"),
    [
        ("linuxcnc-comp", (257, 14, 16), "129x14x16"),
        ("heidenhain-com", (301, 14, 16), "151x14x16"),
        ("fanuc-pitch", (161, 14, 16), "81x14x16"),
        ("fanuc-3d", (41, 27, 16), "21x14x16"),
    ],
)
def test_too_many_points_name_a_grid_that_fits(name: str, points: tuple[int, int, int], fitting: str) -> None:
    error = refused(name, alone(resample_table(known(1).table, points)))
    assert f"--points {fitting}" in str(error)
    assert error.where["axis"] == "X"
    x, y, z = (int(n) for n in fitting.split("x"))
    FORMATS[name].export(alone(resample_table(known(1).table, (x, y, z))), ExportOptions({"detection_unit_um": 0.5}))


@pytest.mark.parametrize("name", EVEN)
def test_an_uneven_grid_names_axis_and_line_and_an_even_one_can_be_asked_for(name: str) -> None:
    table = thin()
    y = table.y.copy()
    y[3] += 20.0
    uneven = replace(table, y=y)
    error = refused(name, alone(uneven))
    assert error.where == {"axis": "Y", "row": str(2 + 3 * 16)}
    assert "--points" in error.hint
    FORMATS[name].export(alone(resample_table(uneven, (21, 14, 16))), ExportOptions())


@pytest.mark.parametrize("name", ["linuxcnc-comp", "isg-volcomp", "gcode-csv", "neutral"])
def test_an_uneven_grid_is_no_harm_to_the_others(name: str) -> None:
    source = known(1)
    x = np.delete(source.table.x, [3, 4, 9])
    corrections = np.delete(source.table.corrections, [3, 4, 9], axis=0)
    marks = np.delete(source.table.extrapolated, [3, 4, 9], axis=0)
    FORMATS[name].export(
        replace(source, table=replace(source.table, x=x, corrections=corrections, extrapolated=marks)), ExportOptions()
    )


def test_a_correction_beyond_all_reason_names_its_line() -> None:
    table = known(1).table
    corrections = table.corrections.copy()
    corrections[2, 3, 4, 1] = -1.5
    with pytest.raises(DataError, match=r"1500\.0 µm is larger than 1000 µm") as caught:
        require_small_corrections(replace(table, corrections=corrections))
    assert caught.value.where["row"] == str(2 + (2 * 14 + 3) * 16 + 4)
    require_small_corrections(replace(table, corrections=corrections), 2.0)


def test_another_machine_another_tool_and_another_night_are_told_from_the_right_one() -> None:
    source = known(1)
    require_same_machine(source)
    require_same_machine(replace(source, table=resample_table(source.table, (21, 14, 16))))
    with pytest.raises(DataError, match=r"differ by .* rms"):
        require_same_machine(ExportSource(source.table, known(2).estimate))
    with pytest.raises(DataError, match=r"differ by .* rms"):
        require_same_machine(
            ExportSource(replace(source.table, tool_offset=TOOL + np.array([0.0, 0.0, 900.0])), source.estimate)
        )
    known_of = source.estimate
    assert known_of is not None
    shorter = replace(known_of.model, ranges_mm=((0.0, 2000.0), *known_of.model.ranges_mm[1:]))
    with pytest.raises(DataError, match="exceeds the range") as caught:
        require_same_machine(
            ExportSource(source.table, TableEstimate(shorter, known_of.parameters, known_of.covariance))
        )
    assert caught.value.where["axis"] == "X"


def test_error_motions_need_the_estimate() -> None:
    assert "--estimate" in str(refused("isg-volcomp", alone(known(1).table)))


@pytest.mark.parametrize("name", ["linuxcnc-comp", *EVEN])
def test_a_reference_point_outside_the_table(name: str) -> None:
    error = refused(name, alone(thin()), reference_mm=(0.0, 1400.0, 0.0))
    assert error.where["axis"] == "Y"
    assert "--reference-mm" in error.hint


@pytest.mark.parametrize("name", ["fanuc-pitch", "fanuc-3d"])
def test_points_that_are_counted_from_the_reference_point_must_hit_it(name: str) -> None:
    error = refused(name, alone(thin()), reference_mm=(0.0, 0.0, 730.0))
    assert error.where["axis"] == "Z"
    assert "700 mm" in error.hint


@pytest.mark.parametrize("name", ["fanuc-pitch", "fanuc-3d"])
def test_intervals_are_whole_detection_units(name: str) -> None:
    error = refused(name, alone(resample_table(known(1).table, (13, 14, 16))))
    assert "not a multiple of the detection unit" in error.message


def test_the_smallest_magnification_that_fits_is_chosen_and_a_smaller_one_refused() -> None:
    estimate = known(1).estimate
    assert estimate is not None
    steep = source_of(estimate.model, 12.0 * estimate.parameters)
    found = FORMATS["fanuc-pitch"].export(alone(steep.table), ExportOptions()).facts["magnification"]
    assert isinstance(found, int)
    assert found > 1
    error = refused("fanuc-pitch", alone(steep.table), magnification=found - 1)
    assert "exceeds ±7" in error.message
    FORMATS["fanuc-pitch"].export(alone(steep.table), ExportOptions({"magnification": found + 1}))


def test_no_magnification_fits() -> None:
    error = refused("fanuc-pitch", alone(known(1).table), detection_unit_um=1e-3)
    assert "at magnification 100" in error.message


def test_a_table_that_corrects_nothing_has_no_cross_tables() -> None:
    nothing = replace(thin(), corrections=np.zeros((21, 14, 16, 3)))
    assert "nothing to compensate" in str(refused("siemens-cec", alone(nothing)))
    assert "--tables" in str(refused("siemens-cec", alone(thin()), tables=0))


@pytest.mark.parametrize("points", [(1, 14, 16), (0, 2, 2), (5, -1, 3)])
def test_a_grid_has_two_points_at_least(points: tuple[int, int, int]) -> None:
    with pytest.raises(DataError, match="not a grid"):
        resample_table(known(1).table, points)


def test_resampling_reads_the_table_as_a_controller_does_and_passes_on_what_is_extrapolated() -> None:
    table = known(1).table
    marks = np.zeros(table.extrapolated.shape, dtype=bool)
    marks[-1] = True
    coarse = resample_table(replace(table, extrapolated=marks), (9, 5, 5))
    points = np.stack(np.meshgrid(*coarse.nodes, indexing="ij"), axis=-1).reshape(-1, 3)
    assert coarse.corrections.reshape(-1, 3) == pytest.approx(table.at(points), abs=1e-15)
    assert coarse.extrapolated[-1].all()
    assert not coarse.extrapolated[:-1].any()


def test_axes_are_called_as_the_controller_calls_them() -> None:
    source = alone(thin())
    lec = FORMATS["siemens-lec"].export(source, ExportOptions({"axes": ("AX1", "AX2", "AX4"), "encoder": 1}))
    assert sorted(lec.files) == ["AX1_EEC.INI", "AX2_EEC.INI", "AX4_EEC.INI"]
    assert "$AA_ENC_COMP_MAX[1,AX4]=1500.0" in lec.files["AX4_EEC.INI"]
    cec = FORMATS["siemens-cec"].export(source, ExportOptions({"axes": ("AX1", "AX2", "AX4")})).files["NC_CEC.INI"]
    assert "=(AX4)" in cec
    assert "=(Z1)" not in cec
