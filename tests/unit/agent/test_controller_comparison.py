"""What `volcal doctor` says about a controller whose travel, speeds or units are not those of the machine file."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from agent.model_files import load_machine
from agent.planning.controller_comparison import compare_with_controller
from agent.settings.schema import ProcedureSettings
from drivers.roles import AxisLimits, DiagnosticFinding
from twin.machine.machine_description import MachineDescription

MACHINE = load_machine(Path(__file__).resolve().parents[3] / "config" / "machines" / "case-study.toml")
SPEED, ACCELERATION = (20000.0 / 60.0,) * 3, (500.0,) * 3
SAME = AxisLimits((0.0, 0.0, 0.0), (4000.0, 1300.0, 1500.0), SPEED, ACCELERATION)


def findings(limits: AxisLimits, machine: MachineDescription = MACHINE) -> dict[str, DiagnosticFinding]:
    found = compare_with_controller(limits, machine, ProcedureSettings())
    return {finding.subject: finding for finding in found}


def x_travel(low: float, high: float) -> DiagnosticFinding:
    return findings(replace(SAME, lower_mm=(low, 0.0, 0.0), upper_mm=(high, 1300.0, 1500.0)))["travel X"]


def test_the_same_limits_are_good() -> None:
    assert all(finding.ok for finding in findings(SAME).values())


@pytest.mark.parametrize(
    ("low", "high", "ok", "said"),
    [
        (3800.0, 4000.0, False, "refuse moves"),
        (-254.0, 254.0, False, "-10 … 10 inch, perhaps an inch/mm confusion"),
        (0.0, 4000.0 / 25.4, False, "the ratio 25.4, an inch/mm confusion"),
        (0.0, 4000.0 * 25.4, False, "the ratio 25.4, an inch/mm confusion"),
        (-4000.0, 0.0, False, "shifted by -4000 mm; correct the zero of the axis"),
        (-10.0, 4010.0, True, "the controller allows more than volcal uses"),
        (math.nan, math.nan, None, "not read from the controller"),
    ],
)
def test_another_travel_is_named_on_both_sides(low: float, high: float, ok: bool | None, said: str) -> None:
    finding = x_travel(low, high)
    assert finding.ok is ok
    assert said in finding.text
    assert "0 … 4000" in finding.text
    assert "axes.X.travel_mm" in finding.text


def test_what_is_faster_than_the_controller_allows_is_named_with_its_key() -> None:
    slow = replace(
        SAME,
        rapid_mm_per_s=(SPEED[0], SPEED[1] / 60.0, 40.0),
        acceleration_mm_per_s2=(500.0, math.nan, 300.0),
    )
    found = findings(slow)
    assert [subject for subject, finding in found.items() if finding.ok is False] == [
        "rapid Y",
        "rapid Z",
        "acceleration Z",
        "feeds",
    ]
    assert "a confusion of mm/s and mm/min" in found["rapid Y"].text
    assert "axes.Z.rapid_mm_per_min = 20000, the controller allows 2400 mm/min" in found["rapid Z"].text
    assert found["acceleration Y"].ok is None
    assert "procedure.guarded_feed_mm_per_min = 3000" in found["feeds"].text
