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


def test_machines_without_beams() -> None:
    rows = cells(volcal("config", "machine", "--case", "case-study").stdout)
    assert rows["CROSS[b2]"] == ["", "EYZ", "y z²", "", "4.5", "µm"]
    assert volcal("config", "machine", "--case", "bridge").stdout == "bridge: no cross-effect\n"
