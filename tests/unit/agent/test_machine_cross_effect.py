"""The cross-effect of a machine as `volcal config machine` shows it."""

from __future__ import annotations

from pathlib import Path

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


def test_machines_without_beams() -> None:
    rows = cells(volcal("config", "machine", "--case", "case-study").stdout)
    assert rows["CROSS[b2]"] == ["", "EYZ", "y z²", "", "4.5", "µm"]
    assert volcal("config", "machine", "--case", "bridge").stdout == "bridge: no cross-effect\n"
