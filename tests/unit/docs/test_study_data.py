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
from agent.studies import ball_count, design, misalignment, strategy
from agent.studies.identification_variants import identification_variants
from agent.studies.measure import MEASURES
from agent.studies.procedure_value import ProcedureEvaluator, ProcedureVariant
from agent.studies.published import claims
from agent.studies.published.claims import ClaimFinding
from agent.studies.published.procedures import KEYS, ProcedureKey, StudiedMachine
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
    in_work_frame_um = 1e3 * evaluator().work_frame.expected_mm(budget)
    found = (trial.planned.size, budget.expected.raw_um, in_work_frame_um, budget.expected.aligned_um)
    stored = (int(row["ball_centres"]), *(float(row[f"vce_{measure.key}_um"]) for measure in MEASURES))
    command = f"volcal study {name} --case case-study"
    assert stored == pytest.approx(found, rel=CLOSE), f"run `{command}` again and correct its page: {row}"


def test_times_and_errors_of_the_sets_are_those_of_the_program() -> None:
    rows = [row for row in table("strategy") if int(row["stations"]) == len(case().stations)]
    assert {(row["sets"], row["identification"]) for row in rows} == {
        (name, variant.label) for name in SET_EXPRESSIONS for variant in VARIANTS
    }
    minutes = {name: machine_minutes(case().job, case().positions(name)).total for name in ("S1", "S2", "S3")}
    for row in rows:
        alone, carried = float(row["machine_minutes_without_carrying"]), float(row["machine_minutes"])
        assert alone == pytest.approx(minutes.get(row["sets"], alone))
        assert carried - alone == pytest.approx(len(case().stations) * case().relocation_minutes)
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


def test_the_errors_by_frame_are_those_of_the_program() -> None:
    page, columns = section("published-studies.md", "The paper's own measure"), {"S2": 2, "S3": 4}
    words = {
        "raw": "as defined",
        "work_offset": "work offset alone",
        "work_frame": "work frame",
        "known_places": "known places of the mount",
        "aligned": "rigidly aligned",
    }
    for label, variant in (("centres", VARIANTS[0]), ("published", VARIANTS[1])):
        for name, column in columns.items():
            trial = ProcedureVariant.of(case(), case().artefact, case().positions(name))
            found = strategy.errors_by_frame(evaluator(), trial, variant)
            assert found is not None
            for key, value in found.items():
                assert page[f"{label}, {words[key]}"][column][0] == pytest.approx(value, abs=0.0501), (label, name, key)


def test_the_claims_of_the_page_are_those_of_the_stored_data_and_of_the_program() -> None:
    text = (DOCS / "explanation" / "published-studies.md").read_text().split("## The claims, one by one\n")[1]
    shown = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines() if line[:2] == "| "]
    verdicts = {cells[0]: cells[-7:] for cells in shown}
    assert set(claims.TEXTS) <= set(verdicts)
    for name in claims.TEXTS:
        rows = [row for row in table("claims") if row["claim"] == name]
        found = [
            ClaimFinding(row["machine_name"], row["reading"], row["measure"], None, row["holds"] == "yes")
            for row in rows
        ]
        assert verdicts[name] == [*claims.verdicts_by_place(found).values(), claims.verdict(found)], name
    made = StudiedMachine.of(case())
    tilts = [KEYS.index(ProcedureKey("S2", tilt_deg=tilt)) for tilt in (0.0, 30.0)]
    for number, reading in enumerate(("published", "volcal")):
        straight, tilted = (made.compensated(number, procedure, 1) for procedure in tilts)
        assert straight is not None and tilted is not None
        for row in table("claims"):
            if (row["claim"], row["machine_name"], row["reading"]) == ("tilt S2", "case-study", reading):
                saved = 1.0 - tilted.expected_um[row["measure"]] / straight.expected_um[row["measure"]]
                assert float(row["value"]) == pytest.approx(saved, rel=CLOSE)


def test_the_tables_of_the_page_are_the_stored_data() -> None:
    page = "published-studies.md"
    sets, order = section(page, "Combinations of sets"), ("S1", "S2", "S1+S2", "S3", "S1+S3", "S2+S3", "S1+S2+S3")
    stations = str(len(case().stations))
    everywhere = [row for row in table("strategy") if row["stations"] == stations]
    for label, column in (
        ("machine minutes", "machine_minutes"),
        ("without carrying", "machine_minutes_without_carrying"),
    ):
        minutes = {row["sets"]: float(row[column]) for row in everywhere}
        assert [cell[0] for cell in sets[label]] == [round(minutes[name], 1) for name in order]
    balls = section(page, "Number of balls")
    for variant in VARIANTS:
        digits = 0 if variant.label == "distances, unit weights, no prior" else 2
        stored = {row["sets"]: row for row in everywhere if row["identification"] == variant.label}
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
