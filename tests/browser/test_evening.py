"""An evening and a night at the machine, operated from the page alone."""

from __future__ import annotations

import json
import re

from panel_pages import with_token
from playwright.sync_api import Page, expect
from service_process import Service
from volcal_command import volcal_json

HEAD = "name,kind,x_mm,y_mm,z_mm,to_x_mm,to_y_mm,to_z_mm,lower_um,upper_um"
LONG_MS = 600_000
"""A report is made in a process of its own."""


def begin(page: Page, kind: str, slot_minutes: int | None = None) -> None:
    page.click("#start")
    page.check(f"input[value={kind}]")
    if slot_minutes is not None:
        page.fill("input[name=slot]", f"{slot_minutes}")
    page.click("dialog button[type=submit]")  # not without the consent: the form stays
    expect(page.locator("dialog")).to_be_visible()
    page.check("input[name=consent]")
    page.click("dialog button[type=submit]")


def state_is(page: Page, *states: str) -> None:
    expect(page.locator("#state")).to_have_attribute("data-state", re.compile(f"^({'|'.join(states)})$"))


def expect_same_end(page: Page, house: Service, name: str) -> None:
    """Badge, sentence, card, list of runs and `history list` call the end of the last run by one name."""
    (run,) = house.get("/api/runs?limit=1")["runs"]
    verdict = run["verdict"]
    assert (verdict, verdict["name"]) == (house.status()["verdict"], name)
    expect(page.locator("#state")).to_have_attribute("data-verdict", name)
    expect(page.locator("#state .word")).to_have_text(verdict["word"])
    expect(page.locator("#doing")).to_have_text(verdict["sentence"])
    expect(page.locator("#result .verdict")).to_have_attribute("data-verdict", name)
    expect(page.locator("#result")).to_contain_text(f"{run['held_out_before_um']:.2f}")
    expect(page.locator("#recent")).to_contain_text(verdict["word"])
    tile = page.locator("#tiles dd").nth(1)
    expect(tile).to_have_text(page.locator("#result dd").nth(1).inner_text())
    listed = house.command("history", "list", "--json")
    assert json.loads(listed.stdout)["runs"][-1]["verdict"] == verdict
    page.click("#tab-engineer")
    page.click("#section-reports")
    expect(page.locator("#content tbody tr").first.locator(".verdict")).to_have_attribute("data-verdict", name)
    page.click("#tab-operator")


def bank_shown(page: Page) -> str:
    return page.locator("#content .facts dd").nth(1).inner_text()


def select_and_compare(page: Page, house: Service) -> None:
    """Three runs have ended: a calibration, a night and a restored table."""
    rows = page.locator("#content tbody tr")
    expect(rows).to_have_count(3)
    expect(rows.locator("td:nth-child(2)")).to_have_text(["3", "2", "1"])
    expect(page.locator("#filter-kind option")).to_contain_text(["all", "Calibrate (1)", "Night run (1)"])
    page.select_option("#filter-kind", "calibrate")
    expect(rows).to_have_count(1)
    rows.locator("input[type=checkbox]").check()
    page.select_option("#filter-kind", "")
    expect(rows).to_have_count(3)
    expect(page.locator("#compare")).to_be_disabled()
    rows.nth(1).locator("input[type=checkbox]").check()
    page.click("#compare")
    expect(page.locator("#section-compare")).to_have_attribute("aria-current", "page")
    heads = page.locator("#content table").first.locator("tr", has_text="Kind").locator("td")
    expect(heads).to_have_text(["Kind", "Calibrate", "Night run", ""])
    page.click("#section-trend")
    figure = page.locator(".trend .chart").first
    expect(figure.locator(".event.accepted").first).to_be_attached()
    expect(page.locator(".choice [aria-pressed=true]")).to_have_text("All")
    box = figure.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 80)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.9 * box["width"], box["y"] + 80)
    page.mouse.up()
    expect(page.locator(".choice [aria-pressed=true]")).to_have_count(0)
    page.click("#content .choice button >> nth=0")
    expect(page.locator(".choice [aria-pressed=true]")).to_have_text("All")
    page.click("#section-reports")
    rows.nth(2).locator("button.plain").click()
    expect(page.locator("#section-map")).to_have_attribute("aria-current", "page")
    select_a_place_of_the_map(page)
    predict_a_part(page, house)


def predict_a_part(page: Page, house: Service) -> None:
    """At the best place, at another one by a click, and with a wrong row; the figures are those of the command."""
    features = house.directory / "part.csv"
    datum = "".join(f"{name},datum,{at},,,,,\n" for name, at in (("D", "0,0,0"), ("E", "200,0,0"), ("F", "0,200,0")))
    text = f"{HEAD}\n{datum}A,distance,0,0,0,200,0,0,-500,500\n=B,point,0,100,0,,,,,\nC,flatness,0,0,0,,,,,0.001\n"
    features.write_text(text)
    page.click("#section-part")
    page.set_input_files("#part-file", features)
    expect(page.locator("#part-text")).to_have_value(text)
    page.click("#part-predict")
    expect(page.locator("#content .card")).to_have_text("Origin X / mm: “” is not a number.")
    page.get_by_role("button", name="At the best place").click()
    expect(page.locator("#part-x")).to_be_disabled()
    page.fill("#part-z", "400,0")
    page.click("#part-predict")
    expect(page.locator("#content .card")).to_contain_text("row 7")
    text = text.replace("C,flatness,0,0,0", "C,position,150,150,0")
    features.write_text(text)
    page.fill("#part-text", text)
    page.click("#part-predict")
    rows = page.locator("#content tbody tr")
    expect(rows.locator("td:first-child")).to_have_text(["A", "=B", "C"])
    expect(rows.nth(0).locator(".mark")).to_have_text(["conforms", "conforms"])
    expect(rows.nth(1).locator(".mark")).to_have_text(["no tolerance", "no tolerance"])
    expect(rows.nth(2).locator(".mark").first).to_have_text(re.compile("does not conform|undecided"))
    best = page.locator("#part-x").input_value()
    page.locator("#part-map").click(position={"x": 3.0, "y": 3.0})
    expect(page.locator("#part-x")).not_to_have_value(best)
    expect(rows.nth(0).locator(".mark")).to_have_text(["conforms", "conforms"])
    at = ",".join(page.locator(f"#part-{axis}").input_value() for axis in "xyz")
    run_id = page.locator("#run").input_value()
    folder = str(house.directory / "state" / run_id)
    told = volcal_json("predict", features, "--estimate", folder, f"--at={at}", exit_code=None)
    expected = told["features"][0]["without_table"]
    shown = f"{expected['expected_um']:.1f} ± {expected['expanded_um']:.1f} µm"
    expect(rows.nth(0).locator("td").nth(3)).to_contain_text(shown)


def select_a_place_of_the_map(page: Page) -> None:
    maps, values = page.locator("#content .planes canvas"), page.locator("#values")
    expect(maps).to_have_count(3)
    expect(values).to_contain_text("Point at a map")
    maps.nth(1).hover(position={"x": 1.0, "y": 1.0})
    expect(values).to_contain_text(re.compile(r"X 0 +Y 1,300 +Z 750 mm"))
    for word in ("before", "after", "standard uncertainty"):
        expect(values.locator("b", has_text=word)).to_be_visible()
    maps.nth(1).focus()
    page.keyboard.press("ArrowRight")
    expect(values).to_contain_text(re.compile(r"X 83 +Y 1,300"))
    page.click("#plane-y")
    expect(page.locator(".slider")).to_contain_text("at Y 650 mm")
    page.locator("#plane-at").focus()
    page.keyboard.press("Home")
    expect(page.locator(".slider")).to_contain_text("at Y 0 mm")
    expect(page.locator("#content .planes .ends").first).to_contain_text("Z 0 to 1,500 mm")


def test_a_calibration_by_hand_a_night_and_a_table_taken_back(page: Page, house: Service) -> None:
    begin(page, "calibrate")
    page.click("dialog summary")
    page.fill("input[name=token]", "a wrong one")
    page.click("dialog button[type=submit]")
    expect(page.locator("dialog form > p")).to_contain_text("rejected this token")
    page.fill("input[name=token]", house.token)
    page.click("dialog button[type=submit]")
    state_is(page, "preflight", "measuring")
    expect(page.locator("#kind")).to_have_text(re.compile("^Calibrate · "))
    state_is(page, "measuring")
    expect(page.locator("#phase")).to_contain_text("Position set · ")
    expect(page.locator("#doing")).to_contain_text(re.compile(r"Measuring: station 1, azimuth -?\d+°.*ball \d+"))
    expect(page.locator("#minutes-left")).to_have_text(re.compile(r"\d+ min remaining"))
    expect(page.locator(".residuals rect").nth(5)).to_be_attached()
    expect(page.locator("#start")).to_be_disabled()
    state_is(page, "complete")
    expect(page.locator("#tiles")).to_contain_text(re.compile(r"bank [12] active"))
    expect(page.locator("#cards")).to_be_empty()
    expect_same_end(page, house, "accepted")
    first = house.status()
    assert first["run_id"]

    begin(page, "nightly", slot_minutes=14)
    state_is(page, "measuring")
    state_is(page, "complete")
    night = house.status()
    expect_same_end(page, house, night["verdict"]["name"])
    assert (night["kind"], night["run_id"] != first["run_id"]) == ("nightly", True)

    page.click("#tab-engineer")
    page.click("#section-tables")
    expect(page.locator("#content .mark.active")).to_have_count(1)
    expect(page.locator("#content .mark.accepted").first).to_be_visible()
    before = bank_shown(page)
    rows = page.locator("#content table").first.locator("tbody tr")
    row = rows.filter(has_text="Written").filter(has_not_text=before).first
    wanted = row.locator("td").nth(3).inner_text() if row.count() else None
    row = row if wanted else rows.filter(has_text="no compensation").first
    row.locator("button.restore").click()
    expect(page.locator("dialog")).to_contain_text("No motion")
    page.click("dialog button[type=button]")  # thought better of it
    assert house.status()["run_id"] == night["run_id"]
    row.locator("button.restore").click()
    page.click("dialog button[type=submit]")
    state_is(page, "restoring", "preflight", "complete")
    expect(page.locator("#content .mark.restored, #content .mark.staged").first).to_be_visible()
    expect(page.locator("#content .facts dd").nth(1)).not_to_have_text(before)
    assert house.reached("complete")["run_id"] != night["run_id"]

    with page.expect_download() as saved:
        page.locator("#content a.button").first.click()
    assert saved.value.path().read_text().startswith("x_mm,y_mm,z_mm,")
    page.click("#section-reports")
    with page.expect_download(timeout=LONG_MS) as report:
        page.locator("#content a.button", has_text="PDF").last.click()
    assert report.value.path().read_bytes().startswith(b"%PDF")
    with page.expect_download() as diagnostics:
        page.click("#diagnostics")
    assert diagnostics.value.path().read_bytes().startswith(b"PK")
    select_and_compare(page, house)


def test_hold_resume_and_abort_that_asks_nothing(page: Page, house: Service) -> None:
    with_token(page, house)
    begin(page, "calibrate")
    house.until(lambda now: now["touches"] > 3, "touches")
    page.click("#hold")
    state_is(page, "held")
    expect(page.locator("#hold")).to_be_hidden()
    page.click("#resume")
    state_is(page, "measuring")
    page.evaluate("sessionStorage.clear()")  # whoever aborts knows no token
    page.click("#abort")
    expect(page.locator("dialog")).to_be_hidden()
    state_is(page, "aborted")
    alarm = page.locator(".card.alarm")
    expect(alarm).to_contain_text("Alarm 470: The run was aborted")
    expect(alarm).to_contain_text("Remedy: Reset when the machine is clear.")
    expect(page.locator("#start")).to_be_disabled()
    with_token(page, house)
    page.click("#reset")
    state_is(page, "idle")
    expect(page.locator("#cards")).to_be_empty()


def test_no_dialog_stands_before_the_abort(page: Page) -> None:
    for opener in ("#start", "#token", "#keys"):
        page.click(opener)
        expect(page.locator("dialog")).to_be_visible()
        page.click("#abort")
        expect(page.locator("#said")).to_contain_text("Abort requested.")
        page.keyboard.press("Escape")
        expect(page.locator("dialog")).to_be_hidden()


def test_a_question_is_answered_with_one_of_two_large_buttons(page: Page, house: Service) -> None:
    """The simulated operator answers by itself, so the question is put into the status on its way to the page."""
    with_token(page, house)
    question = {"number": 3, "text": "carry the artefact to station 2", "station": 2}
    asking = {**house.status(), "question": question, "may": ["answer", "abort"], "event": 10**15}
    page.route("**/api/status", lambda route: route.fulfill(json=asking))
    card = page.locator(".card.question")
    expect(card).to_contain_text("Move the artefact to station 2")
    for button, yes in (("#answer-yes", True), ("#answer-no", False)):
        box = page.locator(button).bounding_box()
        assert box is not None
        assert min(box["width"], box["height"]) >= 60, button
        with page.expect_request("**/api/answer") as sent:
            page.click(button)
        assert sent.value.post_data_json == {"number": 3, "yes": yes}
        assert sent.value.headers["authorization"] == f"Bearer {house.token}"


def test_everything_by_keys_alone(page: Page, house: Service) -> None:
    with_token(page, house)
    reached = set()
    for _ in range(40):
        page.keyboard.press("Tab")
        seen = page.evaluate(
            "() => { const e = document.activeElement, s = getComputedStyle(e);"
            " return [e.id || e.tagName, s.outlineStyle !== 'none' ? parseFloat(s.outlineWidth) : 0]; }"
        )
        if seen[0] != "BODY":
            assert seen[1] >= 2, seen
        reached.add(seen[0])
    assert {"tab-operator", "language", "theme", "token", "keys", "CANVAS", "start", "abort"} <= reached
    page.keyboard.press("?")
    expect(page.locator("dialog table.keys")).to_contain_text("ABORT")
    page.keyboard.press("Escape")
    page.keyboard.press("2")
    expect(page.locator("#view-engineer")).to_be_visible()
    page.keyboard.press("1")
    expect(page.locator("#view-operator")).to_be_visible()
    page.keyboard.press("s")
    page.focus("input[name=consent]")
    page.keyboard.press("Space")
    page.keyboard.press("Enter")
    house.until(lambda now: now["state"] == "measuring", "measuring")
    page.keyboard.press("a")
    state_is(page, "aborted")
    page.keyboard.press("q")
    state_is(page, "idle")
