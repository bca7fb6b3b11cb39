"""The exported files improve the machine; with the opposite sign they make it worse.

The true machine is richer than its estimate, and the controllers' rules come from their documents
(controller_rules.py), not from the writers.
"""

from __future__ import annotations

import numpy as np
import pytest
from controller_rules import RULES, rule_at
from estimated_machine import GRID, known, left_of_estimate_um, left_um, moving_table, truth

from twin.compensation.controllers.export_format import ControllerExport, ExportSource
from twin.compensation.controllers.format_options import ExportOptions
from twin.compensation.controllers.grids import resample_table
from twin.compensation.controllers.loss import largest_correction
from twin.compensation.controllers.registry import FORMATS

SEEDS = (1, 2, 3)
THINNED = {"fanuc-3d": (21, 14, 16)}
OWN_AXIS_ONLY = ("linuxcnc-comp", "siemens-lec", "fanuc-pitch")
LINEAR_ONLY = ("linuxcnc-matrixkins", "klipper-skew")
REMOVED = {**dict.fromkeys((*OWN_AXIS_ONLY, *LINEAR_ONLY), 0.0), "heidenhain-com": 0.3}
"""Least share of the true VE that a format must remove; formats not listed must remove at least half."""


def exported(name: str, source: ExportSource, *, opposite_sign: bool = False, **choices: object) -> ControllerExport:
    table = resample_table(source.table, THINNED[name]) if name in THINNED else source.table
    return FORMATS[name].export(ExportSource(table, source.estimate), ExportOptions(choices, opposite_sign))


def test_every_format_has_a_rule() -> None:
    assert set(RULES) == set(FORMATS)


@pytest.mark.parametrize("name", RULES)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_true_machine_gets_better_and_worse_with_the_other_sign(name: str, seed: int) -> None:
    machine, source = truth(seed), known(seed)
    before = left_um(machine, np.zeros_like(GRID))
    as_documented = left_um(machine, RULES[name](exported(name, source).files)(GRID))
    turned_round = left_um(machine, RULES[name](exported(name, source, opposite_sign=True).files)(GRID))
    assert as_documented < (1.0 - REMOVED.get(name, 0.5)) * before
    assert turned_round > before


@pytest.mark.parametrize("name", sorted(set(RULES) - {"fanuc-pitch"}))
def test_a_controller_adds_what_is_said_that_it_adds(name: str) -> None:
    one = exported(name, known(1))
    assert np.abs(RULES[name](one.files)(GRID) - one.correction(GRID)).max() < 5e-6


def test_pitch_errors_are_put_out_in_steps_around_what_is_said() -> None:
    one = exported("fanuc-pitch", known(1))
    found, said = RULES["fanuc-pitch"](one.files), one.correction
    nodes = np.array([[x, 100.0 * (x % 13), 100.0 * (x % 15)] for x in range(41)], dtype=float) * [100.0, 1.0, 1.0]
    assert np.abs(found(nodes) - said(nodes)).max() < 1e-12
    assert np.abs(found(GRID) - said(GRID)).max() <= 3.5e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_tables_of_a_workpiece_that_moves_have_the_right_sign_too(seed: int) -> None:
    source = moving_table(seed)
    rule = RULES["isg-volcomp"](exported("isg-volcomp", source).files)
    before = left_of_estimate_um(source, np.zeros_like(GRID))
    assert left_of_estimate_um(source, rule(GRID)) < 0.05 * before


@pytest.mark.parametrize("name", [*OWN_AXIS_ONLY, "siemens-cec", "heidenhain-com", "fanuc-3d"])
def test_nothing_is_added_at_the_reference_point(name: str) -> None:
    reference = (1000.0, 600.0, 500.0)
    one = exported(name, known(2), reference_mm=reference)
    rule = rule_at(name, one.files, reference)
    assert np.abs(rule(np.array([reference]))).max() < 1e-6
    machine = truth(2)
    assert left_um(machine, rule(GRID)) < left_um(machine, np.zeros_like(GRID))


def test_a_controller_counts_its_tables_from_where_it_is_told() -> None:
    one = exported("siemens-cec", known(1), first_table=10, tables=12)
    assert "$AN_CEC_MIN[10]" in one.files["NC_CEC.INI"]
    assert "$AN_CEC_MIN[9]" not in one.files["NC_CEC.INI"]
    assert np.abs(RULES["siemens-cec"](one.files)(GRID) - one.correction(GRID)).max() < 5e-6


def test_the_second_bank_of_a_heidenhain_control_is_the_active_line() -> None:
    one = exported("heidenhain-com", known(1), cma_bank="B")
    assert sorted(one.files) == ["CONFIG.CMA", "VOLCALB_X.COM", "VOLCALB_Y.COM", "VOLCALB_Z.COM"]
    assert np.abs(RULES["heidenhain-com"](one.files)(GRID) - one.correction(GRID)).max() < 5e-6


@pytest.mark.parametrize("name", RULES)
def test_where_the_sign_is_to_be_checked_the_controller_moves_as_said_and_farthest(name: str) -> None:
    one = exported(name, known(3))
    place, moves = largest_correction(known(3).table, one.correction)
    assert RULES[name](one.files)(place[None, :])[0] == pytest.approx(moves, abs=5e-6)
    assert np.linalg.norm(one.correction(GRID), axis=1).max() <= np.linalg.norm(moves) + 1e-4
