"""Rules of axe-core in every view, dialog and report, in both languages and themes; and ABORT as the first stop."""

from __future__ import annotations

from typing import Any, Literal

from accessibility import violations
from panel_pages import at_rest, opened
from playwright.sync_api import Browser, Page, expect
from service_process import Service
from test_looks import views
from told_page import ALARM, QUESTION, told, unproved_status
from told_page import status as status_in

from agent.execution.states import RunState

OPEN: dict[str, dict[str, Any]] = {
    "alarm": {**status_in(RunState.FAULTED, unfinished=True), "alarms": [ALARM]},
    "question": {**status_in(RunState.HELD), "question": QUESTION},
    "unproved": unproved_status(),
    "measuring": status_in(RunState.MEASURING),
}


def test_every_view_and_report_is_accessible_and_abort_is_the_first_stop(chromium: Browser, house: Service) -> None:
    at_rest(house)
    run = house.start()
    house.reached("complete")
    for page in opened(chromium, house):
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "abort"
        for language, theme in (("en", "light"), ("de", "dark")):
            shown_in(page, language, theme)
            expect(page.locator("#result")).to_be_visible()
            for view in views(page):
                assert violations(page) == [], (language, theme, view)
            page.click("#tab-operator")
            for opener in ("#start:enabled", "#token", "#keys"):
                page.click(opener)
                expect(page.locator("dialog")).to_be_visible()
                assert violations(page) == [], (language, theme, opener)
                page.keyboard.press("Escape")
    reported = chromium.new_page()
    looks: tuple[tuple[str, Literal["light", "dark"]], ...] = (("en", "light"), ("de", "dark"))
    for language, scheme in looks:
        assert house.command("report", run, "--language", language).returncode == 0
        reported.goto((house.state / run / "report.html").as_uri())
        reported.emulate_media(color_scheme=scheme)
        assert violations(reported) == [], (language, scheme)
        assert reported.evaluate("document.documentElement.lang") == language
    reported.close()


def test_what_may_be_open_is_accessible_and_an_alarm_is_read_aloud(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        for (name, document), language in zip(OPEN.items(), ("de", "en", "de", "en"), strict=True):
            said.clear()
            said.update(document)
            expect(page.locator("#state")).to_have_attribute("data-state", document["state"])
            shown_in(page, language, "light")
            for theme in ("light", "dark"):
                shown_in(page, language, theme)
                assert violations(page) == [], (name, language, theme)
            spoken = page.locator("#alarms[role=alert]")
            if document["alarms"]:
                expect(spoken).to_contain_text(f"Alarm {ALARM['code']}: ")
            else:
                expect(spoken).to_be_empty()


def shown_in(page: Page, language: str, theme: str) -> None:
    if page.evaluate("document.documentElement.lang") != language:
        page.click("#language")
    if page.evaluate("document.documentElement.dataset.theme") != theme:
        page.click("#theme")
