"""The page on the design of an artefact states what the stored tables say, and these are what the program computes."""

from __future__ import annotations

import csv
import math
import re
from functools import cache
from pathlib import Path

import pytest

from agent.planning.case_file import CASE_STUDY, load_case
from agent.planning.design.artefact_costs import SHIPPED_COSTS, load_costs
from agent.planning.design.artefact_screening import Screening
from agent.planning.design.artefact_variants import ArtefactVariant, PresentEquipment, parse_centre
from agent.runs.kinds.calibrate import calibration_of
from twin.artefact.ball_spacing import BallSpacing

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "explanation" / "design-of-an-artefact.md").read_text(encoding="utf-8")
PROPERTIES = {
    "balls": "balls",
    "length / mm": "length_mm",
    "stations": "stations",
    "rotation centre": "rotation_centre",
    "height / mm": "height_mm",
    "across / mm": "across_mm",
    "spacing": "spacing",
    "tilt / °": "tilt_deg",
}
COMMAND = "volcal design artefact --case case-study --slot 30min --budget 10000"


def stored(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader((DOCS / "data" / "studies" / f"{name}.csv").read_text(encoding="utf-8").splitlines()))


def rows_below(heading: str) -> list[list[str]]:
    """Return the cells of the first table below a heading, without its head."""
    lines = PAGE.split(f"## {heading}\n", 1)[1].split("\n## ", 1)[0].splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")][2:]


@cache
def screening() -> Screening:
    costs = load_costs(SHIPPED_COSTS)
    present = PresentEquipment(load_case(CASE_STUDY), CASE_STUDY.parent, costs.calibration)
    return Screening(present, costs, 30.0, 30.0, calibration_of)


def variant_of(row: dict[str, str]) -> ArtefactVariant:
    return ArtefactVariant(
        length_mm=float(row["length_mm"]),
        balls=int(row["balls"]),
        spacing=BallSpacing(row["spacing"]),
        tilt_deg=float(row["tilt_deg"]),
        centre=parse_centre(row["rotation_centre"]),
        across_mm=float(row["across_mm"]),
        height_mm=float(row["height_mm"]),
        stations=int(row["stations"]),
    )


def test_each_effect_is_that_of_the_stored_variants() -> None:
    measured = [row for row in stored("artefact-variants") if row["expected_vce_aligned_um"]]
    shown = rows_below("What each property is worth")
    assert {cells[0] for cells in shown} == set(PROPERTIES)
    [proposed] = [row for row in stored("artefact-designs") if row["best"] == "yes"]
    screened = {tuple(row[key] for key in PROPERTIES.values()): row["expected_vce_aligned_um"] for row in measured}
    own = float(screened[tuple(proposed[key] for key in PROPERTIES.values())])
    for name, before, after, single, mean, pairs in shown:
        column = PROPERTIES[name]
        others = [key for key in PROPERTIES.values() if key != column]
        errors = {
            tuple(row[key] for key in [*others, column]): float(row["expected_vce_aligned_um"]) for row in measured
        }
        ratios = [
            errors[(*key[:-1], after)] / error
            for key, error in errors.items()
            if key[-1] == before and (*key[:-1], after) in errors
        ]
        assert int(pairs) == len(ratios), (name, before, after)
        percent = 100.0 * (math.prod(ratios) ** (1.0 / len(ratios)) - 1.0)
        changed = {**proposed, column: after}
        one = float(screened[tuple(changed[key] for key in PROPERTIES.values())])
        assert float(single.removesuffix(" %")) == pytest.approx(100.0 * (one / own - 1.0), abs=0.0501), (name, after)
        assert float(mean.removesuffix(" %")) == pytest.approx(percent, abs=0.0501), (name, before, after)


def test_the_complete_designs_are_the_stored_ones() -> None:
    designs = stored("artefact-designs")
    shown = rows_below("Complete designs")
    for cells in shown:
        columns = ("length_mm", "balls", "spacing", "tilt_deg", "rotation_centre", "stations")
        [row] = [row for row in designs if [row[column] for column in columns] == cells[:6]]
        assert cells[6] == row["positions"]
        vce, purchase, run = (float(cell) for cell in cells[7:10])
        assert vce == pytest.approx(float(row["expected_vce_aligned_um"]), abs=0.0051)
        assert purchase == pytest.approx(float(row["purchase_euro"]))
        assert run == pytest.approx(float(row["run_euro"]), abs=0.0501)
    assert len(shown) >= 6


@pytest.mark.parametrize("name", ["artefact-variants", "artefact-designs"])
def test_the_stored_prices_are_those_of_the_shipped_costs(name: str) -> None:
    rows = stored(name)
    assert rows
    for row in rows:
        assert float(row["purchase_euro"]) == pytest.approx(screening().purchase_euro(variant_of(row)), abs=0.0051)


def test_stored_errors_are_those_of_the_program() -> None:
    """A search may end in another set of nearly the same worth on a processor that rounds differently."""
    rows = stored("artefact-variants")
    by_error = sorted(rows, key=lambda row: float(row["expected_vce_aligned_um"] or "inf"))
    for row in (rows[0], by_error[0], by_error[len(rows) // 2]):
        found = screening().result(variant_of(row))
        assert found.vce_um == pytest.approx(float(row["expected_vce_aligned_um"]), rel=0.02), f"run `{COMMAND}` again"
        assert found.minutes == pytest.approx(float(row["machine_minutes"]), abs=1.0)


def test_the_stated_numbers_of_variants_are_those_of_the_table() -> None:
    said = re.search(r"screened (\d+) variants", PAGE)
    assert said is not None
    assert int(said[1]) == len(stored("artefact-variants"))
