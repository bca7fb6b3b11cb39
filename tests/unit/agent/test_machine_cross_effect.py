"""The cross-effect of a machine as `volcal config machine` shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from volcal_command import volcal

ROOT = Path(__file__).resolve().parents[3]
KNEE = """
[[beams]]
name = "knee"
axis = "Y"
ends = "cantilever"
supports_mm = [-300.0]
shear_modulus_gpa = 45.0
torsion_constant_mm4 = 2.0e8

[[beams.loads]]
name = "table"
carried_by = "X"
mass_kg = 400.0
centre_mm = [400.0, 0.0, 0.0]
"""


def cells(output: str) -> dict[str, list[str]]:
    """Return the cells of the rows by the first one."""
    rows = [[cell.strip() for cell in line.strip("│").split("│")] for line in output.splitlines() if "│" in line]
    return {row[0]: row[1:] for row in rows}


def test_beams_of_a_machine_file(tmp_path: Path) -> None:
    mill = (ROOT / "config" / "machines" / "mill.toml").read_text(encoding="utf-8")
    lines = [line for line in mill.splitlines() if not line.startswith("cross_effect")]
    (tmp_path / "knee.toml").write_text("\n".join(lines) + KNEE, encoding="utf-8")
    printed = volcal("config", "machine", "--case", "mill", "--machine", tmp_path / "knee.toml").stdout
    rows = cells(printed)
    # m g L_x L_y / GJ = 400 · 9.80665 · 800 · 500 / 9e12 rad
    assert rows["CROSS[knee.EBY.1]"] == ["knee", "EBY", "x y", "174", "174", "µrad"]
    assert rows["CROSS[knee.EBY.0]"] == ["knee", "EBY", "x", "105", "not identified", "µrad"]
    assert "Not identified: terms that the error motions" in printed


BRIDGE = """
[[beams]]
name = "bridge"
axis = "Y"
ends = "clamped"
supports_mm = [-200.0, 2200.0]

[[beams.loads]]
name = "saddle"
carried_by = "Z"
centre_mm = [0.0, 0.0, -100.0]
"""


def test_an_order_that_is_too_low_for_the_sag(tmp_path: Path) -> None:
    """A clamped beam sags by s³b³: degree 6, but the machine file has the order 5 for all error motions."""
    bridge = (ROOT / "config" / "machines" / "bridge.toml").read_text(encoding="utf-8")
    text = "\n".join(line for line in bridge.splitlines() if not line.startswith("cross_effect")) + BRIDGE
    for order, warned in (("order = 5", True), ("order = { EZY = 6 }", False)):
        (tmp_path / "bridge.toml").write_text(text.replace("order = 5", order), encoding="utf-8")
        result = volcal("config", "machine", "--case", "bridge", "--machine", tmp_path / "bridge.toml")
        assert result.stdout == "bridge: no cross-effect\n"
        assert ("warning: EZY has the order 5, but its beams need the order 6" in result.stderr) is warned
        assert result.stderr.count("\n") == warned


def test_the_shipped_gantry() -> None:
    """Roll of the portal by the textbook formulas of a beam on two supports, with a force and a moment at one place."""
    printed = volcal("config", "machine", "--case", "bridge", "--machine", ROOT / "config" / "machines" / "gantry.toml")
    rows = cells(printed.stdout)
    length_mm, weight_n, bending_n_mm2 = 3800.0, 2000.0 * 9.80665, 210e3 * 6.0e9
    before_mm = np.linspace(400.0, 3400.0, 3001)
    beyond_mm = length_mm - before_mm
    by_force = weight_n * before_mm**2 * beyond_mm**2 / (3.0 * bending_n_mm2 * length_mm)
    by_moment = weight_n * 150.0 * before_mm * beyond_mm * (beyond_mm - before_mm) / (3.0 * bending_n_mm2 * length_mm)
    moved_share = 2.0 * 2000.0 / 2600.0  # of the weight, from one rail to the other while Y travels through its range
    # whatever the sign of the moment: the rail is symmetrical
    roll_urad = 1e6 * np.abs(by_force + by_moment).max() * moved_share / 2600.0
    assert abs(float(rows["CROSS[left.EAX]"][3])) == pytest.approx(roll_urad, rel=5e-3)
    assert rows["CROSS[left.EAX]"][:2] == ["left, right", "EAX"]
    assert {"CROSS[left.EZX]", "CROSS[left.EBX]", "CROSS[right.EBX]"} < set(rows)
    assert printed.stderr == ""


def test_machines_without_beams() -> None:
    rows = cells(volcal("config", "machine", "--case", "case-study").stdout)
    assert rows["CROSS[b2]"] == ["", "EYZ", "y z²", "", "4.5", "µm"]
    assert volcal("config", "machine", "--case", "bridge").stdout == "bridge: no cross-effect\n"
