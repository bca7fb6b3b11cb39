"""Page whose service states what the test puts into its status: every state and end of a run, all that may be open."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from panel_pages import at_rest, opened, with_token
from playwright.sync_api import Browser, Page, Route, expect
from service_process import Service

from agent.execution.states import PACKML, RunState
from agent.planning.run_phases import MOVING_PHASES, PREFLIGHT
from agent.results.run_verdict import VERDICTS
from agent.runs.unproved_table import UnprovedTable
from agent.service.allowed_requests import AT_REST, allowed_in

NO_EVENTS = "retry: 3600000\n\n"
RUN = "20261128T010000Z-abcd"
ALARM = {
    "code": 431,
    "text": "ball 3 of station 2 has moved by 0.412 mm during the interruption, at most 0.050 mm are allowed",
    "hint": "check the clamping of artefact and mount; resume the run: the position is measured again",
    "where": {"device": "cnc", "step": "station-2/az090-el045/ball-03/touch-2"},
}
TABLE = UnprovedTable(RUN, 2, 1, provable=True)
RUN_SUMMARY = {
    "run_id": RUN, "kind": "calibrate", "started": "2026-11-28T01:00:00Z", "ended": "2026-11-28T02:00:00Z",
    "state": "complete", "reason": None, "software": "1", "balls": 264, "touches": 2000, "machine_minutes": 64.0,
    "ve_um": 31.63, "vce_um": 12.34, "held_out_before_um": 20.0, "held_out_after_um": 3.0, "report": False,
}  # fmt: skip
QUESTION = {"number": 3, "text": "carry the artefact", "station": 2, "placement": None}
RECEIVERS = [
    {"channel": "mqtt", "waiting": 0, "delivery": "delivers", "problem": "", "since": ""},
    {
        "channel": "mail",
        "waiting": 2,
        "delivery": "fails",
        "problem": "the receiver cannot be reached: no answer (receiver mail server mail.plant.example)",
        "since": "2026-11-28T03:15:00Z",
    },
]
LINKS = [{"device": "cnc", "ok": True, "problem": ""}, {"device": "mount", "ok": False, "problem": "no answer"}]


def views() -> Iterator[tuple[str, dict[str, Any]]]:
    """Status of every state, of every end of a run, and with all that may be open."""
    for state in RunState:
        yield state.value, status(state)
    for phase in MOVING_PHASES:
        yield phase, {**status(RunState.MEASURING), "phase": phase, "phase_fraction": 0.37, "phase_minutes_left": 0.6}
    simulating = {**status(RunState.PREFLIGHT), "phase": PREFLIGHT, "fraction": 0.0, "minutes_left": None}
    for fraction in (None, 0.5):
        yield f"preflight, {fraction}", {**simulating, "phase_fraction": fraction, "simulated_steps": 11400}
    for verdict in VERDICTS:
        yield verdict.name, {**status(RunState.COMPLETE), "verdict": verdict.as_json()}
    yield "question", {**status(RunState.HELD), "question": QUESTION}
    yield (
        "alarms",
        {**status(RunState.FAULTED, unfinished=True), "alarms": [ALARM, ALARM, ALARM], "receivers": RECEIVERS},
    )
    yield "alarm between runs", idle_with_alarm()
    yield "unfinished", {**status(RunState.IDLE, unfinished=True), "active_bank": None, "read_problem": "no answer"}
    yield "unproved", unproved_status()


def status(state: RunState, *, unfinished: bool = False) -> dict[str, Any]:
    may = allowed_in(state, unfinished=unfinished, question_open=False)
    return {
        "state": state.value,
        "packml": PACKML[state],
        "may": sorted(may),
        "kind": "calibrate",
        "run_id": None if state is RunState.IDLE else RUN,
        "step": "station-4/az270-el-45/ball-12/touch-2",
        "fraction": 0.4,
        "minutes_left": None if state in AT_REST else 31.0,
        "balls": 264,
        "ve_before_um": 31.63,
        "ve_now_um": 10.84,
        "active_bank": 2,
        "read_age_s": 3599.0,
        "links": LINKS,
        "unfinished": RUN if unfinished else None,
        "alarms": [ALARM] if state in (RunState.FAULTED, RunState.ABORTED) else [],
        "event": 10**15,
    }


def idle_with_alarm() -> dict[str, Any]:
    may = sorted(allowed_in(RunState.IDLE, unfinished=False, question_open=False, alarm_open=True))
    return {**status(RunState.IDLE), "alarms": [ALARM], "may": may}


def unproved_status() -> dict[str, Any]:
    unproved = {**vars(TABLE), "situation": TABLE.situation, "way_out": TABLE.way_out}
    may = sorted(allowed_in(RunState.WRITTEN, unfinished=True, question_open=False, unproved=True))
    return {**status(RunState.WRITTEN, unfinished=True), "unproved": unproved, "may": may}


@contextmanager
def told(chromium: Browser, house: Service, locale: str = "en") -> Iterator[tuple[Page, dict[str, Any]]]:
    """Page whose service states what the test puts into the yielded document."""
    at_rest(house)
    said: dict[str, Any] = {}

    def answer(route: Route) -> None:
        response = route.fetch()
        route.fulfill(response=response, json={**response.json(), **said})

    for page in opened(chromium, house, locale=locale):
        with_token(page, house)
        page.route("**/api/status", answer)
        # the stream begins with the status of the service itself
        page.route("**/api/events", lambda route: route.fulfill(content_type="text/event-stream", body=NO_EVENTS))
        page.reload()
        expect(page.locator("#doing")).not_to_be_empty()
        yield page, said
        page.unroute_all(behavior="ignoreErrors")  # the page asks for the status until it is closed
