"""The columns of every table stay in view on every screen, however long their words and however many rows there are."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from panel_pages import opened, with_token
from playwright.sync_api import Browser, Page, Route, ViewportSize, expect
from service_process import Service
from told_page import RUN, RUN_SUMMARY

from agent.results.run_verdict import VERDICTS

MEASURES = (Path(__file__).parent / "measures.js").read_text()
SCREENS = ((390, 844), (800, 480), (768, 1024), (1280, 800))
MACHINES, POSITIONS, NIGHTS = 50, 12, 6
OUT_OF_VIEW = """() => [...document.querySelectorAll("#content .scroll")]
  .filter(({ scrollWidth, clientWidth }) => scrollWidth > clientWidth + 1)
  .map((room) => `${room.firstChild.className}: ${room.scrollWidth} in ${room.clientWidth} px`)"""

RUNS = [
    {**RUN_SUMMARY, "run_id": f"{RUN}-{place}", "number": 1010 + place, "verdict": verdict.as_json(), "report": True}
    for place, verdict in enumerate(VERDICTS)
]
KEPT = [
    {"run_id": RUN, "at": "2026-11-28T01:00:00Z", "role": role, "bank": 1, "crc32": crc32, "shape": [9, 5, 4]}
    for role, crc32 in (("staged", "8d974c5b"), ("backup", None))
]
DIFFERENCE = {
    "same": False,
    "axes": [{"axis": axis, "largest_um": 12.34, "at_mm": [4000, 1300, 1500], "rms_um": 4.56} for axis in "XYZ"],
}
TREND = {
    "name": "EXX", "title": "EXX", "unit": "µrad", "runs": [f"{night:06d}" for night in range(NIGHTS)],
    "nights": [float(night) for night in range(NIGHTS)],
    "started": [f"2026-11-{20 + night}T02:00:00Z" for night in range(NIGHTS)],
    "values": [-21.24] * NIGHTS, "standard_uncertainties": [2.2] * NIGHTS, "tolerance": None, "drift_a_night": -0.00092,
    "drift_standard_uncertainty": 0.00035, "significant": True, "level": -21.2, "control_limits": None, "alarms": [],
    "steps": [{"night": float(night), "size": -1.5} for night in range(1, NIGHTS)], "nights_left": None,
    "nights_left_at_least": None, "volumetric": False, "two_sided": True, "fitted": None, "fitted_half_width": None,
}  # fmt: skip


def machine(place: int) -> dict[str, Any]:
    verdict = VERDICTS[place % len(VERDICTS)].as_json()
    return {
        "machine": f"mill-{place:03d}-hall-2", "run_id": RUN, "kind": "calibrate", "started": "2026-11-28T01:00:00Z",
        "days": 10.21, "verdict": verdict, "ve_um": 41.87, "vce_um": 27.76, "held_out_um": 13.59,
        "drift_um_a_night": -1.512, "drift_expanded_uncertainty": 0.048, "significant": True, "dated_ahead": [],
    }  # fmt: skip


def fulfil(answer: Any, route: Route) -> None:
    route.fulfill(json=answer)


def full_of_rows(page: Page) -> None:
    """Give the sections of the engineer as many rows, with words as long, as they can have."""
    plant = {"machine": "mill-001-hall-2", "machines": [machine(one) for one in range(MACHINES)], "total": MACHINES}
    runs = {"machine": "mill", "runs": RUNS, "total": len(RUNS), "kinds": {}, "verdicts": {}}
    compared = {
        "runs": [{**RUNS[0]}, {**RUNS[-1]}],
        "identified": {"reason": "not-identified"},
        "tables": {"reason": "not-written"},
    }
    answers: dict[str, Any] = {
        "**/api/history/plant*": plant,
        "**/api/history/runs*": runs,
        "**/api/runs?*": {"runs": RUNS, "before": None},
        f"**/api/runs/{RUN}": {"run_id": RUN, "accepted": True},
        "**/api/tables": {"active_bank": 1, "written_not_active": None, "kept": KEPT},
        "**/api/page/tables/difference*": DIFFERENCE,
        "**/api/page/comparison*": compared,
        "**/api/page/trends*": {"trends": [TREND], "marks": [], "alarms": []},
    }
    for pattern, answer in answers.items():
        page.route(pattern, partial(fulfil, answer))

    def longer(route: Route) -> None:
        response = route.fetch()
        worth = response.json()
        worth["positions"] = [worth["positions"][0]] * POSITIONS
        route.fulfill(response=response, json={**worth, "out_of_reach": worth["held_out"] * POSITIONS})

    page.route("**/api/page/worth", longer)


@pytest.mark.parametrize("locale", ["en", "de"])
def test_no_column_is_out_of_view_and_the_document_does_not_scroll(
    chromium: Browser, house: Service, locale: str
) -> None:
    for page in opened(chromium, house, locale=locale):
        with_token(page, house)
        full_of_rows(page)
        page.reload()
        expect(page.locator("#doing")).not_to_be_empty()
        page.evaluate(MEASURES)
        page.click("#tab-engineer")
        for section in ("reports", "plant", "tables", "compare", "parameters", "design"):
            page.click(f"#section-{section}")
            expect(page.locator(f"#section-{section}")).to_have_attribute("aria-current", "page")
            expect(page.locator("#content[aria-busy]")).to_have_count(0)
            expect(page.locator("#content table.data").first).to_be_visible()
            for width, height in SCREENS:
                page.set_viewport_size(ViewportSize(width=width, height=height))
                where = f"{section} at {width} × {height}"
                assert page.evaluate(OUT_OF_VIEW) == [], where
                assert page.evaluate("misplaced()") == [], where
        page.unroute_all(behavior="ignoreErrors")


def test_the_axes_of_the_geometric_errors_have_their_unit_and_only_the_latest_steps_stand_in_the_table(
    chromium: Browser, house: Service
) -> None:
    for page in opened(chromium, house):
        expect(page.locator("#doing")).not_to_be_empty()
        full_of_rows(page)
        page.click("#tab-engineer")
        page.click("#section-parameters")
        steps = page.locator("#content .latest-steps")
        expect(steps.locator("span")).to_have_text(["-1.5 on 2026-11-25", "-1.5 on 2026-11-24"])
        expect(steps).to_contain_text("and 3 earlier")
        labels = page.evaluate(
            "async () => { const { chart } = await import('/assets/chart.js');"
            " const drawn = chart({ title: 'EXX', xLabel: '', x: [0, 4000], y: [0, 1], unitX: 'mm' });"
            " return [...drawn.querySelectorAll('text')].map(({ textContent }) => textContent); }"
        )
        assert "0 mm" in labels
        page.unroute_all(behavior="ignoreErrors")
