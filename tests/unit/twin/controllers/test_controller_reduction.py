"""The retained part of a table is the best that the format allows, and the lost part is the stated one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from controller_rules import siemens_cec
from estimated_machine import RANGES, TOOL, known, left_of_estimate_um, machine_with
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.compensation.controllers.export_format import ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.loss import compensation_loss
from twin.compensation.controllers.reduction import (
    cross_axis_profiles,
    own_axis_profiles,
    select_terms,
    sum_of_cross_axis_profiles,
    sum_of_terms,
)
from twin.compensation.controllers.registry import FORMATS
from twin.compensation.table import CompensationTable
from twin.machine.anchor import Anchor
from twin.machine.volumetric import evaluation_grid, volumetric_error

ORIGIN = np.zeros(3)


def table_of(corrections: np.ndarray) -> CompensationTable:
    shape = corrections.shape[:3]
    x, y, z = (np.linspace(0.0, 100.0 * (n - 1), n) for n in shape)
    return CompensationTable(x, y, z, corrections, ORIGIN, Anchor(ORIGIN), np.zeros(shape, dtype=bool))


def points_of(table: CompensationTable) -> np.ndarray:
    return np.stack(np.meshgrid(*table.nodes, indexing="ij"), axis=-1).reshape(-1, 3)


def random_table(seed: int, shape: tuple[int, int, int] = (5, 4, 3)) -> CompensationTable:
    return table_of(1e-3 * np.random.default_rng(seed).standard_normal((*shape, 3)))


def kept(name: str, source: ExportSource, **choices: object) -> float:
    return compensation_loss(source, FORMATS[name].export(source, ExportOptions(choices)).correction).retained_share


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_functions_of_one_axis_are_the_least_squares_fit(seed: int) -> None:
    """Compare with a plain fit with one unknown for each node of each axis."""
    table = random_table(seed)
    points = points_of(table)
    columns = np.concatenate([points[:, [axis]] == table.nodes[axis] for axis in range(3)], axis=1).astype(float)
    for output in range(3):
        wanted = table.corrections[..., output].reshape(-1)
        fitted = columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
        found = sum_of_cross_axis_profiles(cross_axis_profiles(table, ORIGIN), points)[:, output]
        assert found - found.mean() == pytest.approx(fitted - fitted.mean(), abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10**6))
def test_all_terms_together_are_the_table_but_for_what_depends_on_three_axes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy, yz, xz = (rng.standard_normal(shape) for shape in ((5, 4, 1, 3), (1, 4, 3, 3), (5, 1, 3, 3)))
    table = table_of(1e-3 * (xy + yz + xz))
    reference = points_of(table)[0]
    found = sum_of_terms(select_terms(table, 1000, reference, tables_per_product=2), points_of(table))
    wanted = table.corrections.reshape(-1, 3)
    assert found == pytest.approx(wanted - wanted[0], abs=2e-4)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 20))
def test_no_more_tables_are_used_than_there_are_and_more_never_leave_more(seed: int, most: int) -> None:
    table = random_table(seed)
    points, wanted = points_of(table), table.corrections.reshape(-1, 3)

    def left(count: int) -> float:
        one = select_terms(table, count, ORIGIN, tables_per_product=2)
        assert sum(1 if term.factor is None else 2 for term in one) <= count
        rest = wanted - sum_of_terms(one, points)
        return float(np.var(rest, axis=0).sum())

    assert left(most + 4) <= left(most) + 1e-18


def test_a_product_is_at_most_its_first_factor() -> None:
    for term in select_terms(random_table(3), 1000, ORIGIN, tables_per_product=2):
        if term.factor is not None:
            assert np.abs(term.factor.values).max() == pytest.approx(1.0)


def test_no_other_functions_of_one_axis_leave_less_after_a_rigid_alignment() -> None:
    """Check that small changes anywhere only increase the residual, on the nodes themselves as weighted by the fit."""
    table = known(1).table
    points, wanted = points_of(table), table.corrections.reshape(-1, 3)
    profiles = own_axis_profiles(table, ORIGIN)

    def left(bumped: int, place: int, by: float) -> float:
        added = np.zeros_like(points)
        for axis, one in enumerate(profiles):
            values = one.values.copy()
            if axis == bumped:
                values[place] += by
            added[:, axis] = replace(one, values=values).at(points)
        return volumetric_error(points + TOOL, wanted - added).aligned_mm

    best = left(0, 0, 0.0)
    assert all(left(axis, place, by) > best for axis in range(3) for place in (0, 5, 13) for by in (1e-4, -1e-4))


@pytest.mark.parametrize("name", ["linuxcnc-comp", "siemens-lec", "fanuc-pitch"])
def test_positioning_alone_is_kept_whole_by_a_form_of_one_axis(name: str) -> None:
    assert kept(name, machine_with(EXX_1=6e-3, EYY_2=4e-3, EZZ_1=-5e-3)) > (0.9 if name == "fanuc-pitch" else 0.98)
    assert kept(name, machine_with(EYX_2=6e-3, A0Z=9e-6)) == pytest.approx(0.0, abs=0.01)


def test_straightness_and_squareness_are_kept_by_cross_tables_and_rotation_is_not() -> None:
    source = machine_with(EXX_1=6e-3, EYX_2=6e-3, EZY_3=-3e-3, A0Z=9e-6, B0Z=-5e-6, C0Y=7e-6)
    assert kept("heidenhain-com", source) > 0.98
    turning = machine_with(EBX_2=5e-6, ECY_2=5e-6)
    assert kept("heidenhain-com", turning) < 0.6
    assert kept("siemens-cec", turning) > 0.97


def test_the_cross_effect_is_carried_by_multiplied_tables_and_by_a_second_argument() -> None:
    """Check y z² of column and ram: one product is enough; without products most of it is lost."""
    source = machine_with(CROSS_b1=-12e-3, CROSS_b2=12e-3)
    assert kept("siemens-cec", source, tables=6) > 0.97
    assert kept("heidenhain-com", source) < 0.8
    assert kept("isg-volcomp", source) > 0.999
    rows = FORMATS["isg-volcomp"].export(source, ExportOptions()).files["volcomp.csv"].split("\n#\n")[-1].splitlines()
    assert rows[1] == "Y Z EYZ EAZ"
    assert len(rows) == 2 + 14 * 16


def test_a_product_is_the_same_whether_it_replaces_the_value_of_its_table_or_is_added() -> None:
    """The manual of CEC says that the product is added; an example in another one works only if it replaces."""
    one = FORMATS["siemens-cec"].export(known(1), ExportOptions())
    assert "$AN_CEC_MULT_BY_TABLE[" in one.files["NC_CEC.INI"]
    points = evaluation_grid(RANGES, (7, 5, 6))
    for replaces in (False, True):
        found = siemens_cec(one.files, product_replaces=replaces)(points)
        assert np.abs(found - one.correction(points)).max() < 1e-9
    pairs = [line for line in one.files["NC_CEC.INI"].splitlines() if "MULT_BY" in line and not line.endswith("=0")]
    assert len(pairs) % 2 == 0 < len(pairs)


def test_ve_is_that_of_the_estimated_machine_whatever_the_table_can_say() -> None:
    source = known(1)
    one = FORMATS["heidenhain-com"].export(source, ExportOptions())
    found = compensation_loss(source, one.correction)
    grid = evaluation_grid(RANGES, (60, 20, 20))
    for value, added in (
        (found.before, np.zeros_like(grid)),
        (found.full, source.table.at(grid)),
        (found.reduced, one.correction(grid)),
    ):
        assert value.aligned_um == pytest.approx(left_of_estimate_um(source, added, grid), rel=1e-9)
    assert found.full.aligned_um < found.reduced.aligned_um < found.before.aligned_um
    assert found.unknown_mm is not None
    assert found.unknown_mm > 0.0


def test_without_an_estimate_the_table_is_the_machine() -> None:
    whole = known(1)
    alone = ExportSource(whole.table)
    correction = FORMATS["heidenhain-com"].export(alone, ExportOptions()).correction
    found, by_estimate = compensation_loss(alone, correction), compensation_loss(whole, correction)
    assert not found.estimated
    assert found.unknown_mm is None
    assert found.full.aligned_um == pytest.approx(0.0, abs=1e-3)
    assert found.before.aligned_um == pytest.approx(by_estimate.before.aligned_um, rel=0.02)
    assert found.reduced.aligned_um == pytest.approx(by_estimate.reduced.aligned_um, rel=0.05)


def test_fewer_tables_keep_less() -> None:
    shares = [kept("siemens-cec", known(1), tables=count) for count in (2, 5, 9, 15, 62)]
    assert shares == sorted(shares)
    assert shares[0] < 0.7
    assert shares[-1] > 0.97


def test_without_products_cross_tables_are_what_a_heidenhain_control_has() -> None:
    """Compare up to its steps of 0.1 µm and terms not worth a table."""
    source = known(1)
    one = FORMATS["siemens-cec"].export(source, ExportOptions({"no_products": True}))
    assert "MULT_BY_TABLE[0]=0" in one.files["NC_CEC.INI"]
    tables = one.facts["tables"]
    assert isinstance(tables, int)
    assert tables <= 9
    assert kept("siemens-cec", source, no_products=True) == pytest.approx(kept("heidenhain-com", source), abs=0.01)
