"""Uncertainty study: its table adds up, its simulations agree, and its files are complete."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_case import study_case

from agent.studies.study import StudyResult
from agent.studies.study_files import write_result
from agent.studies.uncertainty import COLUMNS, TOGETHER, extended_family, isolated_influences, run, study_assumptions
from twin.uncertainty.error_budget import INFLUENCES

MACHINES = 40
case = partial(study_case, seed=4, machines=MACHINES)


@cache
def found() -> StudyResult:
    return run(case())


def table() -> dict[str, dict[str, Any]]:
    """Return the columns of every influence; numbers, None if there is no such figure."""
    rows: list[dict[str, Any]] = [dict(zip(COLUMNS, row, strict=True)) for row in found().rows]
    return {str(row.pop("influence")): row for row in rows}


def test_the_table_names_every_influence_and_the_whole() -> None:
    assert list(table()) == [*INFLUENCES, TOGETHER]
    assert table()["mount"]["aligned_um"] == 0.0
    assert table()["mount"]["simulated_aligned_um"] is None


@pytest.mark.parametrize("kind", ["raw_um", "aligned_um"])
def test_squares_of_the_contributions_add_up(kind: str) -> None:
    parts = [table()[name][kind] for name in INFLUENCES]
    assert math.hypot(*parts) == pytest.approx(table()[TOGETHER][kind])
    assert sum(table()[name]["share_of_aligned_square_percent"] for name in INFLUENCES) == pytest.approx(100.0)


@pytest.mark.parametrize("name", [name for name in (*INFLUENCES, TOGETHER) if name != "mount"])
def test_each_simulation_agrees_with_its_closed_form(name: str) -> None:
    """The square of a single influence with one unknown is skewed, so the spread of forty samples is poorly known."""
    row = table()[name]
    for kind in ("raw_um", "aligned_um"):
        off = row[f"simulated_{kind}"] - row[kind]
        assert abs(off) < 4.0 * row[f"standard_error_{kind}"] + 0.005 * row[kind]


def test_nothing_is_simulated_twice_and_nothing_is_left_out() -> None:
    one = case()
    whole = study_assumptions(one)
    alone = [
        assumptions for assumptions in isolated_influences(whole, one.machine.model).values() if assumptions is not None
    ]
    assert len(alone) == len(INFLUENCES) - 1
    variances = np.sum([assumptions.family.half_widths for assumptions in alone], axis=0)
    assert variances == pytest.approx(whole.family.half_widths)
    assert sum(assumptions.deflection is not None for assumptions in alone) == 1
    for switch in ("touch_noise", "certificate", "cte"):
        assert sum(getattr(assumptions, switch) for assumptions in alone) == 1
    assert sum(assumptions.drift_mm for assumptions in alone) == whole.drift_mm
    assert sum(assumptions.thermometer_uncertainty_k for assumptions in alone) == whole.thermometer_uncertainty_k


def test_the_true_machines_are_the_family_with_higher_orders_beside() -> None:
    machine = case().machine
    family = extended_family(machine)
    widths = dict(zip(family.model.names, family.half_widths, strict=True))
    own = dict(zip(machine.model.names, machine.family.half_widths, strict=True))
    assert {name: widths[name] for name in own} == pytest.approx(own)
    assert family.model.size == machine.model.size + 18 * 2
    assert 0.0 < widths["EXX[7]"] < widths["EXX[6]"] < widths["EXX[5]"]


def test_the_limits_hold_the_machines() -> None:
    summary: Mapping[str, Any] = found().summary
    low, high = summary["vce_95_percent_limits_aligned_um"]
    assert low < summary["vce_median_aligned_um"] < summary["vce_expected_aligned_um"] < high
    assert summary["simulated_inside_the_limits_percent"] >= 85.0


def test_its_files_are_complete(tmp_path: Path) -> None:
    files = write_result(found(), tmp_path)
    rows = list(csv.DictReader(files["csv"].read_text(encoding="utf-8").splitlines()))
    assert [row["influence"] for row in rows] == [*INFLUENCES, TOGETHER]
    assert json.loads(files["json"].read_text(encoding="utf-8"))["contributions_aligned_um"]["mount"] == 0.0
    assert files["png"].read_bytes().startswith(b"\x89PNG")
    assert "Contributions" in files["svg"].read_text(encoding="utf-8")


def test_the_same_seed_gives_the_same_numbers() -> None:
    assert run(case(machines=3)).rows == run(case(machines=3)).rows
