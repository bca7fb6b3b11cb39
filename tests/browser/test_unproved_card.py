"""The card of an unproved table fits a panel in both languages, and its buttons send the requests of the ways out."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from panel_pages import at_rest, opened, with_token
from playwright.sync_api import Browser, Page, Route, expect
from service_process import Service

from agent.runs.unproved_table import UnprovedTable

MEASURES = (Path(__file__).parent / "measures.js").read_text()
NO_EVENTS = "retry: 3600000\n\n"
TABLE = UnprovedTable("20261128T010000Z-abcd", 2, 1, provable=True)
REASON, REASON_DE = "no bank 7; the controller has 3", "Keine Bank 7; die Steuerung hat 3"


@contextmanager
def told(chromium: Browser, house: Service, table: UnprovedTable, locale: str) -> Iterator[tuple[Page, list[str]]]:
    """Page whose service tells of the unproved table; its requests of ways out are recorded instead of carried out."""
    at_rest(house)
    asked: list[str] = []

    def status(route: Route) -> None:
        response = route.fetch()
        alarm = {
            "code": 360,
            "text": f"{table.situation}: {REASON}",
            "hint": table.way_out,
            "where": {},
        }
        view = {**vars(table), "situation": table.situation, "way_out": table.way_out}
        may = ["restore_former", "give_up", "reset", *(["resume_run"] if table.provable else [])]
        changed = {"unproved": view, "alarms": [alarm], "may": may, "active_bank": table.bank}
        route.fulfill(response=response, json={**response.json(), **changed})

    def record(route: Route) -> None:
        assert route.request.headers["authorization"].endswith(house.token)
        asked.append(route.request.url.partition("/api/")[2])
        route.fulfill(json={"taken": True, "run_id": table.run_id})

    for page in opened(chromium, house, locale=locale):
        with_token(page, house)
        page.route("**/api/status", status)
        # the stream begins with the status of the service itself
        page.route("**/api/events", lambda route: route.fulfill(content_type="text/event-stream", body=NO_EVENTS))
        page.route(re.compile("/api/(unproved-table|resume-run|give-up-run)"), record)
        page.reload()
        expect(page.locator("#unproved")).to_be_visible()
        yield page, asked
        page.unroute_all(behavior="ignoreErrors")  # the page asks for the status until it is closed


@pytest.mark.parametrize(
    ("locale", "words"),
    [("en", ("Not ready: unproved table active", "never proved", REASON, "activate bank 1 at the controller")),
     ("de", ("Nicht bereit: ungeprüfte Tabelle aktiv", "nie durch Messung", REASON_DE, "Bank 1 an der Steuerung"))],
)  # fmt: skip
def test_the_card_says_what_is_active_and_its_buttons_lead_out(
    chromium: Browser, house: Service, locale: str, words: tuple[str, ...]
) -> None:
    with told(chromium, house, TABLE, locale) as (page, asked):
        expect(page.locator("#doing")).to_contain_text(words[0])
        for word in words[1:]:
            expect(page.locator("#unproved")).to_contain_text(word)
        expect(page.locator(".card.alarm")).to_have_count(1)
        page.evaluate(MEASURES)
        assert page.evaluate("misplaced()") == []
        assert page.evaluate("unreadable()") == []
        for button, path in (
            ("#restore-former", "unproved-table/restore"),
            ("#prove-table", "resume-run"),
            ("#give-up", "give-up-run"),
        ):
            with page.expect_response(re.compile(path)):
                page.click(button)
        assert asked == ["unproved-table/restore", "resume-run", "give-up-run"]


def test_a_run_that_has_ended_offers_no_proof(chromium: Browser, house: Service) -> None:
    ended = UnprovedTable(TABLE.run_id, 2, 0, provable=False)
    with told(chromium, house, ended, "en") as (page, _):
        expect(page.locator("#prove-table")).to_have_count(0)
        expect(page.locator("#unproved")).to_contain_text("cannot prove its table")
        expect(page.locator("#unproved")).to_contain_text("switch the compensation off at the controller")
