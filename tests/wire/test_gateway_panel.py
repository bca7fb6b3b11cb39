"""The panel gateway over real sockets with pyModbusTCP, a client that shares no code with it."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_control import FakeControl
from pyModbusTCP.client import ModbusClient

from agent.execution.states import RunState
from agent.service.gateway.access import access_code_path
from agent.service.gateway.endpoint import GatewayEndpoint
from agent.settings.panel_gateway import GatewaySettings
from drivers.errors import ConfigurationError

CODE = 3_000_000_019  # more than 31 bits, high and low word different
SLOWLY_S = 300.0
# As a panel's programmer reads them in docs/reference/panel-gateway.md.
FLAGS, STATE, PACKML, KIND, PROGRESS = 2, 3, 4, 5, 7
MINUTES = 8
ALARM_COUNT, QUESTION = 20, 25
ACCEPTED, RESULT, SET, RUN, DOING, ALARM_TEXT = 28, 29, 30, 46, 62, 86
COMMAND, SEQUENCE = 200, 227
START, HOLD, RESUME, ABORT, RESET, ANSWER, RESUME_RUN = range(1, 8)
DONE, WRONG_CODE, NO_CODE_SET, LOCKED, UNKNOWN_COMMAND, NOT_ALLOWED, BUSY = 1, 10, 11, 12, 13, 14, 460


def block(command: int, sequence: int, *, kind=1, consent=1, full=0, slot=0, stations=0, number=0, answer=0,
          sets="", code=CODE) -> list[int]:  # fmt: skip
    """Return the whole command block, arranged by hand from the document."""
    data = struct.pack(">6HIH", command, kind, consent, full, slot, stations, number, answer)
    data += sets.encode().ljust(32, b"\0") + struct.pack(">IH", code, sequence)
    return list(struct.unpack(f">{len(data) // 2}H", data))


class Panel:
    def __init__(self, client: ModbusClient) -> None:
        self.client = client

    def read(self, address: int, count: int = 1) -> list[int]:
        words = self.client.read_holding_registers(address, count)
        assert words is not None, self.client.last_error_as_txt
        return words

    def text(self, address: int, words: int) -> str:
        return struct.pack(f">{words}H", *self.read(address, words)).rstrip(b"\0").decode("ascii")

    def next(self) -> int:
        return self.read(ACCEPTED)[0] % 65535 + 1

    def give(self, command: int, **values) -> int:
        """Give a command with the next number and return its result."""
        sequence = self.next()
        assert self.client.write_multiple_registers(COMMAND, block(command, sequence, **values))
        assert self.read(ACCEPTED) == [sequence]
        return self.read(RESULT)[0]


@pytest.fixture
def control() -> FakeControl:
    return FakeControl()


@pytest.fixture
def code_file(tmp_path: Path) -> Path:
    path = tmp_path / "code"
    path.write_text(f"{CODE}\n")
    path.chmod(0o600)
    return path


@contextlib.contextmanager
def opened(control: FakeControl, directory: Path, **settings) -> Iterator[GatewayEndpoint]:
    endpoint = GatewayEndpoint(GatewaySettings(port=0, **settings), directory / "state")
    endpoint.start(control)
    try:
        yield endpoint
    finally:
        endpoint.stop()


@contextlib.contextmanager
def panel_at(endpoint: GatewayEndpoint) -> Iterator[Panel]:
    host, port = endpoint.address
    client = ModbusClient(host=host, port=port, timeout=SLOWLY_S)
    try:
        yield Panel(client)
    finally:
        client.close()


@pytest.fixture
def endpoint(control, tmp_path, code_file) -> Iterator[GatewayEndpoint]:
    with opened(control, tmp_path, access_code_file=code_file) as endpoint:
        yield endpoint


@pytest.fixture
def panel(endpoint) -> Iterator[Panel]:
    with panel_at(endpoint) as panel:
        yield panel


def test_the_status_is_what_the_control_says(panel, control):
    control.now(
        RunState.MEASURING, run_id="night-12", kind="nightly", position_set="S1+S3", fraction=0.4321,
        minutes_left=12.345, ve_before_um=38.25, ve_now_um=-1.5, balls=70000, touches=5, doing="ball 3 at 45° – µm",
    )  # fmt: skip
    assert panel.read(0) == [1]
    assert panel.read(FLAGS, 4) == [0b1000001, 2, 6, 3]
    assert panel.read(PROGRESS) == [4321]
    assert struct.unpack(">Iii", struct.pack(">6H", *panel.read(MINUTES, 6))) == (1234, 38250, -1500)
    assert panel.read(14, 2) == [70000 >> 16, 70000 & 0xFFFF]
    assert (panel.text(SET, 16), panel.text(RUN, 16)) == ("S1+S3", "night-12")
    assert panel.text(DOING, 24) == "ball 3 at 45 deg - um"
    assert panel.client.read_input_registers(STATE, 1) == [2], "input registers show the same"


def test_what_is_not_known_is_marked(panel):
    assert panel.read(MINUTES, 6) == [0xFFFF, 0xFFFF, 0x8000, 0, 0x8000, 0]
    assert panel.read(18, 2) == [0xFFFF, 0xFFFF]


def test_start_hold_resume_abort_reset(panel, control):
    assert panel.give(START, kind=3, sets="S1+S3", slot=155, stations=0b101, full=2) == DONE
    request = control.asked[0][1]
    assert (request.kind, request.source, request.consent) == ("nightly", "panel", True)
    assert (request.position_set, request.slot_minutes, request.stations) == ("S1+S3", 15.5, [1, 3])
    assert request.full_allowed is True
    assert panel.read(STATE, 3) == [2, 6, 3]
    for command, state in ((HOLD, 3), (RESUME, 2), (ABORT, 12), (RESET, 0)):
        assert panel.give(command) == DONE
        assert panel.read(STATE) == [state]


def test_what_is_left_at_zero_is_as_the_settings_say(panel, control):
    assert panel.give(START, consent=0) == DONE
    request = control.asked[0][1]
    assert (request.position_set, request.slot_minutes, request.stations) == (None, None, None)
    assert (request.full_allowed, request.consent) == (None, False)


def test_the_same_block_again_starts_nothing_not_even_after_a_reconnect_or_a_restart(
    endpoint, panel, control, tmp_path, code_file
):
    sequence = panel.next()
    start = block(START, sequence)
    assert panel.client.write_multiple_registers(COMMAND, start)
    panel.give(ABORT)
    panel.give(RESET)
    for _ in range(3):
        assert not panel.client.write_multiple_registers(COMMAND, start), "an old number is refused"
    with panel_at(endpoint) as again:
        assert not again.client.write_multiple_registers(COMMAND, start)
    last = block(RESET, panel.read(ACCEPTED)[0])
    assert panel.client.write_multiple_registers(COMMAND, last), "the last command may be repeated: its answer was lost"
    assert control.count("reset") == 1
    endpoint.stop()
    with opened(control, tmp_path, access_code_file=code_file) as later, panel_at(later) as panel_later:
        assert not panel_later.client.write_multiple_registers(COMMAND, start)
        assert panel_later.client.write_multiple_registers(COMMAND, last)
        assert panel_later.read(RESULT) == [0], "no command since the service began"
        assert panel_later.give(START) == DONE
    assert control.count("start") == 2
    assert control.count("reset") == 1


def test_a_first_start_of_the_gateway_takes_no_number_that_panels_hold_by_habit(control, tmp_path):
    beginnings = set()
    for attempt in range(6):
        with opened(control, tmp_path / str(attempt)) as endpoint, panel_at(endpoint) as panel:
            beginnings |= set(panel.read(ACCEPTED))
    assert len(beginnings) > 3


def test_another_command_under_the_same_number_is_told_so(panel, control):
    panel.give(START)
    taken = panel.read(ACCEPTED)[0]
    assert not panel.client.write_multiple_registers(COMMAND, block(HOLD, taken))
    assert panel.client.last_except == 3
    assert control.count("hold") == 0


@pytest.mark.parametrize("distance", [2, 7, 65534, 0x8000])
def test_a_number_that_is_not_the_next_is_refused(panel, control, distance):
    wrong = (panel.read(ACCEPTED)[0] + distance) % 65536
    assert not panel.client.write_multiple_registers(COMMAND, block(START, wrong))
    assert panel.client.last_except == 3
    assert control.asked == []


def test_number_zero_is_never_next(tmp_path, control, code_file):
    (tmp_path / "state").mkdir()
    (tmp_path / "state" / "gateway-sequence.json").write_text('{"accepted": 65535, "content": []}')
    with opened(control, tmp_path, access_code_file=code_file) as endpoint, panel_at(endpoint) as panel:
        assert not panel.client.write_multiple_registers(COMMAND, block(START, 0))
        assert panel.client.write_multiple_registers(COMMAND, block(START, 1))
    assert control.count("start") == 1


def test_registers_one_by_one_are_a_draft_until_the_sequence_is_written(panel, control):
    words = block(START, panel.next(), sets="S2")
    for offset, word in enumerate(words[:-1]):
        assert panel.client.write_single_register(COMMAND + offset, word)
        assert control.asked == []
    assert panel.client.write_single_register(SEQUENCE, words[-1])
    assert control.asked[0][1].position_set == "S2"


def test_a_draft_belongs_to_its_connection_and_goes_with_it(endpoint, panel, control):
    sequence = panel.next()
    assert panel.client.write_multiple_registers(COMMAND, block(START, sequence)[:-1])
    with panel_at(endpoint) as other:
        assert other.read(COMMAND, 28) == [0] * 28
        assert other.client.write_single_register(SEQUENCE, sequence)
        assert other.read(RESULT) == [UNKNOWN_COMMAND]
    panel.client.close()
    assert panel.client.write_single_register(SEQUENCE, panel.next())
    assert panel.read(RESULT) == [UNKNOWN_COMMAND]
    assert control.asked == []


def test_nothing_of_a_command_is_left_for_the_next_one(panel, control):
    panel.give(START)
    panel.give(ABORT)
    panel.give(RESET)
    assert panel.read(COMMAND, 28) == [0] * 28
    assert panel.client.write_single_register(COMMAND, START)
    assert panel.client.write_single_register(SEQUENCE, panel.next())
    assert panel.read(RESULT) == [WRONG_CODE]
    assert control.count("start") == 1


def test_the_access_code_is_asked_for_and_never_shown(panel, control):
    assert panel.client.write_multiple_registers(COMMAND, block(START, panel.next())[:-1])
    assert panel.read(225, 2) == [0, 0]
    assert panel.give(START, code=CODE ^ 1) == WRONG_CODE
    assert panel.give(START) == LOCKED, "right, but too soon after a wrong one"
    assert panel.give(HOLD, code=0) == DONE, "what only stops asks for none"
    assert panel.give(ABORT, code=0) == DONE
    assert control.count("start") == 0


def test_without_an_access_code_panels_read_hold_and_abort(control, tmp_path):
    with opened(control, tmp_path) as endpoint, panel_at(endpoint) as panel:
        assert panel.read(FLAGS) == [0]
        assert panel.give(START, code=0) == NO_CODE_SET
        assert panel.give(HOLD) == DONE
        assert panel.client.write_single_coil(0, True)
    assert [name for name, _ in control.asked] == ["hold", "abort"]


def test_the_abort_coil_asks_for_nothing(panel, control):
    panel.give(START)
    assert panel.client.read_coils(0, 1) == [False]
    assert panel.client.write_single_coil(0, False)
    assert control.count("abort") == 0
    assert panel.client.write_single_coil(0, True)
    assert panel.read(STATE) == [12]
    assert panel.client.write_multiple_coils(0, [True])
    assert control.count("abort") == 2
    control.now(RunState.ABORTING)
    assert panel.client.read_coils(0, 1) == [True]


def test_refusals_of_the_control_are_results(panel, control):
    panel.give(START)
    assert panel.give(START) == BUSY
    panel.give(ABORT)
    assert panel.give(START) == 351
    panel.give(RESET)
    assert panel.give(START, sets="S99") == 200
    assert panel.give(RESUME_RUN) == 200
    control.hold = lambda: 1 / 0
    assert panel.give(HOLD) == 900


@pytest.mark.parametrize("values", [{"kind": 0}, {"kind": 4}, {"consent": 2}, {"full": 3}])
@pytest.mark.parametrize("sets", ["../etc/set", "S1\0S2", "S1 S2"])
def test_values_that_cannot_be_are_refused_before_anybody_is_asked(panel, control, values, sets):
    assert panel.give(START, **values) == NOT_ALLOWED
    assert panel.give(START, sets=sets) == NOT_ALLOWED
    assert control.asked == []


def test_a_question_is_answered_by_its_number(panel, control):
    control.ask(70001)
    assert struct.unpack(">IH", struct.pack(">3H", *panel.read(QUESTION, 3))) == (70001, 2)
    assert panel.text(116, 40) == "Is the artefact at station 2?"
    assert panel.read(FLAGS)[0] & 0b100
    assert panel.give(ANSWER, number=70000, answer=1) == 200
    assert panel.give(ANSWER, number=70001, answer=0) == NOT_ALLOWED
    assert panel.give(ANSWER, number=70001, answer=2) == DONE
    assert control.asked == [("answer", (70001, False))]


def test_alarms_show_their_codes_and_words(panel, control):
    control.fault()
    assert panel.read(ALARM_COUNT, 5) == [1, 311, 0, 0, 0]
    assert panel.text(ALARM_TEXT, 30) == "the mount does not answer"
    assert panel.read(FLAGS)[0] & 0b10


@pytest.mark.parametrize(
    "write",
    [
        lambda client: client.write_single_register(STATE, 5),
        lambda client: client.write_multiple_registers(150, [0] * 60),
        lambda client: client.write_multiple_registers(COMMAND, [1] * 29),
        lambda client: client.write_single_register(261, 1),
        lambda client: client.write_single_coil(1, True),
        lambda client: client.write_multiple_coils(0, [True, True]),
        lambda client: client.read_holding_registers(150, 60),
        lambda client: client.read_coils(0, 2),
    ],
)
def test_what_is_not_in_the_map_is_refused_with_exception_2(panel, control, write):
    assert not write(panel.client)
    assert panel.client.last_except == 2
    assert control.asked == []


def test_other_functions_are_refused_with_exception_1(panel):
    assert panel.client.read_discrete_inputs(0, 1) is None
    assert panel.client.last_except == 1
    assert panel.client.write_read_multiple_registers(COMMAND, [1], 0, 1) is None
    assert panel.client.last_except == 1


def test_a_status_that_cannot_be_had_is_exception_4_and_the_link_stays(panel, control, monkeypatch):
    with monkeypatch.context() as broken:
        broken.setattr(control, "status", lambda: 1 / 0)
        assert panel.client.read_holding_registers(0, 1) is None
        assert panel.client.last_except == 4
    assert panel.read(0) == [1]


def test_garbage_and_slow_panels_keep_nobody_waiting(endpoint, panel):
    with contextlib.ExitStack() as stack:
        for _ in range(4):
            stack.enter_context(socket.create_connection(endpoint.address)).sendall(b"\0\1\0\0\0")  # half a header
        noise = stack.enter_context(socket.create_connection(endpoint.address, timeout=SLOWLY_S))
        noise.sendall(b"GET / HTTP/1.1\r\n\r\n")
        assert panel.read(0) == [1]
        with contextlib.suppress(ConnectionResetError):
            assert noise.recv(1) == b"", "hung up on"


def test_a_panel_that_never_reads_its_answers_keeps_nobody_waiting(endpoint, panel, control):
    with socket.create_connection(endpoint.address) as link:
        link.setblocking(False)
        with pytest.raises(BlockingIOError):
            while True:
                link.send(bytes.fromhex("0001 0000 0006 01 03 0000 0074") * 100)
        assert panel.give(HOLD) == DONE
        assert panel.client.write_single_coil(0, True)
    assert [name for name, _ in control.asked] == ["hold", "abort"]


def test_the_quietest_panel_makes_room_for_a_new_one(control, tmp_path):
    with opened(control, tmp_path, max_clients=2) as endpoint, panel_at(endpoint) as old, panel_at(endpoint) as busy:
        assert old.read(0) == busy.read(0) == [1]
        with panel_at(endpoint) as new:
            assert new.read(0) == [1]
            assert busy.client.is_open
            assert busy.client.read_holding_registers(0, 1) == [1]
            old.client.auto_open = False
            assert old.client.read_holding_registers(0, 1) is None


def test_a_silent_connection_is_hung_up_on(control, tmp_path):
    with (
        opened(control, tmp_path, idle_timeout_s=1.0) as endpoint,
        socket.create_connection(endpoint.address, timeout=SLOWLY_S) as link,
    ):
        link.sendall(b"\0\1")
        assert link.recv(1) == b""


def test_who_is_not_among_the_clients_is_hung_up_on(control, tmp_path):
    with opened(control, tmp_path, clients=["10.1.2.0/24", "127.0.0.9"]) as endpoint:
        with socket.create_connection(endpoint.address, timeout=SLOWLY_S) as link, contextlib.suppress(ConnectionError):
            assert link.recv(1) == b""
        with socket.create_connection(endpoint.address, SLOWLY_S, source_address=("127.0.0.9", 0)) as link:
            link.sendall(bytes.fromhex("0001 0000 0006 01 03 0000 0001"))
            assert link.recv(100) == bytes.fromhex("0001 0000 0005 01 03 02 0001")


def test_several_panels_at_once_and_every_number_is_taken_once(endpoint, control):
    """Four panels press hold as fast as possible; each accepted number must be one hold."""
    accepted = []

    def press() -> None:
        with panel_at(endpoint) as panel:
            for attempt in range(25):
                sequence = panel.next()
                # The attempt makes the content unlike that of the other panels, so that a repeat is no success.
                if panel.client.write_multiple_registers(
                    COMMAND, block(HOLD, sequence, number=id(panel) % 2**31 + attempt)
                ):
                    accepted.append(sequence)

    threads = [threading.Thread(target=press) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(SLOWLY_S * 2)
    assert len(accepted) == len(set(accepted)) == control.count("hold")
    assert len(accepted) >= 25


def test_a_command_that_cannot_be_recorded_is_not_given(panel, control, tmp_path):
    panel.give(HOLD)
    state = tmp_path / "state"
    state.rename(tmp_path / "gone")
    state.write_text("a file where the directory was")
    sequence = panel.next()
    assert not panel.client.write_multiple_registers(COMMAND, block(START, sequence))
    assert panel.client.last_except == 4
    assert control.count("start") == 0
    state.unlink()
    assert panel.client.write_multiple_registers(COMMAND, block(START, sequence))
    assert control.count("start") == 1


def test_a_hold_and_an_abort_are_carried_out_although_they_cannot_be_recorded(
    endpoint, panel, control, tmp_path, code_file
):
    panel.give(START)
    state = tmp_path / "state"
    state.rename(tmp_path / "kept")
    state.write_text("a file where the directory was")
    assert panel.give(HOLD) == DONE
    assert panel.give(ABORT, code=0) == DONE
    last = block(ABORT, panel.read(ACCEPTED)[0])
    assert panel.client.write_multiple_registers(COMMAND, last), "the same block again has no effect"
    assert [name for name, _ in control.asked] == ["start", "hold", "abort"]
    assert not panel.client.write_multiple_registers(COMMAND, block(RESET, panel.next()))
    assert panel.client.last_except == 4
    state.unlink()
    (tmp_path / "kept").rename(state)
    assert panel.give(RESET) == DONE
    taken = panel.read(ACCEPTED)
    endpoint.stop()
    with opened(control, tmp_path, access_code_file=code_file) as later, panel_at(later) as panel_later:
        assert panel_later.read(ACCEPTED) == taken
    assert control.count("start") == 1


def test_the_port_is_free_again_after_a_stop(control, tmp_path):
    with opened(control, tmp_path) as endpoint:
        _, port = endpoint.address
    endpoint.stop()
    again = GatewayEndpoint(GatewaySettings(port=port), tmp_path)
    again.start(control)
    with pytest.raises(ConfigurationError, match=r"cannot listen for panels on 127\.0\.0\.1"):
        GatewayEndpoint(GatewaySettings(port=port), tmp_path).start(control)
    again.stop()


@pytest.mark.parametrize("text", ["", "0", "4294967296", "12 34", "-3", "twelve", "²"])
def test_a_wrong_access_code_file_is_named(control, tmp_path, text):
    file = tmp_path / "code"
    file.write_text(text)
    file.chmod(0o600)
    with pytest.raises(ConfigurationError, match="access code is not an integer") as caught:
        GatewayEndpoint(GatewaySettings(port=0, access_code_file=file), tmp_path).start(control)
    assert caught.value.where["file"] == str(file)


def test_an_access_code_that_others_can_read_is_refused(control, tmp_path, code_file):
    code_file.chmod(0o640)
    with pytest.raises(ConfigurationError, match=r"can be read by others \(mode 0640\)"):
        GatewayEndpoint(GatewaySettings(port=0, access_code_file=code_file), tmp_path).start(control)


def test_the_access_code_that_systemd_hands_over_comes_first(tmp_path):
    settings = GatewaySettings(access_code_file=Path("/etc/volcal/code"))
    assert access_code_path(settings, {}) == Path("/etc/volcal/code")
    assert access_code_path(settings, {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == Path("/etc/volcal/code")
    (tmp_path / "panel-code").write_text("5")
    assert access_code_path(settings, {"CREDENTIALS_DIRECTORY": str(tmp_path)}) == tmp_path / "panel-code"
    assert access_code_path(GatewaySettings(), {}) is None


@pytest.mark.parametrize("text", ["", "{}", '{"accepted": 0, "content": []}', '{"accepted": "7", "content": []}', "[]"])
def test_a_damaged_record_of_the_number_is_named(control, tmp_path, text):
    (tmp_path / "gateway-sequence.json").write_text(text)
    with pytest.raises(ConfigurationError, match="sequence number of the gateway cannot be read"):
        GatewayEndpoint(GatewaySettings(port=0), tmp_path).start(control)
