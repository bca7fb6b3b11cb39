"""Coverage study with few machines: the bounds are wide, but ignoring the misfit would violate them."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from study_case import study_case

from agent.studies.coverage import COLUMNS, ORDER_BY_EVIDENCE, ORDER_OF_FILE, REGIONS, run
from agent.studies.coverage_figure import LEVELS, Panel, draw
from agent.studies.study import StudyResult
from agent.studies.study_files import write_result
from agent.studies.workers import LocalWorkers
from twin.identification import Options
from twin.uncertainty.coverage import ObservedCoverage
from twin.uncertainty.random_machines import AS_MODELLED, DEFLECTION_FORMS

MACHINES = 20
case = partial(study_case, None, seed=11)


@cache
def found() -> StudyResult:
    return run(case(machines=MACHINES))


def summary(way: str) -> dict[str, float]:
    section = found().summary[way]
    assert isinstance(section, dict)
    return section


@pytest.mark.parametrize("way", [ORDER_OF_FILE, ORDER_BY_EVIDENCE])
def test_regions_hold_the_truth_of_richer_machines(way: str) -> None:
    said = summary(way)
    assert 0.92 < said["field at points"] < 0.98
    for region in REGIONS[1:]:
        assert said[region] >= 0.83


@pytest.mark.parametrize("way", [ORDER_OF_FILE, ORDER_BY_EVIDENCE])
def test_they_are_no_wider_than_need_be(way: str) -> None:
    ratios = summary(way)["predicted_over_true_vce"]
    assert isinstance(ratios, dict)
    assert 0.85 < ratios["of_root_mean_squares"] < 1.2
    assert ratios["mean_departure_from_1"] < 0.25


def test_parameters_of_machines_as_modelled_are_held() -> None:
    checked = found().summary["as_modelled"]
    assert isinstance(checked, dict)
    assert 0.91 < checked["parameters"][0] < 0.99


def test_without_the_misfit_the_truth_gets_lost() -> None:
    """Check that the test can fail: without the modelled misfit the regions do not hold."""
    said = run(case(machines=12, options=Options(misfit_mm=0.0))).summary[ORDER_OF_FILE]
    assert isinstance(said, dict)
    assert said["field jointly"] < 0.7
    assert said["predicted_over_true_vce"]["of_root_mean_squares"] < 0.93


def test_the_files_hold_every_machine_and_form(tmp_path: Path) -> None:
    paths = write_result(found(), tmp_path)
    with paths["csv"].open() as text:
        rows = list(csv.DictReader(text))
    assert list(rows[0]) == list(COLUMNS)
    assert {row["form"] for row in rows} == {*DEFLECTION_FORMS, AS_MODELLED}
    assert sum(row["estimate"] == ORDER_BY_EVIDENCE for row in rows) == MACHINES
    said = json.loads(paths["json"].read_text())
    assert set(said[ORDER_OF_FILE]["by_form"]) == set(DEFLECTION_FORMS)
    assert paths["png"].stat().st_size > 10000


def test_a_machine_is_the_same_whoever_works_on_it() -> None:
    fewer = run(replace(case(machines=2), workers=LocalWorkers(1)))
    common = [row for row in found().rows if row[0] in range(2)]
    assert [row[:6] for row in fewer.rows if row[0] in range(2)] == [row[:6] for row in common]
    assert np.isfinite(np.array([row[4] for row in fewer.rows], dtype=float)).all()


def test_a_coverage_far_below_the_band_is_in_the_figure() -> None:
    curve = {"field": np.linspace(0.0, 1.0, len(LEVELS))}
    for observed, lowest in ((0.94, 70.0), (0.41, 40.0)):
        shares = {"field": [ObservedCoverage(observed, 0.01), ObservedCoverage(0.95, 0.01)]}
        figure = Figure()
        draw(figure, [Panel("file order", ("rails", "all"), shares, curve)])
        assert figure.axes[0].get_ylim() == pytest.approx((lowest, 101.0))
