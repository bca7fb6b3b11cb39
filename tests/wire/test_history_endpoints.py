"""Lists of runs and alarms over a real socket, from a real journal and a real history database."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import httpx
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit" / "agent"))

from fake_control import FakeControl
from journaled import journaled, run_id
from service_house import settings_document

from agent.execution.journal import Journal
from agent.execution.states import RunState
from agent.service.http.app import create_app
from agent.service.http.app_state import AppState
from agent.service.http.endpoint import HttpServer
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.settings.schema import Settings
from agent.settings.service import ServiceSettings
from drivers.clock import VirtualClock
from drivers.errors import LinkLost

ALARM = {"code": 430, "text": "the ball is dirty", "hint": "clean it", "where": {"device": "probe"}}
ENDS = [RunState.COMPLETE] * 5 + [RunState.FAULTED, RunState.ABORTED]


@pytest.fixture
def client(tmp_path: Path) -> Iterator[httpx.Client]:
    """Client of a service whose journal has a run in each of seven nights; the last two of them ended badly."""
    for night, end in enumerate(ENDS):
        journaled(tmp_path, night, machine="mine", ends=end)
    settings = Settings.model_validate(settings_document(tmp_path, history={"machine": "mine"}))
    event_log, unused = EventLog(), None
    archive = Archive(tmp_path, lambda run: tmp_path / run)
    places: Any = (unused, lambda: settings, tmp_path / "volcal.toml", "secret")
    server = HttpServer(ServiceSettings(port=0))
    server.serve(create_app(AppState(FakeControl(), event_log, archive, *places)))
    with httpx.Client(base_url=server.url, timeout=600.0, trust_env=False) as connected:
        yield connected
    event_log.close()
    server.shut_down()


def listed(client: httpx.Client, **query: Any) -> dict[str, Any]:
    answer = client.get("/api/history/runs", params=query)
    assert answer.status_code == 200, answer.text
    document: dict[str, Any] = answer.json()
    return document


def test_runs_are_selected_numbered_and_handed_out_page_by_page(client: httpx.Client, tmp_path: Path) -> None:
    def nights(**query: Any) -> list[int]:
        return [run["number"] - 1 for run in listed(client, **query)["runs"]]

    whole = listed(client)
    assert [run["run_id"] for run in whole["runs"]] == [run_id(night) for night in reversed(range(7))]
    assert (whole["total"], whole["kinds"]) == (7, {"calibrate": 7})
    assert whole["verdicts"] == {"accepted": 5, "faulted": 1, "aborted": 1}
    first = whole["runs"][-1]
    assert (first["started"], first["verdict"]["name"], first["report"]) == (
        "2026-11-01T02:00:00.000Z",
        "accepted",
        True,
    )
    assert (first["ve_um"], first["vce_um"], first["machine_minutes"]) == (10.0, 10.0, 83.5)
    assert (first["held_out_before_um"], first["held_out_after_um"]) == (3.5, 2.5)
    assert nights(limit=3) == [6, 5, 4]
    assert nights(limit=3, offset=3) == [3, 2, 1]
    assert nights(verdict="faulted") == [5]
    assert nights(verdict=["faulted", "aborted"]) == [6, 5]
    assert nights(verdict="refused") == nights(kind="verify") == nights(text="100%") == []
    assert nights(kind=["verify", "calibrate"], verdict="accepted", limit=1) == [4]
    assert nights(since="2026-11-03T03:00:00+01:00", until="2026-11-05T02:00:00Z") == [3, 2]
    assert nights(text="20261102t") == [1]
    assert listed(client, limit=1, verdict="accepted")["total"] == 5
    journaled(tmp_path, 7, machine="mine")
    assert nights(limit=2) == [7, 6]
    plant = client.get("/api/history/plant").json()
    assert (plant["machine"], plant["total"], [one["run_id"] for one in plant["machines"]]) == ("mine", 1, [run_id(7)])
    assert client.get("/api/history/plant", params={"offset": 1}).json()["machines"] == []
    for query in (
        {"limit": 201},
        {"offset": -1},
        {"since": "yesterday"},
        {"since": "2026-11-03"},
        {"since": "0001-01-01T00:00:00+14:00"},
        {"text": "x" * 101},
    ):
        refused = client.get("/api/history/runs", params=query)
        assert (refused.status_code, refused.json()["where"]["key"]) == (422, f"query.{next(iter(query))}"), query


def test_an_alarm_ends_with_the_reset_or_the_next_run(client: httpx.Client, tmp_path: Path) -> None:
    def alarms(**query: Any) -> list[dict[str, Any]]:
        answer = client.get("/api/history/alarms", params=query)
        assert answer.status_code == 200, answer.text
        found: list[dict[str, Any]] = answer.json()["alarms"]
        return found

    assert alarms() == []
    with closing(Journal(tmp_path)) as journal:
        journal.record_alarm(run_id(5), ALARM)
        run = journal.start_run("20261120T020000Z-0000", "verify", {}, "1", VirtualClock())
        run.fault(LinkLost("no answer"), "station-1/ball-02")
        run.state(RunState.FAULTED, "no answer", final=True)
    last, former = alarms()
    assert (former["run_id"], former["alarm"], former["until"]) == (run_id(5), ALARM, "2026-11-07T02:00:00.000Z")
    assert (last["kind"], last["alarm"]["code"], last["alarm"]["text"]) == ("verify", 311, "no answer")
    assert (last["alarm"]["where"], last["until"]) == ({"step": "station-1/ball-02"}, None)
    with closing(Journal(tmp_path)) as journal:
        journal.acknowledge(last["run_id"], {})
    closed, _ = alarms()
    assert closed["until"] > closed["since"]
    assert [one["run_id"] for one in alarms(limit=1, offset=1)] == [run_id(5)]
    with closing(Journal(tmp_path)) as journal:
        journal.record_alarm(last["run_id"], {"code": "none"})
    assert alarms(limit=1)[0]["alarm"]["code"] == 100
