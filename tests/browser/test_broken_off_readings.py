"""What was being read when ABORT was pressed, or could not be read at once, is asked for again without a reload. What
the service says meanwhile is shown at once, and stays."""

from __future__ import annotations

import json
from itertools import pairwise
from typing import Any

from playwright.sync_api import Browser, Page, Route, expect
from service_process import Service
from told_page import ALARM, NO_EVENTS, RUN, idle_with_alarm, status, told

from agent.execution.states import RunState
from agent.language.sentences import german

KEYS = [f"measure/station-1/az0-el45/ball-0{ball}" for ball in range(3)]
BALLS = [
    {
        "key": key,
        "centre_mm": [100.0 + ball, 200.0, 300.0],
        "diameter_mm": 30.0,
        "form_mm": 0.002,
        "centre_repeatability_um": 0.4,
        "position": "az0-el45",
        "station": 1,
        "ball": ball,
    }
    for ball, key in enumerate(KEYS)
]

NOTE = {"number": 7, "at": "2026-11-28T01:00:05Z", "kind": "note", "record": {"text": "warm-up skipped"}}
WAITS_MS = [1000, 2000, 4000, 8000, 16000, 30000, 30000]


def measuring(page: Page, said: dict[str, Any], answer: Any) -> None:
    """Let the page see a run of which the journal has balls; `answer` answers each request for them."""
    page.route(f"**/api/runs/{RUN}/balls", answer)
    page.route(f"**/api/runs/{RUN}/events*", lambda route: route.fulfill(json=[NOTE]))
    with page.expect_request(f"**/api/runs/{RUN}/balls"):
        said.update(status(RunState.MEASURING))


def test_an_abort_while_the_balls_of_the_run_are_read_loses_none_of_them(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        asked: list[Route] = []

        def answer(route: Route) -> None:
            asked.append(route)
            if len(asked) > 1:
                route.fulfill(json=BALLS)

        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        measuring(page, said, answer)
        page.click("#abort")
        expect(page.locator("#said")).to_have_text("Abort requested.")
        expect(page.locator(".residuals rect")).to_have_count(len(BALLS))
        expect(page.locator("#recent")).to_contain_text("warm-up skipped")
        assert len(asked) == 2


def test_an_abort_while_the_path_is_computed_leaves_it_to_be_drawn(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        pending: list[Route] = []

        def answer(route: Route) -> None:
            if pending:
                route.continue_()
            else:
                pending.append(route)

        page.goto("about:blank")  # nothing that was asked before is answered any more
        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        page.route("**/api/plan", answer)
        with page.expect_request("**/api/plan"):
            page.goto(house.url)
        expect(page.locator(".stage-note")).to_have_text("Computing the path …")
        page.click("#abort")
        expect(page.locator(".stage-note")).to_have_text("")


def test_an_abort_is_sent_before_anything_is_read_again(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        silent: list[Route] = []
        read: list[str] = []
        page.route("**/api/abort", lambda route: silent.append(route))  # noqa: PLW0108  Playwright needs a function
        measuring(page, said, lambda route: None)
        page.on("request", lambda request: read.append(request.url.rpartition("/api/")[2]))
        page.clock.install()
        page.clock.pause_at(page.evaluate("Date.now() + 30000"))
        read.clear()
        with page.expect_request("**/api/abort"):
            page.click("#abort")
        page.clock.run_for(999)
        assert read == ["abort"]
        with page.expect_request(f"**/api/runs/{RUN}/balls"):
            silent[0].fulfill(json={"taken": True})


def test_a_service_that_was_started_again_is_shown_although_its_numbers_are_lower(
    chromium: Browser, house: Service
) -> None:
    with told(chromium, house) as (page, said):
        with page.expect_response("**/api/status"):
            said.update(status(RunState.IDLE))
        said.update({**idle_with_alarm(), "event": 3})
        expect(page.locator("#cards .alarm")).to_contain_text(str(ALARM["text"]))


def test_an_abort_while_a_file_is_fetched_lets_it_arrive_later(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        asked: list[Route] = []

        def answer(route: Route) -> None:
            asked.append(route)
            if len(asked) > 1:
                route.fulfill(content_type="application/zip", body=b"PK")

        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        page.route("**/api/diagnostics", answer)
        page.click("#tab-engineer")
        page.click("#section-reports")
        with page.expect_request("**/api/diagnostics"):
            page.click("#diagnostics")
        with page.expect_download() as fetched:
            page.click("#abort")
        assert fetched.value.path().read_bytes() == b"PK"
        assert len(asked) == 2


def test_the_reason_of_an_abort_is_kept_in_english_and_told_in_each_language(chromium: Browser, house: Service) -> None:
    with told(chromium, house, "de") as (page, _):
        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        with page.expect_request("**/api/abort") as sent:
            page.click("#abort")
        assert sent.value.post_data_json == {"reason": "abort pressed on the page"}
    assert german("aborted: abort pressed on the page") == "abgebrochen: Abbruch auf der Seite gedrückt"


def test_balls_that_could_not_be_read_at_once_are_read_later(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        asked: list[Route] = []

        def answer(route: Route) -> None:
            asked.append(route)
            if len(asked) > 1:
                route.fulfill(json=BALLS)
            else:
                locked(route)

        measuring(page, said, answer)
        expect(page.locator(".residuals rect")).to_have_count(len(BALLS))
        assert len(asked) == 2


def test_what_cannot_be_read_is_asked_for_ever_more_rarely(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        clocked(page)
        measuring(page, said, locked)
        while len(page.evaluate("askedAt")) <= len(WAITS_MS):
            page.clock.run_for(1000)
        asked_at = page.evaluate("askedAt")
        waits = [later - earlier for earlier, later in pairwise(asked_at)]
        assert all(waited >= least for waited, least in zip(waits, WAITS_MS, strict=False)), waits


def test_the_status_is_shown_though_the_balls_are_never_answered(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        measuring(page, said, lambda route: None)
        expect(page.locator("#state")).to_have_attribute("data-state", "measuring")
        said.update(status(RunState.HELD))
        expect(page.locator("#state")).to_have_attribute("data-state", "held")


def test_balls_that_are_never_answered_are_asked_for_again(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        asked: list[Route] = []

        def answer(route: Route) -> None:
            asked.append(route)
            if len(asked) > 1:
                route.fulfill(json=BALLS)

        clocked(page)
        measuring(page, said, answer)
        while len(asked) < 2:
            page.clock.run_for(5000)
        expect(page.locator(".residuals rect")).to_have_count(len(BALLS))


def test_what_happens_while_the_run_is_read_stays_beside_what_the_journal_has(
    chromium: Browser, house: Service
) -> None:
    live: list[tuple[str, str, dict[str, Any]]] = [
        ("state", "measuring", {"state": "measuring", "run_id": RUN}),
        ("alarm", str(ALARM["text"]), ALARM),
        ("gate", "the fit is worse than its limit", {}),
    ]
    rows = [
        {"number": 901, "kind": "state", "record": {"state": "preflight", "reason": ""}},
        {"number": 902, "kind": "state", "record": {"state": "measuring", "reason": ""}},
    ]
    with told(chromium, house) as (page, said):
        read: list[Route] = []
        said.update(status(RunState.MEASURING))
        page.route("**/api/events", lambda route: route.fulfill(content_type="text/event-stream", body=stream(live)))
        page.route(f"**/api/runs/{RUN}/balls", lambda route: route.fulfill(json=BALLS))
        page.route(f"**/api/runs/{RUN}/events*", lambda route: read.append(route))  # noqa: PLW0108
        page.reload()
        recent = page.locator("#recent li")
        expect(recent).to_have_count(len(live))
        read[0].fulfill(json=[{**row, "at": "2026-11-28T01:00:05Z"} for row in rows])
        expect(recent).to_have_count(4)
        for line, words in enumerate(("the fit is worse than its limit", "Alarm 431", "Measuring", "Preflight")):
            expect(recent.nth(line)).to_contain_text(words)


def locked(route: Route) -> None:
    route.fulfill(status=503, json={"status": 503, "detail": "the journal is locked"})


def clocked(page: Page) -> None:
    """Stop the clock of the page, and let it keep the times in ms at which it asks for the balls, in `askedAt`."""
    page.clock.install()
    page.reload()
    expect(page.locator("#doing")).not_to_be_empty()
    page.evaluate(
        """() => {
            const whole = fetch;
            window.askedAt = [];
            window.fetch = (path, options) => {
                if (path.endsWith("/balls")) askedAt.push(Date.now());
                return whole(path, options);
            };
        }"""
    )


def stream(events: list[tuple[str, str, dict[str, Any]]]) -> str:
    """Return a stream of server-sent events, numbered from 1."""
    sent = (
        f"id: {number}\nevent: {kind}\ndata: {json.dumps({'text': text, 'data': data})}\n\n"
        for number, (kind, text, data) in enumerate(events, 1)
    )
    return NO_EVENTS + "".join(sent)
