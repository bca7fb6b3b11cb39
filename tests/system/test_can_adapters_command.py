"""The real command and its simulated machine as two processes over each kind of CAN, a short run from end to end."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from aloud import NOT_HERE
from namespaces import KERNEL_CAN, MULTICAST, inside, kernel_can_missing, missing
from test_demo_command import bad_machine, short_settings

from agent.cli.doctor import examine
from agent.cli.run_commands.simulated_calibration import connect
from agent.cli.run_commands.simulator_process import SimulatorProcess
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings
from agent.settings.schema import Settings

CONFIG = Path(__file__).resolve().parents[2] / "config"
PATIENCE_S = 600.0
COARSE = "\n[table]\nstep_mm = [1000.0, 650.0, 750.0]\n"


def calibrated(directory: Path, can: str, preparation: str = "") -> subprocess.CompletedProcess[str]:
    settings = short_settings(directory)
    settings.write_text(settings.read_text() + COARSE)
    command = [sys.executable, "-m", "agent.cli.main", "demo", "--config", str(settings), "--can", can, "--json"]
    command += ["--scenario", str(bad_machine(directory)), "--out", str(directory / "out")]
    if preparation:
        command = inside(preparation, command)
    return subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def proved(ended: subprocess.CompletedProcess[str], link: str) -> None:
    assert ended.returncode == 0, ended.stderr
    document = json.loads(ended.stdout)
    assert document["state"] == "complete"
    assert document["verified"] is True
    assert document["collisions"] == 0
    assert document["true_ve_after_um"] < document["true_ve_before_um"]
    assert link in ended.stderr


def test_short_run_over_a_serial_adapter(tmp_path: Path) -> None:
    port = tmp_path / "can-adapter"
    proved(calibrated(tmp_path, f"slcan:{port}"), f"CAN slcan {port}")
    assert not port.exists()


def test_short_run_over_multicast(tmp_path: Path) -> None:
    """In a namespace whose loopback has multicast and nothing else has anything."""
    if absent := missing(MULTICAST):
        pytest.skip(f"{NOT_HERE}: CAN over multicast between two processes: {absent}")
    proved(calibrated(tmp_path, "udp_multicast:239.74.163.2:0", MULTICAST), "CAN udp_multicast 239.74.163.2")


def test_short_run_over_kernel_can(tmp_path: Path) -> None:
    if absent := kernel_can_missing():
        pytest.skip(f"{NOT_HERE}: CAN through the kernel (socketcan, vcan): {absent}")
    proved(calibrated(tmp_path, "socketcan:vcan0", KERNEL_CAN), "CAN socketcan vcan0")


def test_doctor_over_a_serial_adapter_lists_what_is_wrong_and_the_other_mount(tmp_path: Path) -> None:
    """Two mounts on one bus: the second has the number of another encoder and an exchanged drive in its settings."""
    settings = load_settings(CONFIG / "two-mounts.toml")
    with SimulatorProcess(
        CONFIG / "simulators" / "two-mounts.toml", can=f"slcan:{tmp_path / 'can'}", log=tmp_path / "simulator.log"
    ) as simulator:
        document = connect(settings, simulator.ready, tmp_path).model_dump(mode="json")
        document["devices"]["mount-1"]["options"]["azimuth"]["serial_number"] = 1
        document["devices"]["mount-2"]["options"]["azimuth"]["encoder_counts_per_revolution"] = 65536
        document["devices"]["mount-2"]["options"]["elevation"]["serial_number"] = 3
        findings = examine(prepare_job(Settings.model_validate(document), CONFIG), CONFIG).findings
    assert [line.text for line in findings["mount-1"] if not line.ok] == []
    assert findings["mount-1"][0].text == "the adapter reports no error"
    bad = [line.text for line in findings["mount-2"] if not line.ok]
    assert "is 131072 : 1 in the drive and 65536 : 1 in the settings" in bad[0], "why it was not opened"
    assert "0x608F position encoder resolution is 131072 : 1 in the drive, 65536 : 1 in the settings" in bad[1]
    assert "0x1018:04 serial number is 0x4, expected 0x3" in bad[2]
    assert len(bad) == 3
