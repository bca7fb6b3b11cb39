"""The real command against the simulated machine in another process, over a serial line at its real speed."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory

from test_demo_command import demo

from agent.cli.doctor import examine
from agent.cli.run_commands.simulated_calibration import connect
from agent.cli.run_commands.simulator_process import SimulatorProcess
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings

CONFIG = Path(__file__).resolve().parents[2] / "config"
SETTINGS, SCENARIO = CONFIG / "case-study.toml", CONFIG / "simulators" / "case-study.toml"


def test_a_whole_run_over_a_serial_line(tmp_path: Path) -> None:
    ended = demo(tmp_path, "--json", "--modbus-rtu", f"{tmp_path / 'cnc'}@115200,8E1")
    document = json.loads(ended.stdout)
    assert (ended.returncode, document["state"], document["reason"]) == (0, "complete", ""), ended.stderr[-2000:]
    assert (document["verified"], document["collisions"]) == (True, 0)
    assert document["true_ve_after_um"] < document["true_ve_before_um"]
    assert document["machine_minutes"] > document["predicted_minutes"]  # the line's time is the machine's
    assert f"Modbus RTU {tmp_path / 'cnc'} 115200 baud" in ended.stderr


def test_doctor_on_a_serial_line_and_where_the_controller_really_answers() -> None:
    with TemporaryDirectory() as directory:
        out = Path(directory)
        with SimulatorProcess(
            SCENARIO, can="socketcand:127.0.0.1:0", log=out / "simulator.log", modbus_rtu="any@38400,8N2"
        ) as simulator:
            settings = connect(load_settings(SETTINGS), simulator.ready, out)
            good = {line.subject: line for line in examine(prepare_job(settings, CONFIG), CONFIG).findings["cnc"]}
            serial = settings.devices["cnc"].options["serial"]
            serial["baud"] = 19200
            wrong = {line.subject: line for line in examine(prepare_job(settings, CONFIG), CONFIG).findings["cnc"]}
    assert [line for line in good.values() if not line.ok] == []
    assert "a poll takes 49 ms of the line at 38400 baud 8N2" in good["line"].text
    assert good["line faults"].text.startswith("0 requests repeated, 0 stray bytes")
    assert not wrong["link"].ok
    assert "no answer within" in wrong["link"].text
    assert wrong["baud rate"].text.startswith("the controller answers at 38400 baud")
