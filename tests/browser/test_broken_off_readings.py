"""What was being read when ABORT was pressed, or could not be read at once, is asked for again without a reload."""

from __future__ import annotations

from typing import Any

from playwright.sync_api import Browser, Page, Route, expect
from service_process import Service
from told_page import RUN, status, told

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


def measuring(page: Page, said: dict[str, Any], answer: Any) -> None:
    """Let the page see a run of which the journal has balls; `answer` answers each request for them."""
    page.route(f"**/api/runs/{RUN}/balls", answer)
    page.route(f"**/api/runs/{RUN}/events*", lambda route: route.fulfill(json=[]))
    with page.expect_request(f"**/api/runs/{RUN}/balls"):
        said.update(status(RunState.MEASURING))


def test_an_abort_while_the_balls_of_the_run_are_read_loses_none_of_them(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        pending: list[Route] = []

        def answer(route: Route) -> None:
            if pending:
                route.fulfill(json=BALLS)
            else:
                pending.append(route)

        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        measuring(page, said, answer)
        page.click("#abort")
        expect(page.locator("#said")).to_have_text("Abort requested.")
        expect(page.locator(".residuals rect")).to_have_count(len(BALLS))
        assert len(pending) == 1


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


def test_the_reason_of_an_abort_is_kept_in_english_and_told_in_each_language(chromium: Browser, house: Service) -> None:
    with told(chromium, house, "de") as (page, _):
        page.route("**/api/abort", lambda route: route.fulfill(json={"taken": True}))
        with page.expect_request("**/api/abort") as sent:
            page.click("#abort")
        assert sent.value.post_data_json == {"reason": "abort pressed on the page"}
    assert german("aborted: abort pressed on the page") == "abgebrochen: Abbruch auf der Seite gedrückt"


def test_balls_that_could_not_be_read_at_once_are_read_with_a_later_status(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        refused: list[Route] = []

        def answer(route: Route) -> None:
            if refused:
                route.fulfill(json=BALLS)
            else:
                refused.append(route)
                route.fulfill(status=503, json={"status": 503, "detail": "the journal is locked"})

        measuring(page, said, answer)
        expect(page.locator(".residuals rect")).to_have_count(len(BALLS))
        assert len(refused) == 1
