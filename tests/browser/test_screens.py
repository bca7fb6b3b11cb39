"""Every state on every screen, measured: ABORT is whole and in view, the state stays at the top, nothing scrolls
sideways; and what the page says while the service does not answer."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from panel_pages import opened
from playwright.sync_api import Browser, Page, Route, ViewportSize, expect
from service_process import Service
from told_page import RUN, RUN_SUMMARY, idle_with_alarm, status, told, unproved_status, views

from agent.execution.states import RunState
from agent.planning.run_phases import PREFLIGHT
from agent.results.run_verdict import VERDICTS

MEASURES = (Path(__file__).parent / "measures.js").read_text()
SCREENS = ((390, 844), (800, 480), (768, 1024), (1280, 800), (1920, 1080))
SECTIONS = 14


def edges(page: Page, selector: str) -> tuple[float, float]:
    """Upper and lower edge of the element in px."""
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["y"], box["y"] + box["height"]


def in_view(page: Page, selector: str) -> list[str]:
    """What is wrong with the place of the element; see `outOfView` in measures.js."""
    found: list[str] = page.evaluate("selector => outOfView(document.querySelector(selector))", selector)
    return found


@pytest.mark.parametrize("locale", ["en", "de"])
def test_abort_is_whole_and_the_state_in_view_in_every_state_on_every_screen(
    chromium: Browser, house: Service, locale: str
) -> None:
    with told(chromium, house, locale) as (page, said):
        page.evaluate(MEASURES)
        for name, document in views():
            said.clear()
            said.update(document)
            with page.expect_response("**/api/status"):
                pass  # the next one, which the page asks for by itself
            expect(page.locator("#state")).to_have_attribute("data-state", document["state"])
            verdict = document.get("verdict")
            expect(page.locator("#state")).to_have_attribute("data-verdict", verdict["name"] if verdict else "")
            for width, height in SCREENS:
                page.set_viewport_size(ViewportSize(width=width, height=height))
                where = f"{name} at {width} × {height}"
                assert in_view(page, "#abort") == [], where
                assert page.evaluate("misplaced()") == [], where
                (top, bottom), (footer, _) = edges(page, "#doing"), edges(page, ".controls")
                assert 0 <= top < bottom <= footer, where


@pytest.mark.parametrize("locale", ["en", "de"])
def test_the_start_dialog_has_its_buttons_in_view_on_every_screen(
    chromium: Browser, house: Service, locale: str
) -> None:
    with told(chromium, house, locale) as (page, _):
        page.evaluate(MEASURES)
        for width, height in SCREENS:
            page.set_viewport_size(ViewportSize(width=width, height=height))
            page.click("#start")
            expect(page.locator("dialog button[type=submit]")).to_be_visible()
            for kind in ("calibrate", "verify", "nightly"):
                page.check(f"input[value={kind}]")
                for selector in ("dialog button[type=submit]", "dialog .actions button[type=button]", "#abort"):
                    assert in_view(page, selector) == [], (width, height, kind, selector)
                assert page.evaluate(
                    "(({ scrollWidth, clientWidth }) => scrollWidth <= clientWidth)(document.querySelector('dialog'))"
                )
            page.keyboard.press("Escape")
            expect(page.locator("dialog")).to_be_hidden()


def test_the_start_dialog_asks_for_what_the_kind_of_run_has(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        sent: list[dict[str, Any]] = []

        def record(route: Route) -> None:
            sent.append(route.request.post_data_json or {})
            route.fulfill(json={"run_id": RUN}, status=202)

        page.route("**/api/start", record)

        def start(kind: str) -> dict[str, Any]:
            page.check("input[name=consent]")
            with page.expect_response("**/api/start"):
                page.click("dialog button[type=submit]")
            expect(page.locator("dialog")).to_be_hidden()
            expect(page.locator("#said")).to_have_text("Run started.")
            last = sent.pop()
            assert (last.pop("kind"), last.pop("source"), last.pop("consent")) == (kind, "page", True)
            return last

        page.click("#start")
        sets = page.locator("select[name=position_set] option")
        expect(sets.first).to_have_text("as in the settings: short.csv")
        assert {"S1", "S1+S3", "short.csv"} <= set(sets.all_inner_texts())
        assert page.locator("input[name=stations]:checked").evaluate_all("all => all.map(one => one.value)") == ["1"]
        for hidden in ("select[name=station]", "input[name=slot]", "input[name=full]"):
            expect(page.locator(hidden)).to_be_hidden()
        assert start("calibrate") == {}

        page.click("#start")
        page.select_option("select[name=position_set]", "S1+S3")
        page.check("input[name=stations][value='3']")
        assert start("calibrate") == {"position_set": "S1+S3", "stations": [1, 3]}

        page.click("#start")
        page.select_option("select[name=position_set]", "S1")
        page.check("input[value=verify]")
        expect(page.locator("select[name=position_set]")).to_be_hidden()
        assert start("verify") == {}

        page.click("#start")
        page.check("input[value=nightly]")
        page.select_option("select[name=station]", "2")
        page.fill("input[name=slot]", "25")
        page.check("input[name=full]")
        assert start("nightly") == {"stations": [2], "slot_minutes": 25, "full_allowed": True}


def test_an_unfinished_run_is_given_up_after_a_question(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        asked: list[str] = []

        def record(route: Route) -> None:
            asked.append(route.request.url.partition("/api/")[2])
            route.fulfill(json={"taken": True})

        page.route("**/api/give-up-run", record)
        page.route(f"**/api/runs/{RUN}", lambda route: route.fulfill(json={"balls": 27}))
        said.update(status(RunState.IDLE, unfinished=True))
        card = page.locator("#unfinished")
        expect(card).to_contain_text("It has measured 27 balls.")
        page.click("#give-up-run")
        expect(page.locator("dialog")).to_contain_text("can no longer be resumed")
        page.click("dialog .actions button[type=button]")
        expect(page.locator("dialog")).to_be_hidden()
        assert asked == []
        page.click("#give-up-run")
        page.click("dialog button[type=submit]")
        expect(page.locator("#said")).to_have_text("Run given up.")
        assert asked == ["give-up-run"]


def test_every_section_fits_a_phone_and_a_small_panel(chromium: Browser, house: Service) -> None:
    for page in opened(chromium, house):
        page.evaluate(MEASURES)
        page.click("#tab-engineer")
        expect(page.locator("#sections button")).to_have_count(SECTIONS)
        for number in range(SECTIONS):
            section = page.locator("#sections button").nth(number)
            section.click()
            expect(section).to_have_attribute("aria-current", "page")
            expect(page.locator("#content[aria-busy]")).to_have_count(0)
            for width, height in SCREENS[:3]:
                page.set_viewport_size(ViewportSize(width=width, height=height))
                assert in_view(page, "#abort") == []
                assert page.evaluate("misplaced()") == [], (section.inner_text(), width)


def test_an_idle_machine_with_something_left_is_not_called_ready(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        said.update(status(RunState.IDLE))
        expect(page.locator("#doing")).to_have_text("Ready to start")
        said.update(status(RunState.IDLE, unfinished=True))
        expect(page.locator("#doing")).to_have_text("Not moving: a run is unfinished")
        expect(page.locator("#state .word")).to_have_text("Not ready")
        expect(page.locator("#unfinished")).to_contain_text(RUN)
        expect(page.locator("#reset")).to_be_hidden()
        said.update(idle_with_alarm())
        expect(page.locator("#doing")).to_have_text("Not ready: an alarm is open")
        expect(page.locator("#state")).to_have_attribute("data-look", "fault")
        expect(page.locator("#reset")).to_be_visible()
        said.update(unproved_status())
        expect(page.locator("#state .word")).to_have_text("Not ready")
        expect(page.locator("#doing")).to_have_text("Not ready: unproved table active (bank 2)")


def test_what_cannot_be_read_is_not_known_on_the_page(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        said.update(status(RunState.IDLE))
        expect(page.locator("#tiles")).to_contain_text("bank 2 active")
        expect(page.locator("#tiles")).to_contain_text("read 59 min ago")
        expect(page.locator("#links [data-look=fault]")).to_have_text("mount: no answer")
        said.update({"active_bank": None, "ve_now_um": None, "read_problem": "no answer", "read_age_s": 42.0})
        expect(page.locator("#tiles")).to_contain_text("not known")
        expect(page.locator("#tiles")).to_contain_text("read 42 s ago")
        expect(page.locator("#tiles dd").nth(1)).to_have_text("–")


def test_an_abort_that_is_not_answered_says_within_a_second_that_the_emergency_stop_is_the_way(
    chromium: Browser, house: Service
) -> None:
    """By the page's own clock, which the test moves."""
    with told(chromium, house) as (page, said):
        said.update(status(RunState.MEASURING))
        expect(page.locator("#state")).to_have_attribute("data-state", "measuring")
        silent: list[Route] = []
        page.route("**/api/abort", lambda route: silent.append(route))  # noqa: PLW0108  Playwright needs a function
        page.clock.install()
        page.clock.pause_at(page.evaluate("Date.now() + 30000"))
        with page.expect_request("**/api/abort"):
            page.click("#abort")
        expect(page.locator("#said")).to_have_text("Abort sent …")
        page.clock.run_for(999)
        expect(page.locator("#said")).to_contain_text("ABORT IS NOT CONFIRMED")
        expect(page.locator("#said")).to_contain_text("emergency stop")
        silent[0].fulfill(json={"taken": True})
        expect(page.locator("#said")).to_have_text("Abort requested.")


def answered_by_half(page: Page, path: str) -> None:
    """Let the first answer to `path` begin and not end: it fails when its request is dropped or `cutOff` is called."""
    page.evaluate(
        """path => {
          const whole = window.fetch;
          const half = (signal) => new ReadableStream({ start(content) {
            content.enqueue(new TextEncoder().encode('{"runs": ['));
            signal?.addEventListener("abort", () => content.error(signal.reason));
            window.cutOff = () => content.error(new TypeError("network error"));
            document.body.dataset.half = path;
          } });
          window.fetch = async (address, options = {}) => address === path && !document.body.dataset.half
            ? new Response(half(options.signal), { headers: { "content-type": "application/json" } })
            : whole(address, options);
        }""",
        path,
    )


def test_a_response_that_an_abort_cuts_off_in_its_middle_is_asked_for_again(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        answered_by_half(page, "/api/runs?limit=50")
        page.click("#tab-engineer")
        expect(page.locator("body")).to_have_attribute("data-half", re.compile("/api/"))
        page.keyboard.press("a")
        expect(page.locator("#said")).to_have_text("Abort requested.")
        expect(page.locator("#content")).not_to_be_empty()
        expect(page.locator("#content .busy")).to_have_count(0)


def test_an_abort_whose_answer_is_cut_off_is_not_confirmed(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        answered_by_half(page, "/api/abort")
        page.click("#abort")
        expect(page.locator("body")).to_have_attribute("data-half", re.compile("/api/"))
        page.evaluate("cutOff()")
        expect(page.locator("#said")).to_contain_text("ABORT IS NOT CONFIRMED")


def test_a_start_gives_a_sign_before_the_service_answers(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, _):
        waiting: list[Route] = []
        page.route("**/api/start", lambda route: waiting.append(route))  # noqa: PLW0108  Playwright needs a function
        page.click("#start")
        page.check("input[name=consent]")
        with page.expect_request("**/api/start"):
            page.click("dialog button[type=submit]")
        expect(page.locator("#said")).to_have_text("Start requested …")
        waiting[0].fulfill(json={"run_id": RUN}, status=202)
        expect(page.locator("#said")).to_have_text("Run started.")


def test_each_phase_has_its_name_progress_and_minutes_under_the_kind_of_run(chromium: Browser, house: Service) -> None:
    with told(chromium, house, "de") as (page, said):
        expect(page.locator("#phase")).to_be_hidden()
        started = {**status(RunState.PREFLIGHT), "fraction": 0.0, "minutes_left": None, "phase": PREFLIGHT}
        said.update({**started, "position_set": "S3", "phase_fraction": None, "simulated_steps": 0})
        expect(page.locator("#phase")).to_have_text("Vorabprüfung · Ablauf wird vorbereitet")
        said.update(simulated_steps=1400)
        bar = page.locator(".track.own")
        expect(page.locator("#kind")).to_have_text("Kalibrieren · S3")
        expect(page.locator("#phase")).to_have_text("Vorabprüfung · 1.400 Schritte simuliert")
        expect(bar).not_to_have_attribute("aria-valuenow", re.compile(".*"))
        expect(page.locator("#minutes-left")).to_be_hidden()
        said.update(phase_fraction=0.25, phase_minutes_left=0.15)
        expect(page.locator("#phase")).to_have_text("Vorabprüfung · 25 % · noch 9 s")
        expect(bar).to_have_attribute("aria-valuenow", "25")

        step = "probe/station-2/az0-el45/ball-00/qualify/touch-3/above"
        checking = {**status(RunState.MEASURING), "step": step, "fraction": 0.012, "minutes_left": 63.2}
        said.update({**checking, "phase": "qualification", "phase_fraction": 0.6, "phase_minutes_left": 0.25})
        expect(page.locator("#doing")).to_contain_text("Taststift wird eingemessen: Station 2")
        expect(page.locator("#phase")).to_have_text("Einmessen · 60 % · noch 15 s")
        expect(page.locator("#minutes-left")).to_have_text("noch 64 min")
        expect(page.locator("#kind")).to_have_text("Kalibrieren · S3")
        said.update(phase="measuring", phase_fraction=0.0, phase_minutes_left=54.4)
        expect(page.locator("#doing")).to_contain_text("Messung läuft: Station 2")
        expect(page.locator("#phase")).to_have_text("Positionssatz · 0 % · noch 55 min")
        said.update(status(RunState.VERIFYING), phase="verification", phase_fraction=0.5, phase_minutes_left=4.0)
        expect(page.locator("#phase")).to_have_text("Verifizierung · 50 % · noch 4 min")


def test_the_picture_follows_the_probe_and_tells_it_in_words(chromium: Browser, house: Service) -> None:
    picture = "document.querySelector('.stage canvas').toDataURL()"
    with told(chromium, house) as (page, said):
        expect(page.locator(".stage-note")).to_have_text("")
        expect(page.locator("#scene-text")).to_contain_text("not being moved by a run")
        expect(page.locator("#axes")).to_be_empty()
        step = "measure/station-1/az45-el0/ball-03/touch-2"
        said.update(status(RunState.MEASURING), step=step, axis_mm=[912.0, 567.125, 962.5])
        expect(page.locator("#axes")).to_have_text("X 912.0  Y 567.1  Z 962.5 mm")
        words = page.locator("#scene-text")
        expect(words).to_contain_text("station 1, azimuth 45°, elevation 0°. 0 of 11 balls measured")
        expect(words).to_contain_text("Next: ball 3. X 912.0")
        before = page.evaluate(picture)
        said.update(axis_mm=[1912.0, 567.125, 962.5])
        page.wait_for_function(f"before => {picture} !== before", arg=before)
        expect(words).to_contain_text("X 1,912.0")
        far = page.evaluate(picture)
        page.click("#closer")
        page.wait_for_function(f"before => {picture} !== before", arg=far)
        expect(page.locator("#closer")).to_have_attribute("aria-pressed", "true")


def test_a_drawn_scene_has_no_message_over_it_while_the_next_plan_is_computed(
    chromium: Browser, house: Service
) -> None:
    """The plans are kept back, so that each moment of the page lasts as long as the test looks at it."""
    with told(chromium, house) as (page, said):
        kept: list[Route] = []

        def keep(route: Route) -> None:
            kept.append(route)

        page.goto("about:blank")  # nothing that was asked before is answered any more
        page.route("**/api/plan", keep)
        page.goto(house.url)
        note = page.locator(".stage-note")
        expect(note).to_have_text("Computing the path …")
        for route in kept:
            route.continue_()
        expect(note).to_have_text("")
        kept.clear()
        with page.expect_request("**/api/plan"):
            said.update(status(RunState.MEASURING))
        expect(page.locator("#state")).to_have_attribute("data-state", "measuring")
        expect(note).to_have_text("")


def test_the_last_run_is_asked_for_again_if_the_service_did_not_answer(chromium: Browser, house: Service) -> None:
    with told(chromium, house) as (page, said):
        run = {**RUN_SUMMARY, "verdict": VERDICTS[0].as_json()}
        refused: list[Route] = []

        def answer(route: Route) -> None:
            if not refused:
                refused.append(route)
                route.abort()
            else:
                route.fulfill(json={"runs": [run], "before": None})

        page.route("**/api/runs?limit=1", answer)
        said.update({**status(RunState.COMPLETE), "verdict": VERDICTS[0].as_json()})
        expect(page.locator("#result")).to_contain_text("12.34")
        assert len(refused) == 1
