"""Endpoints of the set-up page: token, bad bodies, bad values, and a directory that is written whole or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from httpx import Client

from agent.errors import Aborted
from agent.planning.new_machine.fields import FIELDS, option_texts
from agent.runs import new_machine_files
from agent.service.daemon.serve_setup import serve_setup
from agent.service.http.endpoint import HttpServer
from agent.service.page.setup_app import create_setup_app
from agent.service.setup.session import SetupSession
from agent.settings.service import ServiceSettings
from drivers import registry
from drivers.errors import LinkLost
from drivers.roles import AxisLimits, ProbeStatus, Vector

MILL = {"machine_class": "mill", "travel": "800 500 400"}
WRITING = ("answers", "connect", "jog", "seen", "touch", "touched", "review", "write", "finish")
LIMITS = AxisLimits((0.0, 0.0, 0.0), (700.0, 500.0, 400.0), (100.0, 100.0, float("nan")), (2000.0, 2000.0, 2000.0))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SetupSession]:
    session = SetupSession(tmp_path_factory.mktemp("setup") / "mine", {}, force=False)
    yield session
    session.close()


@pytest.fixture(scope="module")
def served(session: SetupSession) -> Iterator[str]:
    server = HttpServer(ServiceSettings(port=0))
    server.serve(create_setup_app(session))
    yield server.url
    server.shut_down()


@pytest.fixture
def client(session: SetupSession, served: str) -> Iterator[Client]:
    """With the token, before nothing is stated."""
    session.state(dict.fromkeys(FIELDS, ""))
    headers = {"Authorization": f"Bearer {session.token}"}
    with Client(base_url=served, headers=headers, timeout=600.0, trust_env=False) as client:
        yield client


def stated(client: Client, **texts: str) -> dict[str, Any]:
    answer = client.post("/api/setup/answers", json={"answers": texts})
    assert answer.status_code == 200, answer.text
    document: dict[str, Any] = answer.json()
    return document


@pytest.mark.parametrize("path", WRITING)
@pytest.mark.parametrize(("header", "status"), [({}, 401), ({"Authorization": "Bearer wrong"}, 403)])
def test_what_states_connects_or_writes_needs_the_token(
    client: Client, path: str, header: dict[str, str], status: int
) -> None:
    client.headers.pop("Authorization")
    assert client.post(f"/api/setup/{path}", json={}, headers=header).status_code == status


def test_a_foreign_host_or_page_is_refused(client: Client) -> None:
    assert client.get("/api/setup", headers={"Host": "example.org"}).status_code == 421
    assert client.get("/api/setup", headers={"Origin": "http://example.org"}).status_code == 403


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("answers", {}),
        ("answers", {"answers": {"name": 3}}),
        ("answers", {"answers": {"name": "x" * 1000}}),
        ("answers", {"answers": {"nonsense": "x"}}),
        ("answers", {"answers": [], "more": 1}),
        ("jog", {"axis": "A"}),
        ("seen", {"direction": "up", "part": "tool"}),
        ("touched", {"by_hand": "yes"}),
    ],
)
def test_a_bad_body_is_a_problem_document(client: Client, path: str, body: Any) -> None:
    answer = client.post(f"/api/setup/{path}", json=body)
    assert answer.status_code == 422
    assert answer.json()["where"]["key"]


def test_a_body_that_is_no_json_is_a_bad_request(client: Client) -> None:
    headers = {"content-type": "application/json"}
    assert client.post("/api/setup/answers", content=b"{", headers=headers).status_code == 400


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("machine_class", "lathe", "one of mill"),
        ("controller", "mill", "one of simulated"),
        ("travel", "800 500 4", "not a travel between"),
        ("travel", "800 500 high", "'high' is not a travel"),
        ("rapid", "1 2", "three numbers"),
        ("chain", "tool-Z-bed-X-workpiece", "axis Y is missing"),
        ("spindle", "-W", "one of"),
        ("stylus", "-5", "not a length"),
        ("stem", "-5", "must be positive"),
        ("probe_diameter", "140", "need"),
        ("tip_diameter", "0", "must be positive"),
        ("artefact", "nowhere.toml", "no such file"),
        ("balls", "1", "from 2 to 99"),
        ("stations", "0", "from 1 to 20"),
        ("touches", "6", "one of 5"),
    ],
)
def test_a_bad_value_is_told_at_its_field(client: Client, name: str, text: str, words: str) -> None:
    document = stated(client, **{**MILL, name: text})
    problem = document["problems"].get(name) or document["problems"].get("", {})
    assert words in f"{problem.get('detail')} {problem.get('hint')}", document["problems"]
    assert stated(client, **MILL, **({} if name in MILL else {name: ""}))["problems"] == {}


@pytest.mark.parametrize(
    ("name", "text", "boxes"),
    [
        ("travel", "0:-500 500 400", {("X-lowest", "order"), ("X-highest", "order")}),
        ("travel", "800 0:high 400", {("Y-highest", "number")}),
        (
            "travel",
            "800 low:? 4",
            {("Y-lowest", "number"), ("Y-highest", "empty"), ("Z-lowest", "length"), ("Z-highest", "length")},
        ),
        ("rapid", "1000 fast 1000", {("Y", "number")}),
        ("feed", "1000 1000 -3", {("Z", "positive")}),
        ("mount_at", "4000 250 -30", {("X", "field_mount_at")}),
        ("stylus", "-5", {("", "positive")}),
        ("shaft", "-5", {("", "least")}),
        ("stations", "40", {("", "between")}),
        ("stations", "2.5", {("", "whole")}),
        ("chain", "tool-Z-bed-X-workpiece", set()),
    ],
)
def test_a_problem_names_the_boxes_that_are_wrong(
    client: Client, name: str, text: str, boxes: set[tuple[str, str]]
) -> None:
    problem = stated(client, **{**MILL, name: text})["problems"][name]
    assert {(box["box"], box["word"]) for box in problem["boxes"]} == boxes


def test_every_wrong_field_is_told_at_once(client: Client) -> None:
    document = stated(client, machine_class="mill", travel="800 abc 400", feed="1000 -3 1000", stations="0")
    assert set(document["problems"]) == {"travel", "feed", "stations"}
    assert document["missing"] is None


def test_what_is_needed_depends_on_the_controller(client: Client) -> None:
    assert stated(client)["needed"] == ["machine_class", "travel"]
    assert stated(client, controller="serial-cnc")["needed"] == ["machine_class", "address", "travel"]
    assert stated(client, controller="linuxcnc")["needed"] == ["machine_class", "travel"]


def test_a_controller_without_its_address_asks_for_it(client: Client) -> None:
    assert stated(client, machine_class="mill", controller="modbus-cnc")["missing"] == "address"
    assert "HOST:PORT" in stated(client, address="plc:x")["problems"]["address"]["detail"]
    document = stated(client, address="127.0.0.1:1")
    assert (document["problems"], document["missing"]) == ({}, "travel")
    assert client.post("/api/setup/connect").status_code == 503
    assert client.get("/api/setup/look").status_code == 503


def test_the_simulated_controller_cannot_be_read(client: Client) -> None:
    assert client.post("/api/setup/connect").status_code == 422


def test_first_the_class_is_missing_then_the_travel_then_everything_is_proposed(client: Client) -> None:
    assert client.get("/api/setup").json()["missing"] == "machine_class"
    assert stated(client, machine_class="mill")["missing"] == "travel"
    document = stated(client, travel="800 500 400")
    assert document["missing"] is None
    proposals = document["proposals"]
    without = {"address", "artefact", "certified_length", "length_uncertainty", "position_set", "touches"}
    assert set(proposals) >= set(FIELDS) - without
    assert proposals["chain"] == "tool-Z-bed-Y-X-workpiece"
    stated(client, **{name: proposals[name] for name in ("rapid", "mount_at", "travel", "spindle", "balls", "stylus")})
    assert client.get("/api/setup").json()["problems"] == {}


def test_the_files_of_reviewed_answers_are_written_once_and_whole(
    client: Client, session: SetupSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert client.post("/api/setup/write").status_code == 422
    assert client.post("/api/setup/review").status_code == 422
    positions = session.directory.parent / "short.csv"
    rows = [
        f"{station},{angles}" for station in (1, 2) for angles in ("45,0", "-45,0", "0,45", "0,-45", "90,45", "90,-45")
    ]
    positions.write_text("\n".join(["station,azimuth_deg,elevation_deg", *rows, ""]))
    stated(client, **MILL, stations="2", position_set=str(positions), touches="5")
    review = client.post("/api/setup/review").json()["review"]
    assert set(review["texts"]) == {"machine.toml", "artefact.toml", "volcal.toml", "simulator.toml"}
    assert client.get(f"/api/setup/preview/{review['preview'][0]}").status_code == 200
    assert client.get("/api/setup/preview/volcal.toml").status_code == 404
    assert not session.directory.exists()

    def full(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(new_machine_files, "write_all_atomically", full)
        assert client.post("/api/setup/write").status_code == 500
    assert not session.directory.exists()
    session.directory.mkdir()
    (session.directory / "volcal.toml").write_text("of somebody else\n")
    assert "--force" in client.post("/api/setup/write").json()["hint"]
    assert (session.directory / "volcal.toml").read_text() == "of somebody else\n"
    (session.directory / "volcal.toml").unlink()
    written = client.post("/api/setup/write").json()["written"]
    assert sorted(path.name for path in session.directory.iterdir()) == sorted(
        ["preview", *(Path(path).name for path in written["files"])]
    )
    stated(client, name="Other")
    assert client.post("/api/setup/write").status_code == 422
    assert client.post("/api/setup/finish").status_code == 200
    assert session.finished.is_set()


def test_options_of_the_command_line_are_shown_as_they_were_stated() -> None:
    typed = {
        "machine_class": "mill",
        "travel": ("800", "-1:500", "400"),
        "rapid": (1e4, 2.5, 3.0),
        "touches": "9",
        "size": None,
        "stylus": 150.123456789012,
    }
    assert option_texts(typed) == {
        "machine_class": "mill",
        "travel": "800 -1:500 400",
        "rapid": "10000 2.5 3",
        "touches": "9",
        "stylus": "150.123456789012",
    }


def test_what_was_read_holds_until_another_controller_is_stated(
    client: Client, session: SetupSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    stated(client, machine_class="mill", controller="modbus-cnc", address="127.0.0.1:1")

    def connect(controller: Any) -> AxisLimits:
        session.watch.controller, session.watch.limits = controller, LIMITS
        return LIMITS

    monkeypatch.setattr(session.watch, "connect", connect)
    monkeypatch.setattr(session.watch, "limits", None)
    document = client.post("/api/setup/connect").json()
    assert document["reading"]["upper_mm"] == [700.0, 500.0, 400.0]
    assert document["reading"]["rapid_mm_per_min"] == [6000.0, 6000.0, None]
    assert document["proposals"]["travel"] == "0:700 0:500 0:400"
    assert document["proposals"]["rapid"] == "20000 20000 20000", "a value that is not reported is not read"
    assert stated(client, address="127.0.0.1:2")["reading"] is None


def test_a_set_up_that_is_ended_before_anything_was_written_is_aborted(tmp_path: Path) -> None:
    session = SetupSession(tmp_path / "mine", {}, force=False)
    said: list[str] = []

    def ready(url: str) -> None:
        said.append(url)
        session.finished.set()

    with pytest.raises(Aborted):
        serve_setup(session, 0, ready)
    assert said[0].endswith(f"/#token={session.token}")
    assert list(tmp_path.iterdir()) == []


class Panel:
    """Controller whose axes and probe a person moves by hand."""

    def __init__(self) -> None:
        self.at = np.zeros(3)
        self.deflected = self.gone = self.closed = False

    def open(self) -> None: ...

    def close(self) -> None:
        self.closed = True

    def limits(self) -> AxisLimits:
        return LIMITS

    def position(self) -> Vector:
        if self.gone:
            raise LinkLost("the controller is gone")
        return self.at.copy()

    def probe_status(self) -> ProbeStatus:
        return ProbeStatus(loaded=True, healthy=True, deflected=self.deflected)

    def __getattr__(self, name: str) -> Any:
        """Whatever else a machine or probe can do, such as a motion, is not asked of it."""
        if name in {"status", "move_to", "hold", "resume", "reset", "stop", "touch_towards", "diagnose"}:
            return self._refused
        raise AttributeError(name)

    @staticmethod
    def _refused(*_: Any, **__: Any) -> None:
        raise AssertionError("the set-up commands nothing")


@pytest.fixture
def panel(client: Client, session: SetupSession, monkeypatch: pytest.MonkeyPatch) -> Iterator[Panel]:
    made = Panel()
    monkeypatch.setattr(registry, "create_device", lambda *_: made)
    stated(client, **MILL, controller="modbus-cnc", address="127.0.0.1:1")
    assert client.post("/api/setup/connect").json()["connected"]
    yield made
    session.watch.close()
    assert made.closed


def jogged(client: Client, panel: Panel, axis: str, way: tuple[float, float, float], **saw: str) -> dict[str, Any]:
    assert client.post("/api/setup/jog", json={"axis": axis}).json()["moved"] == []
    panel.at = panel.at + way
    seen = {"direction": "as drawn", "part": "workpiece", **saw}
    answer = client.post("/api/setup/seen", json=seen)
    assert answer.status_code == 200, answer.text
    document: dict[str, Any] = answer.json()
    return document


def test_a_jog_is_judged_against_the_chain_and_a_wrong_axis_stops_the_writing(client: Client, panel: Panel) -> None:
    assert jogged(client, panel, "X", (0.0, 5.0, 0.0))["axes"]["X"]["finding"] == "other axis"
    answer = client.post("/api/setup/write")
    assert answer.json()["where"] == {"axis": "X"}
    assert jogged(client, panel, "X", (-5.0, 0.0, 0.0))["axes"]["X"]["finding"] == "good"
    assert stated(client, chain="tool-Z-X-bed-Y-workpiece")["axes"]["X"]["finding"] == "wrong side"
    assert client.post("/api/setup/write").json()["where"] == {"axis": "X"}
    assert stated(client, chain="")["axes"]["X"]["finding"] == "good"
    assert "reviewed" in client.post("/api/setup/write").json()["detail"]


def test_nothing_is_judged_before_an_axis_has_moved(client: Client, panel: Panel) -> None:
    saw = {"direction": "as drawn", "part": "tool"}
    assert client.post("/api/setup/seen", json=saw).status_code == 422
    client.post("/api/setup/jog", json={"axis": "Z"})
    panel.at = np.array([0.0, 0.0, 0.5])
    assert client.get("/api/setup/look").json()["moved"] == []
    assert "1 mm" in client.post("/api/setup/seen", json=saw).json()["hint"]


def test_an_input_that_is_always_on_stops_the_writing_and_a_finger_is_seen(client: Client, panel: Panel) -> None:
    panel.deflected = True
    assert client.post("/api/setup/touch").json() == {"finding": "always on"}
    assert "always on" in client.post("/api/setup/write").json()["detail"]
    found = []
    for panel.deflected in (False, True, False):
        found.append(client.get("/api/setup/probe").json()["finding"])
    assert found == ["waiting", "held", "good"]


def test_a_person_can_state_the_touch_by_finger(client: Client) -> None:
    assert client.post("/api/setup/touched", json={"by_hand": True}).json()["probe"]["by_hand"] is True
    assert client.post("/api/setup/touched", json={"by_hand": False}).json()["probe"]["by_hand"] is False


def test_a_controller_that_is_lost_leaves_what_was_read(client: Client, panel: Panel) -> None:
    panel.gone = True
    answer = client.get("/api/setup/look")
    assert answer.status_code == 503
    document = client.get("/api/setup").json()
    assert (document["connected"], document["reading"] is None) == (False, False)
    panel.gone = False
    assert client.post("/api/setup/connect").json()["connected"]
