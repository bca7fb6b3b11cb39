"""Data and pages of the studies against the program: cycle times and closed forms are computed again and compared with
the stored tables, and the tables of the pages with both."""

from __future__ import annotations

import csv
import re
from functools import cache
from pathlib import Path

import pytest

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.cycle_time import machine_minutes
from agent.planning.design.bar_variants import Bar
from agent.planning.design.variants import variants_of
from agent.runs.kinds.calibrate import preflight_of
from agent.studies import ball_count, design, misalignment
from agent.studies.identification_variants import identification_variants
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant
from agent.studies.study import StudyCase
from agent.studies.workers import LocalWorkers
from twin.artefact.artefact import Artefact
from twin.artefact.position_set import SET_EXPRESSIONS
from twin.identification import Options

DOCS = Path(__file__).parents[3] / "docs"
VARIANTS = identification_variants(Options())
CLOSE = 2e-4
"""Relative tolerance. Processors round differently, and unrestrained distances enlarge rounding."""


def table(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((DOCS / "data" / "studies" / f"{name}.csv").read_text().splitlines()))


@cache
def case() -> StudyCase:
    return StudyCase(load_case(CASE_STUDY), Options(), 1, 2, LocalWorkers(1), lambda *_: None, preflight_of)


@cache
def evaluator() -> ProcedureEvaluator:
    return ProcedureEvaluator(case())


def agree(name: str, row: dict[str, str], artefact: Artefact, expression: str) -> None:
    variant = next(one for one in VARIANTS if one.label == row["identification"])
    trial = ProcedureVariant.of(case(), artefact, case().positions(expression))
    budget = evaluator().budget(trial, variant)
    assert trial.planned is not None and budget is not None
    found = (trial.planned.size, budget.expected.raw_um, budget.expected.aligned_um)
    stored = (int(row["ball_centres"]), float(row["vce_raw_um"]), float(row["vce_aligned_um"]))
    command = f"volcal study {name} --case case-study"
    assert stored == pytest.approx(found, rel=CLOSE), f"run `{command}` again and correct its page: {row}"


def test_times_and_errors_of_the_sets_are_those_of_the_program() -> None:
    rows = table("strategy")
    assert {(row["sets"], row["identification"]) for row in rows} == {
        (name, variant.label) for name in SET_EXPRESSIONS for variant in VARIANTS
    }
    minutes = {name: machine_minutes(case().job, case().positions(name)).total for name in ("S1", "S2", "S3")}
    for row in rows:
        assert float(row["machine_minutes"]) == pytest.approx(minutes.get(row["sets"], float(row["machine_minutes"])))
        agree("strategy", row, case().artefact, row["sets"])


def test_errors_over_balls_and_tilts_are_those_of_the_program() -> None:
    bar = Bar.of(case().artefact)
    for row in table("ball-count"):
        if int(row["balls"]) in ball_count.CHECKED:
            agree("ball-count", row, bar.with_(balls=int(row["balls"])), "S3")
    for row in table("misalignment"):
        if float(row["tilt_deg"]) in misalignment.CHECKED_DEG:
            agree("misalignment", row, bar.with_(tilt_deg=float(row["tilt_deg"])), row["set"])


def test_named_sets_of_the_design_are_those_of_the_program() -> None:
    rows = {row["set"]: row for row in table("design") if row["kind"] == "named"}
    base, sets = variants_of(case().job, Path())[0], design.SetEvaluator(evaluator().field)
    assert set(rows) == set(design.SETS)
    for name in ("S2", design.REFERENCE):
        found = sets.evaluate_named(base, name, case().positions(name))
        stored = [float(rows[name][column]) for column in design.COLUMNS[5:]]
        fields = (found.positions, found.balls, found.minutes, found.criterion_um, found.vce_um)
        assert stored == pytest.approx([*fields, found.published_um, found.distances_um, found.valuation], rel=CLOSE)


def section(page: str, heading: str) -> dict[str, list[list[float]]]:
    """Return first cell → numbers of the further cells for the first table below a heading."""
    text = (DOCS / "explanation" / page).read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    numbers = re.compile(r"\d+(?:\.\d+)?")
    return {first.strip(): [[float(n) for n in numbers.findall(cell)] for cell in cells] for first, *cells in rows}


def test_the_tables_of_the_page_are_the_stored_data() -> None:
    page = "published-studies.md"
    sets, order = section(page, "Combinations of sets"), ("S1", "S2", "S1+S2", "S3", "S1+S3", "S2+S3", "S1+S2+S3")
    minutes = {row["sets"]: float(row["machine_minutes"]) for row in table("strategy")}
    assert [cell[0] for cell in sets["machine minutes"]] == [round(minutes[name], 1) for name in order]
    balls = section(page, "Number of balls")
    for variant in VARIANTS:
        digits = 0 if variant.label == "distances, unit weights, no prior" else 2
        stored = {row["sets"]: row for row in table("strategy") if row["identification"] == variant.label}
        wanted = [round(float(stored[name]["vce_aligned_um"]), digits) for name in order]
        assert [cell[0] for cell in sets[variant.label]] == wanted, variant.label
        counted = {row["balls"]: row for row in table("ball-count") if row["identification"] == variant.label}
        wanted = [round(float(counted[str(n)]["vce_aligned_um"]), digits) for n in ball_count.CHECKED]
        assert [cell[0] for cell in balls[variant.label][:4]] == wanted, variant.label


def test_the_tables_of_the_design_page_are_the_stored_data() -> None:
    page = section("design-of-positions.md", "Benefit")
    (reference,) = (row for row in table("design") if (row["set"], row["kind"]) == (design.REFERENCE, "named"))
    for label, column in {
        "S3, centres": "vce_um",
        "S3, distances, unit weights, with our prior": "distances_with_prior_vce_um",
        "S3, published method as read": "published_vce_um",
    }.items():
        wanted = [24, round(float(reference["machine_minutes"]), 1), round(float(reference[column]), 2)]
        assert [cell[0] for cell in page[label]] == wanted
    slots = [row for row in table("design") if row["kind"] == design.SLOT_KIND]
    shown = [[cell[0] for cell in cells] for label, cells in page.items() if label.startswith("designed for")]
    every = [[int(r["positions"]), round(float(r["machine_minutes"]), 1), round(float(r["vce_um"]), 2)] for r in slots]
    assert shown and all(row in every for row in shown)


def test_the_coverage_page_is_the_stored_data() -> None:
    text = (DOCS / "explanation" / "coverage.md").read_text()
    shown = [re.findall(r"\*\*(\d+\.\d)\*\*", line) for line in text.splitlines() if line.startswith("| **all** |")]
    for choice, cells in zip(("order of the file", "order by evidence"), shown, strict=True):
        rows = [row for row in table("coverage") if row["estimate"] == choice and row["form"] != "as modelled"]
        columns = ("field_at_points_share_held", "held_out_share_held", "field_jointly_level", "ve_level", "vce_level")
        points, held_out, jointly, ve, vce = ([float(row[column]) for row in rows] for column in columns)
        within = [100.0 * sum(level <= 0.95 for level in levels) / len(rows) for levels in (jointly, ve, vce)]
        found = [100.0 * sum(points) / len(rows), within[0], 100.0 * sum(held_out) / len(rows), *within[1:]]
        assert [float(cell) for cell in cells] == pytest.approx(found, abs=0.0501)
