"""Each request with each token over a real socket: who may send it, what a refusal says, and whose name is recorded."""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fake_control import FakeControl
from httpx import Client
from structlog.testing import capture_logs
from waiting import PATIENCE_S

from agent.execution.states import RunState
from agent.service.access.access import Access
from agent.service.access.paired_clients import PairedClients
from agent.service.access.pairing_codes import MAX_TRIES_PER_MINUTE, PairingCodes
from agent.service.address_file import MACHINE_HEADER, machine_header
from agent.service.http.app import create_app
from agent.service.http.app_state import AppState
from agent.service.http.description import openapi_document
from agent.service.http.endpoint import HttpServer
from agent.service.page.static_files import mount_page
from agent.service.state.event_log import EventLog
from agent.settings.load import read_settings
from agent.settings.service import ServiceSettings
from drivers.clock import VirtualClock

CASE_STUDY = Path(__file__).resolve().parents[2] / "config" / "case-study.toml"
MACHINE_TOKEN = secrets.token_urlsafe(32)
RESTORE = {"run_id": "20261129T010000Z-abcd", "role": "backup"}

LEAST: dict[tuple[str, str], tuple[str, Any]] = {
    ("POST", "/api/start"): ("operator", {"kind": "calibrate", "consent": True}),
    ("POST", "/api/resume-run"): ("operator", None),
    ("POST", "/api/hold"): ("operator", None),
    ("POST", "/api/resume"): ("operator", None),
    ("POST", "/api/reset"): ("operator", None),
    ("POST", "/api/answer"): ("operator", {"number": 1, "yes": True}),
    ("POST", "/api/unproved-table/restore"): ("operator", None),
    ("POST", "/api/give-up-run"): ("operator", None),
    ("GET", "/api/access"): ("operator", None),
    ("POST", "/api/tables/restore"): ("engineer", RESTORE),
    ("POST", "/api/settings/check"): ("engineer", {"toml": ""}),
    ("GET", "/api/diagnostics"): ("engineer", None),
    ("POST", "/api/pairing/code"): ("machine", {"role": "engineer"}),
    ("GET", "/api/pairing/clients"): ("machine", None),
    ("POST", "/api/pairing/revoke"): ("machine", {"name": "nobody"}),
}
"""Every request that needs a token, with who may send it at least, and a body."""
GRADES = ("nobody", "operator", "engineer", "machine")


class House:
    """Service with a control that does nothing, and one token of each kind."""

    def __init__(self, directory: Path) -> None:
        self.control, self.clock = FakeControl(), VirtualClock()
        self.access = Access(MACHINE_TOKEN, PairedClients(directory), PairingCodes(self.clock.now))
        self.tokens = {"nobody": "a token that nobody has", "machine": MACHINE_TOKEN}
        for role in ("operator", "engineer"):
            self.tokens[role] = self.access.clients.add(f"{role} at the gate", role)
        settings = read_settings(CASE_STUDY).model_copy(update={"state_directory": directory})
        unused: Any = None
        state = AppState(self.control, EventLog(), unused, unused, lambda: settings, CASE_STUDY, self.access)
        self.server = HttpServer(ServiceSettings(port=0))
        self.server.serve(create_app(state, extensions=[mount_page]))

    def client(self, who: str | None) -> Client:
        headers = {} if who is None else {"Authorization": f"Bearer {self.tokens[who]}"}
        return Client(base_url=self.server.url, headers=headers, timeout=PATIENCE_S, trust_env=False)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[House]:
    house = House(tmp_path_factory.mktemp("state"))
    yield house
    house.server.shut_down()


@pytest.fixture(autouse=True)
def anew(house: House) -> None:
    house.control.begin_anew()
    house.clock.sleep(3600.0)  # former tries and codes are forgotten


def test_the_table_of_requests_is_complete() -> None:
    guarded = {
        (method.upper(), path)
        for path, entry in openapi_document()["paths"].items()
        for method, operation in entry.items()
        if operation.get("security")
    }
    assert guarded == set(LEAST)


def test_a_client_that_means_another_machine_can_only_stop_this_one(house: House, tmp_path: Path) -> None:
    other, own = tmp_path / "täble.toml", read_settings(CASE_STUDY).machine
    for (method, path), (_, body) in (LEAST | {("GET", "/api/status"): ("nobody", None)}).items():
        house.control.begin_anew()
        with house.client("machine") as client:
            refused = client.request(method, path, json=body, headers={MACHINE_HEADER: machine_header(other)})
            assert (refused.status_code == 409) is (path != "/api/hold"), path
            if path != "/api/hold":
                assert f"works for the machine in {own}, not for that in {other}" in refused.json()["detail"]
                assert refused.json()["title"] == "ConfigurationError"
            meant = client.request(method, path, json=body, headers={MACHINE_HEADER: machine_header(own)})
            assert "works for the machine in" not in meant.text
    with house.client(None) as client:
        assert client.post("/api/abort", headers={MACHINE_HEADER: machine_header(other)}).status_code == 200


def test_each_request_with_each_token(house: House) -> None:
    for (method, path), (least, body) in LEAST.items():
        with house.client(None) as stranger:
            answer = stranger.request(method, path, json=body)
        assert answer.status_code == 401, path
        assert answer.headers["www-authenticate"] == "Bearer"
        for who in GRADES:
            house.control.begin_anew()
            with house.client(who) as client:
                answer = client.request(method, path, json=body)
            if GRADES.index(who) >= GRADES.index(least):
                assert answer.status_code not in (401, 403, 500), (path, who, answer.text)
                continue
            assert answer.status_code == 403, (path, who)
            assert answer.headers["content-type"] == "application/problem+json"
            assert house.control.asked == [], (path, who)
            problem = answer.json()
            if who == "nobody":
                assert problem["detail"] == "the token is wrong"
            else:
                assert problem["title"] == "RoleRefused"
                needed = "the token of the machine" if least == "machine" else f"the role {least}"
                assert problem["detail"] == f"this request needs {needed}; {who} at the gate was paired as {who}"
                assert problem["hint"]


def test_what_a_client_may_send_is_told_and_its_name_is_recorded(house: House) -> None:
    with house.client("operator") as client:
        told = client.get("/api/access").json()
        assert (told["role"], told["name"]) == ("operator", "operator at the gate")
        assert "start" in told["may"]
        assert "restore_table" not in told["may"]
        client.post("/api/start", json={"kind": "calibrate", "consent": True})
        assert house.control.by == "operator at the gate"
        client.post("/api/abort", json={"reason": "a chip"})
    assert house.control.asked[-1] == ("abort", "a chip (operator at the gate)")
    with house.client("machine") as client:
        assert client.get("/api/access").json()["name"] == ""
        client.post("/api/reset")
        assert house.control.by == ""
    for stranger in (None, "nobody"):
        with house.client(stranger) as client:
            assert client.post("/api/abort", json={"reason": "a chip"}).status_code == 200
        assert house.control.asked[-1] == ("abort", "a chip")


def test_the_settings_are_shown_to_engineers_without_secrets(house: House) -> None:
    for who, status in ((None, 401), ("nobody", 403), ("operator", 403), ("engineer", 200)):
        with house.client(who) as client:
            answer = client.get("/api/page/settings")
        assert answer.status_code == status
    rows = {row["key"]: row for row in answer.json()["rows"]}
    assert answer.json()["file"] == CASE_STUDY.name
    assert (rows["tool"]["now"], rows["procedure.touches_per_ball"]["now"]) == ("probe", 5)


def test_a_code_becomes_a_token_once_and_neither_is_logged(house: House) -> None:
    with capture_logs() as logs, house.client("machine") as machine, house.client(None) as phone:
        made = machine.post("/api/pairing/code", json={"role": "operator", "name": "phone", "minutes": 2}).json()
        assert (made["role"], made["name"]) == ("operator", "phone")
        assert made["address"] == f"{house.server.url}/#pair={made['code']}"
        assert made["picture"].startswith("data:image/svg+xml")
        assert not made["reachable"]
        paired = phone.post("/api/pair", json={"code": made["code"]}).json()
        assert (paired["role"], paired["name"]) == ("operator", "phone")
        again = phone.post("/api/pair", json={"code": made["code"]})
        assert (again.status_code, again.json()["title"]) == (403, "WrongCode")
        assert "volcal pair" in again.json()["hint"]
        authorized = {"Authorization": f"Bearer {paired['token']}"}
        assert phone.get("/api/access", headers=authorized).json()["name"] == "phone"
        assert phone.post("/api/hold", headers=authorized).status_code == 200
        listed = machine.get("/api/pairing/clients").json()["clients"]
        assert [client["name"] for client in listed][-1] == "phone"
        assert set(listed[-1]) == {"name", "role", "paired"}
        assert machine.post("/api/pairing/revoke", json={"name": "phone"}).status_code == 200
        assert phone.post("/api/hold", headers=authorized).status_code == 403
    written = json.dumps(logs)
    assert "pairing refused" in written
    assert made["code"] not in written
    assert paired["token"] not in written


def test_tries_are_bounded_for_all_clients_together(house: House) -> None:
    with house.client("machine") as machine, house.client(None) as guesser, house.client(None) as phone:
        for _ in range(MAX_TRIES_PER_MINUTE):
            assert guesser.post("/api/pair", json={"code": "000000"}).status_code == 403
        code = machine.post("/api/pairing/code").json()["code"]
        refused = phone.post("/api/pair", json={"code": code})
        assert refused.status_code == 429
        assert 0 < int(refused.headers["retry-after"]) <= 60
        house.clock.sleep(int(refused.headers["retry-after"]))
        assert phone.post("/api/pair", json={"code": code}).status_code == 200


@pytest.mark.parametrize(
    "body",
    [None, {}, {"code": "12345"}, {"code": "1234567"}, {"code": "12345a"}, {"code": "١٢٣٤٥٦"}, {"code": 123456}],
)
def test_what_is_no_code_is_refused_and_counts_as_no_try(house: House, body: Any) -> None:
    with house.client(None) as phone:
        for _ in range(MAX_TRIES_PER_MINUTE + 1):
            assert phone.post("/api/pair", json=body).status_code == 422


@pytest.mark.parametrize(
    ("path", "body", "key"),
    [
        ("code", {"name": ""}, "name"),
        ("code", {"name": "x" * 41}, "name"),
        ("code", {"name": "operator at the gate"}, "name"),
        ("code", {"minutes": 0}, "minutes"),
        ("code", {"minutes": 61}, "minutes"),
        ("code", {"role": "king"}, "role"),
        ("revoke", {"name": ""}, "name"),
    ],
)
def test_a_wrong_value_is_refused_with_its_key(house: House, path: str, body: Any, key: str) -> None:
    with house.client("machine") as machine:
        answer = machine.post(f"/api/pairing/{path}", json=body)
    assert answer.status_code == 422
    assert answer.json()["where"] == {"key": key}


def test_a_text_that_is_no_unicode_is_refused(house: House) -> None:
    with house.client("machine") as machine:
        for path in ("code", "revoke"):
            answer = machine.post(
                f"/api/pairing/{path}", content=b'{"name": "\\ud800"}', headers={"Content-Type": "application/json"}
            )
            assert answer.status_code == 422, answer.text
    assert house.control.status().state is RunState.IDLE
