"""A stock sample configuration with `volcal linuxcnc install` runs, and the driver fulfils its contract on it.

The sample is a mill with a vertical spindle. What its owner would set is changed: screen, travel, speeds, homing; the
simulated machine is connected as its hardware.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from contract_rig import LinuxCncRig
from live import Live, running
from requirements import requires_linuxcnc

from drivers.contract.motion_contract import MachineContract, ProbeContract
from drivers.linuxcnc.installation.command import linuxcnc_group

SAMPLE = Path("/usr/share/doc/linuxcnc/examples/sample-configs/sim/axis")
PLANT = """loadrt volcal_plant path=[VOLCAL]PLANT
addf volcal-plant servo-thread
net Xpos => volcal-plant.motor-0
net Ypos => volcal-plant.motor-1
net Zpos => volcal-plant.motor-2
"""
TRAVEL = {"X": 800.0, "Y": 500.0, "Z": 400.0}
OWNERS_CHANGES = {
    r"^DISPLAY = axis$": "DISPLAY = linuxcncrsh --port 5007",
    r"^COMM_TIMEOUT = .*$": "COMM_TIMEOUT = 600",
    r"^HALFILE = axis_manualtoolchange.hal$": "HALFILE = plant.hal",
    r"^HALFILE = simulated_home.hal\n": "",
    r"^(DEFAULT_LINEAR_VELOCITY|MAX_LINEAR_VELOCITY|MAX_VELOCITY) = .*$": r"\1 = 200",
    r"^HOME_OFFSET = .*$": "HOME_OFFSET = 0\nHOME_ABSOLUTE_ENCODER = 2",
    r"^HOME_SEQUENCE = .*$": "HOME_SEQUENCE = 0",
    r"\Z": "\n[VOLCAL]\nPLANT = plant.bin\n",
}

pytestmark = [
    requires_linuxcnc,
]


def configuration(folder: Path) -> Path:
    """Write the owner's configuration, install volcal, and return the folder."""
    text = (SAMPLE / "axis_mm.ini").read_text(encoding="utf-8")
    for pattern, new in OWNERS_CHANGES.items():
        text, count = re.subn(pattern, new, text, flags=re.MULTILINE)
        assert count, pattern
    for number, (axis, travel) in enumerate(TRAVEL.items()):
        for section, margin in ((f"AXIS_{axis}", 1.0), (f"JOINT_{number}", 2.0)):
            head, mark, tail = text.partition(f"[{section}]\n")
            tail = re.sub(r"MIN_LIMIT = .*", f"MIN_LIMIT = {-margin}", tail, count=1)
            text = head + mark + re.sub(r"MAX_LIMIT = .*", f"MAX_LIMIT = {travel + margin}", tail, count=1)
    folder.mkdir()
    (folder / "sim_mm.tbl").write_bytes((SAMPLE / "sim_mm.tbl").read_bytes())
    (folder / "plant.hal").write_text(PLANT, encoding="utf-8")
    (folder / "axis_mm.ini").write_text(text, encoding="utf-8")
    words = ["install", str(folder / "axis_mm.ini"), "--directory", "tables", "--probe-pin", "volcal-plant.probe"]
    done = CliRunner().invoke(linuxcnc_group, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return folder


class VerticalRig(LinuxCncRig):
    """Mill whose stylus points along -Z."""

    start_mm = (100.0, 0.0, 400.0)
    free_mm = (123.456, 0.0, 378.9)
    outside_mm = ((801.1, 0.0, 0.0), (0.0, -1.1, 400.0), (0.0, 0.0, 1e9))
    stylus, away_mm, into, reach_mm = 2, 400.0, -1.0, 13.0


@pytest.fixture(scope="module")
def mill(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Live]:
    folder = tmp_path_factory.mktemp("linuxcnc")
    with running(
        folder / "work",
        scenario="mill.toml",
        tool_mm=np.array([0.0, 0.0, -150.0]),
        configuration=configuration(folder / "configuration"),
        ini="axis_mm.ini",
    ) as machine:
        yield machine


@pytest.fixture
def rig(mill: Live) -> Iterator[VerticalRig]:
    made = VerticalRig(mill)
    made.device.open()
    try:
        made.go((made.device.position()[0], made.device.position()[1], made.away_mm))
        yield made
        made.leave()
    finally:
        made.device.close()


class TestMachine(MachineContract):
    pass


class TestProbe(ProbeContract):
    pass


def test_the_store_corrects_what_is_displayed(rig: VerticalRig) -> None:
    """A table of 0.2 mm in Z: the tip touches the ball where the display says 0.2 mm less."""
    ball = rig.approach()
    free = rig.probe.touch_towards(ball, feed_mm_per_s=1.0)
    rig.leave()
    table = rig.table(0)
    counts = np.zeros_like(table.counts)
    counts[..., 2] = 2000
    rig.store.stage(1, replace(table, counts=counts))
    rig.store.activate(1)
    ball = rig.approach()
    corrected = rig.probe.touch_towards(ball, feed_mm_per_s=1.0)
    lower = np.array(corrected.position_mm) - np.array(free.position_mm)
    assert lower == pytest.approx([0.0, 0.0, -0.2], abs=1.1e-3)


def test_doctor_finds_everything_connected(rig: VerticalRig) -> None:
    found = {finding.subject: finding for finding in rig.device.diagnose()}
    assert found["heartbeats"].ok
    assert found["compensation"].ok
    assert found["probe"].text.endswith("motion.probe-input is free")
    assert found["[AXIS_*]OFFSET_AV_RATIO"].text == "0.1, 0.1, 0.1"
