"""Golden frames of the panel gateway, written byte for byte from the MODBUS documents and the register table."""

from __future__ import annotations

import pytest
from fake_control import FakeControl

from agent.errors import NotAllowedInState
from agent.execution.states import RunState
from agent.service.gateway.access import LOCKED_TICKS, AccessCode
from agent.service.gateway.command_handler import CommandHandler
from agent.service.gateway.frames import FramingError, answer_frame, answer_request, body_length
from agent.service.gateway.gateway import Gateway
from agent.service.gateway.heartbeat import Heartbeats
from agent.service.gateway.sequence_ledger import SequenceLedger
from agent.service.gateway.session import PanelSession

SILENCE = 3


@pytest.fixture
def control() -> FakeControl:
    return FakeControl()


@pytest.fixture
def gateway(control, tmp_path) -> Gateway:
    (tmp_path / "gateway-sequence.json").write_text('{"accepted": 41, "content": []}')
    access = AccessCode(0x00BC614E)
    return Gateway(
        control, CommandHandler(control, SequenceLedger(tmp_path), access), access, Heartbeats(SILENCE), "hold"
    )


@pytest.fixture
def ask(gateway):
    session = PanelSession(gateway)
    return lambda request: answer_request(bytes.fromhex(request), session).hex(" ")


START_S3 = (
    "10 00c8 001c 38"  # write 28 registers from 200 on, 56 bytes
    "0001 0001 0001 0000 0096 0002"  # start, calibrate, consent, full as set, 15.0 min, station 2
    "00000000 0000"  # no question, no answer
    "5333 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000"  # S3
    "00bc614e 002a"  # 12345678, sequence 42
)


def test_a_start_in_one_frame(ask, control):
    assert ask(START_S3) == "10 00 c8 00 1c"
    (_, request), *others = control.asked
    assert not others
    assert (request.kind, request.position_set, request.slot_minutes, request.stations, request.consent) == (
        "calibrate",
        "S3",
        15.0,
        [2],
        True,
    )
    assert ask("03 001c 0002") == "03 04 00 2a 00 01"
    assert ask(START_S3) == "10 00 c8 00 1c"
    assert len(control.asked) == 1


def test_status_in_one_frame(ask, control):
    control.now(RunState.HELD, kind="verify", fraction=0.5, minutes_left=1000.0, ve_now_um=-0.001)
    assert ask("03 0003 0003") == "03 06 00 03 00 0b 00 02"
    assert ask("04 0007 0003") == "04 06 13 88 00 01 86 a0"
    assert ask("03 000c 0002") == "03 04 ff ff ff ff"


def test_abort_in_one_frame(ask, control):
    assert ask("05 0000 ff00") == "05 00 00 ff 00"
    assert ask("0f 0000 0001 01 01") == "0f 00 00 00 01"
    assert [name for name, _ in control.asked] == ["abort", "abort"]
    assert ask("01 0000 0001") == "01 01 00"
    control.now(RunState.ABORTING)
    assert ask("01 0000 0001") == "01 01 01"


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("02 0000 0001", "82 01"),
        ("17 0000 0001 00c8 0001 02 0001", "97 01"),
        ("2b 0e 01 00", "ab 01"),
        ("08 0004 0000", "88 01"),
        ("03 0000 0000", "83 03"),
        ("03 0000 007e", "83 03"),
        ("03 0000", "83 03"),
        ("03", "83 03"),
        ("03 0000 0001 00", "83 03"),
        ("03 00a0 0001", "83 02"),
        ("03 ffff 0002", "83 02"),
        ("06 0000 0001", "86 02"),
        ("06 00c8", "86 03"),
        ("05 0000 0001", "85 03"),
        ("10 00c8 0002 04 0001", "90 03"),
        ("10 00c8 0001 04 0001 0002", "90 03"),
        ("10 00c8 0000 00", "90 03"),
        ("10 00c7 0002 04 0001 0002", "90 02"),
        ("0f 0000 0001 02 01 00", "8f 03"),
        ("06 00e3 002b", "86 03"),
    ],
)
def test_refusals(ask, control, request_, answer):
    assert ask(request_) == answer
    assert control.asked == []


def test_the_header_keeps_transaction_and_unit():
    header = bytes.fromhex("a1b2 0000 0006 11")
    assert body_length(header) == 5
    assert answer_frame(header, bytes.fromhex("03 02 0001")).hex() == "a1b20000000511030200" + "01"


@pytest.mark.parametrize("header", ["0001 0001 0006 01", "0001 0000 0001 01", "0001 0000 00ff 01", "0001 0000 0000 01"])
def test_what_is_no_header_ends_the_connection(header):
    with pytest.raises(FramingError):
        body_length(bytes.fromhex(header))


def test_our_heartbeat_stops_when_the_status_cannot_be_had(ask, gateway, control, monkeypatch):
    gateway.tick()
    gateway.tick()
    assert ask("03 0001 0001") == "03 02 00 02"
    with monkeypatch.context() as broken:
        broken.setattr(control, "status", lambda: 1 / 0)
        gateway.tick()
    assert ask("03 0001 0001") == "03 02 00 02"


def test_a_panel_that_never_beat_is_not_watched(ask, gateway, control):
    ask(START_S3)
    for _ in range(5 * SILENCE):
        gateway.tick()
    assert control.count("hold") == 0


def test_a_silent_panel_holds_its_own_run_once(ask, gateway, control):
    ask(START_S3)
    ask("06 0104 0001")
    assert ask("03 0104 0001") == "03 02 00 01"
    for value in (2, 3, 4):
        gateway.tick()
        gateway.tick()
        ask(f"06 0104 000{value}")
    assert control.count("hold") == 0
    assert gateway.heartbeats.panel_alive
    for _ in range(2 * SILENCE):
        ask("06 0104 0004")  # the same beat again is none
        gateway.tick()
    assert not gateway.heartbeats.panel_alive
    assert control.count("hold") == 1


def test_a_hold_that_is_not_possible_at_the_timeout_is_made_up_for_once(ask, gateway, control, monkeypatch):
    def silence(ticks: int) -> None:
        for _ in range(ticks):
            gateway.tick()

    def refuse() -> None:
        control.asked.append(("refused", None))
        raise NotAllowedInState("the state has changed since the status was read")

    ask(START_S3)
    ask("06 0104 0001")
    for state in (RunState.PREFLIGHT, RunState.RESUMING, RunState.IDENTIFYING):
        control.now(state, may=frozenset({"abort"}))
        silence(SILENCE)
    assert control.count("hold") == 0
    control.now(RunState.MEASURING, may=frozenset({"hold", "abort"}))
    with monkeypatch.context() as changed:
        changed.setattr(control, "hold", refuse)
        silence(1)
    assert control.count("refused") == 1
    silence(1)
    assert (control.status().state, control.count("hold")) == (RunState.HELD, 1)
    control.resume()
    silence(2 * SILENCE)
    assert control.count("hold") == 1, "a person has resumed it, and the silence is the same"
    ask("06 0104 0002")
    silence(2 * SILENCE)
    assert control.count("hold") == 2, "another silence"


def test_a_panel_that_beats_again_before_its_run_moves_does_not_hold_it(ask, gateway, control):
    ask(START_S3)
    ask("06 0104 0001")
    control.now(RunState.PREFLIGHT, may=frozenset({"abort"}))
    for _ in range(SILENCE):
        gateway.tick()
    ask("06 0104 0002")
    control.now(RunState.MEASURING, may=frozenset({"hold", "abort"}))
    gateway.tick()
    assert control.count("hold") == 0


def test_every_run_of_a_panel_that_was_silent_before_is_held(ask, gateway, control):
    ask("06 0104 0001")
    for _ in range(2 * SILENCE):
        gateway.tick()
    for holds, start in enumerate((START_S3, START_S3.replace("002a", "002b")), start=1):
        ask(start)
        for _ in range(2 * SILENCE):
            gateway.tick()
        assert control.count("hold") == holds
        control.now(RunState.COMPLETE, may=frozenset({"start"}))
        gateway.tick()


def test_a_silent_panel_does_not_hold_the_run_of_somebody_else(ask, gateway, control):
    control.now(RunState.MEASURING, run_id="from-the-timer")
    ask("06 0104 0001")
    for _ in range(2 * SILENCE):
        gateway.tick()
    assert control.count("hold") == 0


def test_the_lock_after_a_wrong_code_ends(gateway):
    assert not gateway.access.fits(1)
    for _ in range(LOCKED_TICKS):
        assert gateway.access.locked
        gateway.tick()
    assert not gateway.access.locked
    assert gateway.access.fits(0x00BC614E)
