"""Every view in both languages and themes, measured: nothing overlaps or is cut, all can be read, named and hit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from panel_pages import PANEL
from playwright.sync_api import Page, Response, Route, expect

from agent.language.sentences import catalogue, german

SECTIONS = (
    *("reports", "map", "curves", "part", "compare", "trend", "parameters"),
    *("design", "tables", "events", "alarms", "temperatures", "settings", "plant"),
)
MEASURES = (Path(__file__).parent / "measures.js").read_text()
INTERACTIVE = {
    "button",
    "link",
    "textbox",
    "checkbox",
    "radio",
    "combobox",
    "spinbutton",
    "tab",
    "image",
    "progressbar",
}
FOREIGN = {"µm", "µrad", "mm", "min", "EN", "DE", "AM", "PM"}
WORD = re.compile(r"[^\W\d_]{2,}")


def views(page: Page) -> Iterator[str]:
    page.click("#tab-operator")
    yield "operator"
    page.click("#tab-engineer")
    for section in SECTIONS:
        page.click(f"#section-{section}")
        expect(page.locator(f"#section-{section}")).to_have_attribute("aria-current", "page")
        expect(page.locator("#content[aria-busy]")).to_have_count(0)
        yield section


def unnamed(page: Page) -> list[Any]:
    """By Chromium's own accessibility tree."""
    session = page.context.new_cdp_session(page)
    nodes = session.send("Accessibility.getFullAXTree")["nodes"]
    return [
        node["role"]["value"]
        for node in nodes
        if not node["ignored"]
        and node.get("role", {}).get("value") in INTERACTIVE
        and not node.get("name", {}).get("value", "").strip()
    ]


@pytest.mark.parametrize(("language", "theme"), [("en", "light"), ("de", "dark")])
def test_each_view_fits_a_panel_and_can_be_read_and_named(page: Page, language: str, theme: str) -> None:
    if page.evaluate("document.documentElement.lang") != language:
        page.click("#language")
    if page.evaluate("document.documentElement.dataset.theme") != theme:
        page.click("#theme")
    assert page.evaluate("document.documentElement.lang") == language
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.evaluate(MEASURES)
    for view in views(page):
        assert page.evaluate("misplaced()") == [], view
        assert page.evaluate("unreadable()") == [], view
        assert unnamed(page) == [], view
    page.click("#tab-operator")
    for opener in ("#start:enabled", "#token", "#keys"):
        page.click(opener)
        expect(page.locator("dialog")).to_be_visible()
        assert page.evaluate("misplaced(document.querySelector('dialog'))") == [], opener
        assert page.evaluate("unreadable()") == [], opener
        assert unnamed(page) == [], opener
        page.keyboard.press("Escape")
    page.set_viewport_size({"width": 1920, "height": 1080})
    assert page.evaluate("misplaced()") == []
    page.set_viewport_size(PANEL)
    origin = page.url.rstrip("/")
    assert [url for url in asked if not url.startswith((origin, "blob:", "data:"))] == []


def test_no_word_stands_anywhere_but_in_the_catalogue(page: Page) -> None:
    """With every message marked, what is left unmarked is a number, a unit, or what the service says."""

    def marked(route: Route) -> None:
        messages = route.fetch().json()
        answer = {key: {tongue: f"⟦{text}⟧" for tongue, text in texts.items()} for key, texts in messages.items()}
        route.fulfill(json=answer)

    page.route("**/assets/messages.json", marked)
    page.route("**/assets/verdicts.json", marked)
    said: set[str] = set(FOREIGN)

    def heard(response: Response) -> None:
        if "/api/" in response.url and "json" in response.headers.get("content-type", ""):
            said.update(WORD.findall(response.text()))

    page.on("response", heard)
    page.reload()
    expect(page.locator("#state .word")).to_contain_text("⟦")
    page.evaluate(MEASURES)
    for view in views(page):
        assert sorted(set(page.evaluate("unmarked()")) - said) == [], view


def test_the_other_language_at_one_press_with_its_numbers(page: Page) -> None:
    page.click("#tab-engineer")
    page.click("#section-design")
    expect(page.locator("#content h2")).to_have_text("Position set and its expected benefit")
    expect(page.locator("#content")).to_contain_text("45.0°")
    page.click("#language")
    expect(page.locator("#content h2")).to_have_text("Positionssatz und erwarteter Nutzen")
    expect(page.locator("#content")).to_contain_text("45,0°")
    expect(page.locator("#abort")).to_contain_text("ABBRUCH")
    page.reload()
    expect(page.locator("#abort")).to_contain_text("ABBRUCH")


def test_the_page_tells_each_sentence_as_the_catalogue_does(page: Page) -> None:
    page.click("#language")
    values = re.compile(r"\{\w+\}")
    texts = [values.sub("⟦1.5⟧", english) for english in catalogue()]
    texts += [
        "connection lost: no answer (device cnc). check the adapter",
        "from 2026-11-29T03:15:07Z on, 1.5 mm or 0.1.0",
    ]
    told = page.evaluate(
        "async texts => { const { told } = await import('/assets/sentences.js'); return texts.map(told); }", texts
    )
    assert [pair for pair in zip(texts, told, strict=True) if german(pair[0]) != pair[1]] == []


KEY = "probing/station-2/az90-el-45/ball-03"
LOST = {
    "touch 1 met nothing": (KEY, "Ball 3 not found: station 2, azimuth 90°, elevation -45°"),
    "touch 1 met nothing when it was repeated": (KEY, "Ball 3 rejected: station 2, azimuth 90°, elevation -45°"),
    "the touches lie on no sphere": (KEY, "Ball 3 rejected: station 2, azimuth 90°, elevation -45°"),
    None: (KEY, "Ball 3 not found: station 2, azimuth 90°, elevation -45°"),
    "no ball in the key": ("probing/station-2", "Station 2"),
    "no place in the key": ("artefact", "artefact"),
}


def test_a_ball_that_could_not_be_measured_is_told_by_its_reason_and_its_place(page: Page) -> None:
    events = [
        {"kind": "lost", "text": key, "data": {} if reason is None else {"reason": reason}}
        for reason, (key, _) in LOST.items()
    ]
    told = page.evaluate(
        "async events => { const { eventText } = await import('/assets/wording.js'); return events.map(eventText); }",
        events,
    )
    assert [text.lower() for text in told] == [text.lower() for _, text in LOST.values()]


def test_two_fingers_and_the_wheel_zoom_the_view(page: Page) -> None:
    canvas = page.locator(".stage canvas")
    box = canvas.bounding_box()
    assert box is not None
    picture = "document.querySelector('.stage canvas').toDataURL()"
    expect(page.locator(".stage-note")).to_be_empty()
    before = page.evaluate(picture)
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    session = page.context.new_cdp_session(page)

    def fingers(kind: str, apart: float) -> None:
        points = [{"x": x - apart, "y": y, "id": 1}, {"x": x + apart, "y": y, "id": 2}]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points if kind != "touchEnd" else []})

    fingers("touchStart", 40)
    fingers("touchMove", 120)
    fingers("touchEnd", 0)
    page.wait_for_function(f"before => {picture} !== before", arg=before)
    pinched = page.evaluate(picture)
    page.mouse.move(x, y)
    page.mouse.wheel(0, 300)
    page.wait_for_function(f"before => {picture} !== before", arg=pinched)
    canvas.focus()
    wheeled = page.evaluate(picture)
    page.keyboard.press("ArrowLeft")
    page.wait_for_function(f"before => {picture} !== before", arg=wheeled)
