"""`volcal simulate` as people and the agent start it: a process, its ready line, and its links."""

from __future__ import annotations

import json
import signal
import socket
import struct
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from simulated import scenario_text

from drivers.clock import LockstepClock, VirtualClock
from drivers.errors import CommandRejected, LinkLost
from drivers.registry import DeviceContext
from drivers.roles import Operator, OperatorRequest, OperatorTask
from simulators.cli import simulate
from simulators.operator import PLUGIN, SimulatedOperator, SimulatedOperatorSettings

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config" / "simulators" / "case-study.toml"
END_WITHIN_S = 600.0
LINES = 600.0


def command(*options: str, config: Path = SCENARIO) -> list[str]:
    return [sys.executable, "-m", "agent.cli.main", "simulate", "--config", str(config), *options]


@dataclass
class Simulator:
    process: subprocess.Popen[bytes]
    ready: dict[str, Any]

    def place(self, name: str) -> tuple[str, int]:
        return self.ready[name]["host"], self.ready[name]["port"]

    def ask(self, *lines: str | bytes) -> list[dict[str, Any]]:
        with socket.create_connection(self.place("control"), timeout=LINES) as link, link.makefile("rb") as answers:
            link.sendall(b"".join((x if isinstance(x, bytes) else x.encode()) + b"\n" for x in lines))
            return [json.loads(answers.readline()) for _ in lines]

    def do(self, name: str, **more: object) -> dict[str, Any]:
        return self.ask(json.dumps({"do": name, **more}))[0]

    def status_words(self, command_block: bytes = b"\x00\x01") -> tuple[int, ...]:
        """Function 23: the command block (or the heartbeat alone) written, STATUS read."""
        count = len(command_block) // 2
        request = struct.pack(">BHHHHB", 23, 1000, 70, 2000, count, 2 * count) + command_block
        with socket.create_connection(self.place("modbus"), timeout=LINES) as link, link.makefile("rb") as answers:
            link.sendall(struct.pack(">HHHB", 1, 0, len(request) + 1, 1) + request)
            return struct.unpack(">70H", answers.read(149)[9:])


@pytest.fixture(scope="module")
def simulator() -> Iterator[Simulator]:
    process = subprocess.Popen(
        command("--can", "socketcand:127.0.0.1:0", "--end-with-stdin"),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield Simulator(process, json.loads(process.stdout.readline()))
        finally:
            process.stdin.close()
            process.wait(END_WITHIN_S)


def test_ready_line_says_where_everything_is(simulator: Simulator) -> None:
    ready = simulator.ready
    assert ready["can"]["interface"] == "socketcand"
    assert ready["can_nodes"] == {"azimuth": 1, "elevation": 2}
    assert [len(place) for place in ready["stations"]] == [3, 3, 3, 3]
    for name in ("modbus", "control", "time"):
        socket.create_connection(simulator.place(name), timeout=LINES).close()
    options = ready["can"]["options"]
    socket.create_connection((options["host"], options["port"]), timeout=LINES).close()


def test_lockstep_moves_the_axes(simulator: Simulator) -> None:
    clock = LockstepClock(*simulator.place("time"))
    x, y, z = simulator.do("status")["position_mm"]
    move = struct.pack(">4HI4dH", 2, 12, 0, 0, 0, x + 50.0, y, z, 100.0, 1)
    words = simulator.status_words(move)
    assert words[8:12] == (1, 1, 1, 1)
    assert simulator.do("status")["motion"] == "moving"
    clock.sleep(0.9)
    assert simulator.status_words(b"\x00\x03")[4] in (0, 1)
    clock.sleep(0.9)
    words = simulator.status_words(b"\x00\x04")
    assert (words[4], words[11]) == (0, 2)
    assert simulator.do("status")["position_mm"] == pytest.approx([x + 50.0, y, z], abs=1e-9)
    clock.close()


def test_lost_heartbeat_brakes_the_real_axes(simulator: Simulator) -> None:
    clock = LockstepClock(*simulator.place("time"))
    x, y, z = simulator.do("status")["position_mm"]
    sequence = simulator.status_words()[8] + 1
    move = struct.pack(">4HI4dH", 5, 12, 0, 0, 0, x + 1000.0, y, z, 100.0, sequence)
    assert simulator.status_words(move)[8:10] == (sequence, 1)
    clock.sleep(20.0)
    state = simulator.do("status")
    words = simulator.status_words()
    assert (words[4], words[5], words[11]) == (3, 6, 7)
    assert state["fault"] == "agent heartbeat lost"
    assert 80.0 < state["position_mm"][0] - x < 120.0  # a second at 100 mm/s, less and more its ramps
    reset = struct.pack(">4HI4dH", 6, 24, 0, 0, 0, *[0.0] * 4, sequence + 1)
    assert simulator.status_words(reset)[8:10] == (sequence + 1, 1)
    assert simulator.do("status")["motion"] == "idle"
    clock.close()


def test_truth_and_collisions(simulator: Simulator) -> None:
    truth = simulator.do("truth")
    assert truth["active_bank"] == 0
    assert truth["active"] == truth["bare"]
    assert truth["banks"] == {}
    assert 5.0 < truth["bare"]["aligned_um"] <= truth["bare"]["raw_um"] < 40.0
    assert simulator.do("collisions") == {"count": 0, "collisions": []}


def test_operator_moves_the_artefact(simulator: Simulator) -> None:
    host, port = simulator.place("control")
    settings = SimulatedOperatorSettings(host=host, port=port)
    operator = PLUGIN.create(settings, DeviceContext("hand", VirtualClock(), ROOT))
    assert isinstance(operator, Operator)
    operator.open()
    assert operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to station 2", 2)) is True
    assert operator.ask(OperatorRequest(OperatorTask.CONSENT, "may the machine move?")) is True
    assert operator.diagnose()[0].ok
    with pytest.raises(CommandRejected, match="the simulator refused"):
        operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to station 99", 99))
    assert operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "back", 1)) is True
    operator.close()
    with pytest.raises(LinkLost, match="not open"):
        operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to station 2", 2))


def test_the_simulated_operator_takes_the_time_of_a_person(simulator: Simulator) -> None:
    host, port = simulator.place("control")
    clock = VirtualClock()
    settings = SimulatedOperatorSettings(host=host, port=port, carrying_minutes=2.0)
    operator = PLUGIN.create(settings, DeviceContext("hand", clock, ROOT))
    operator.open()
    assert isinstance(operator, Operator)
    assert operator.ask(OperatorRequest(OperatorTask.CONSENT, "may the machine move?")) is True
    assert clock.now() == 0.0
    assert operator.ask(OperatorRequest(OperatorTask.MOVE_ARTEFACT, "to station 1", 1)) is True
    assert clock.now() == pytest.approx(120.0)
    operator.close()


def test_the_shipped_person_takes_the_time_of_the_forecast() -> None:
    shipped = tomllib.loads((ROOT / "config" / "hand-placed.toml").read_text(encoding="utf-8"))
    person = shipped["devices"]["operator"]["options"]
    assert person["carrying_minutes"] == shipped["timing"]["relocation_minutes"] > 0.0


def test_operator_without_a_simulator() -> None:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        port = unused.getsockname()[1]
    with pytest.raises(LinkLost, match="no answer at"):
        SimulatedOperator(SimulatedOperatorSettings(port=port), "hand", VirtualClock()).open()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        (b"", "not JSON"),
        (b"{", "not JSON"),
        (b"\xff\xfe", "not JSON"),
        (b"[" * 5000, "not JSON"),
        (b"[1]", "not a JSON object"),
        (b"{}", "unknown request None"),
        (b'{"do": "dance"}', "unknown request 'dance'"),
        (b'{"do": ["truth"]}', "unknown request"),
        (b'{"do": "truth", "bank": 1}', "unknown key 'bank'"),
        (b'{"do": "place_artefact"}', "station must be an integer"),
        (b'{"do": "place_artefact", "station": "2"}', "station must be an integer"),
        (b'{"do": "place_artefact", "station": true}', "station must be an integer"),
        (b'{"do": "place_artefact", "station": 0}', "station"),
        (b'{"do": "place_artefact", "station": 99}', "station"),
    ],
)
def test_bad_requests_are_answered_and_survived(simulator: Simulator, line: bytes, said: str) -> None:
    refused, status = simulator.ask(line, '{"do": "status"}')
    assert said in refused["error"]
    assert "motion" in status


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--modbus", "5020"], "is not HOST:PORT"),
        (["--modbus", "127.0.0.1:70000"], "is not HOST:PORT"),
        (["--clock", "scaled:0"], "is not lockstep, real, or scaled:F"),
        (["--clock", "scaled:nan"], "is not lockstep, real, or scaled:F"),
        (["--clock", "sundial"], "is not lockstep, real, or scaled:F"),
        (["--numbers", "int32:0"], "is not float64, int32, or int32:SCALE"),
        (["--modbus-rtu", "any@19200"], "is not PATH, any, or one of them with a line"),
        (["--modbus-rtu", "any@19201,8E1"], "is not PATH, any, or one of them with a line"),
        (["--modbus-rtu", "@9600,8N2"], "is not PATH, any, or one of them with a line"),
        (["--modbus-rtu", "any@9600,7E1"], "is not PATH, any, or one of them with a line"),
        (["--modbus-rtu", "/proc/no-such-place/cnc"], "the link to the pseudo-terminal cannot be created"),
        (["--can", "carrier-pigeon"], "is not a CAN channel"),
        (["--control", "192.0.2.1:0"], "cannot listen for control"),
    ],
)
def test_wrong_options(options: list[str], said: str) -> None:
    ended = CliRunner().invoke(simulate, ["--config", str(SCENARIO), *options])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert said in ended.stderr


def test_absent_scenario(tmp_path: Path) -> None:
    ended = CliRunner().invoke(simulate, ["--config", str(tmp_path / "absent.toml")])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert "absent.toml" in ended.stderr


def test_scenario_that_does_not_fit_the_register_map(tmp_path: Path) -> None:
    three = tmp_path / "three-banks.toml"
    three.write_text(scenario_text() + "\n[store]\nbanks = [1, 2, 3]\n", encoding="utf-8")
    ended = CliRunner().invoke(simulate, ["--config", str(three)])
    assert (ended.exit_code, ended.stdout) == (2, "")
    assert "banks [1, 2, 3]" in ended.stderr


def test_wrong_scenario_is_one_clear_line(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text("colour = 'blue'\n" + SCENARIO.read_text(encoding="utf-8"), encoding="utf-8")
    ended = run_to_its_end(config=wrong)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "colour" in ended.stderr
    assert len(ended.stderr.strip().splitlines()) == 1


def test_ends_with_stdin_and_its_clock_runs_by_itself() -> None:
    ended = run_to_its_end("--clock", "scaled:50", "--end-with-stdin")
    assert ended.returncode == 0
    ready = json.loads(ended.stdout)
    assert ready["time"] is None
    assert ready["can"] is None


def run_to_its_end(*options: str, config: Path = SCENARIO) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*options, config=config),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=END_WITHIN_S,
        check=False,
    )


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_ends_with_a_signal(number: signal.Signals) -> None:
    with subprocess.Popen(
        command("--clock", "real"), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["time"] is None
        process.send_signal(number)
        _, said = process.communicate(timeout=END_WITHIN_S)
    assert process.returncode == 0
    assert b"Traceback" not in said
