"""Metrics over a real socket, while the database of the history cannot be reached."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit" / "agent"))

from fake_control import FakeControl
from journaled import journaled
from service_house import settings_document
from structlog.testing import capture_logs

from agent.history.database_url import FILE_NAME
from agent.service.http.app import create_app
from agent.service.http.app_state import AppState
from agent.service.http.endpoint import HttpServer
from agent.service.http.metrics import mount_metrics
from agent.service.state.archive import Archive
from agent.service.state.event_log import EventLog
from agent.settings.schema import Settings
from agent.settings.service import ServiceSettings


@contextmanager
def metrics_of(state: Path, control: FakeControl) -> Iterator[httpx.Client]:
    settings = Settings.model_validate(settings_document(state, history={"machine": "mine"}))
    event_log, unused = EventLog(), None
    archive = Archive(state, lambda run: state / run)
    places: Any = (unused, lambda: settings, state / "volcal.toml", "secret")
    server = HttpServer(ServiceSettings(port=0))
    app = create_app(AppState(control, event_log, archive, *places), extensions=(mount_metrics,))
    server.serve(app)
    try:
        with httpx.Client(base_url=server.url, timeout=600.0, trust_env=False) as client:
            yield client
    finally:
        event_log.close()
        server.shut_down()


def test_open_alarms_are_told_while_the_history_cannot_be_read(tmp_path: Path) -> None:
    journaled(tmp_path, 0, machine="mine")
    control = FakeControl()
    control.fault()
    history = tmp_path / FILE_NAME
    history.mkdir()
    with metrics_of(tmp_path, control) as client, capture_logs() as logs:
        without = client.get("/metrics")
        assert without.status_code == 200, without.text
        lines = without.text.splitlines()
        assert 'volcal_alarms_open{machine="mine"} 1.0' in lines
        assert 'volcal_history_readable{machine="mine"} 0.0' in lines
        assert "volcal_last_run_timestamp_seconds" not in without.text
        assert client.get("/metrics").status_code == 200
        assert [one["event"] for one in logs if "history" in one["event"]] == ["metrics without the history"]
        history.rmdir()
        lines = client.get("/metrics").text.splitlines()
        assert 'volcal_history_readable{machine="mine"} 1.0' in lines
        assert 'volcal_runs{kind="calibrate",machine="mine",state="complete"} 1.0' in lines
