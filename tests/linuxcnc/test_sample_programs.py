"""Corrected programs, executed by LinuxCNC's own interpreter, against the original ones: LinuxCNC's sample programs in
mm and a program with every statement of the language.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from requirements import skip_if_missing
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import cKDTree

from campaigns.part_programs.rs274 import RS274, Executed, execute, farthest
from gcode.correction import correct_program
from gcode.setup import SYSTEMS, CorrectionOptions, PartSetup
from twin.compensation.table import CompensationTable, regular_nodes
from twin.errors import FormatError
from twin.machine.anchor import Anchor

pytestmark = skip_if_missing("" if RS274 else "its interpreter rs274 is not installed")

SAMPLES = Path("/usr/share/linuxcnc/ncfiles")
ZERO = (0.0, 0.0, 0.0)
SETUP = PartSetup(
    work_offsets=dict.fromkeys(SYSTEMS, ZERO),
    reference_points={"G28": ZERO, "G30": ZERO},
    tools=dict.fromkeys(range(100), ZERO),
    start=ZERO,
    tool_change_moves=False,
)
CHORD_MM = 0.002
OUT_OF_SCOPE = {
    "cone.ngc": "axis B",
    "g76.ngc": "G41",
    "gmoccapy_2_tools_with_cutter_radius_compensation.ngc": "G41",
    "lathe-g76.ngc": "G41",
    "lathe_g70_71_demo.ngc": "G71.1",
    "lathe_g7x_face_boring.ngc": "G72",
    "lathe_g7x_quadrants.ngc": "G70",
    "nestedcall.ngc": "callsub",  # LinuxCNC refuses it too
}

EVERYTHING = """%
G21 G90 G17 G64 P0.01
G10 L2 P1 X100 Y50 Z20
G54 F500
#<depth> = -2.5 #100 = [2 ** 3 + 7 mod 4]
o<side> sub
  #<step> = [#1 / 4]
  #<n> = 0
  o101 while [#<n> lt 4]
    #<n> = [#<n> + 1]
    G91 G1 X#<step>
    o102 if [#5420 gt [#2 + 0.5]]
      o101 continue
    o102 elseif [#5420 gt #2]
      G1 Z1
      G1 Z-1
    o102 else
      G1 Y[-1 * #3]
    o102 endif
  o101 endwhile
  o103 repeat [2]
    Z0.5
  o103 endrepeat
  G90
o<side> endsub [#5421]
G0 X0 Y0 Z5
G1 Z#<depth>
o<side> call [40] [25] [0.5]
G2 X[#5420 + 20] Y#<_value> I10 J[60 - 60]
o110 do
  #110 = [#100 - 1] #100 = [#100 - 2]
  #100 = #110
  G1 X[#100 * 3] Y[ATAN[1]/[1] - #100]
o110 while [#100 gt 6]
o120 while [1]
  #100 = [#100 + 1]
  o121 if [#100 ge 12]
    o120 break
  o121 endif
o120 endwhile
G55 G10 L2 P2 X-30 Y-20 Z10
G0 X10 Y10 Z10
G92 X0 Y0
G1 X5 Z3
G92.1
G10 L20 P2 X20 Y30
G1 X25 Y35
G99 G81 X10 Y10 Z-5 R2
Y20
G91 G83 X10 Z-7 R-1 Q2.5 L3
G90 G80
G98 G82 X0 Y40 Z-1 R3 P0.1
G73 X5 Z-4 R3 Q1.5
M3 S100
G86 X7 Z-4 R3 P0.1
G89 X9 Z-4 R3 P0.1
G80
G0 Z20
G18 G81 X5 Z10 Y-60 R-50
G80 G17
M70
G20 G91
G1 X0.25
M72
G1 @20 ^45
M2
%
"""


def table() -> CompensationTable:
    """Return a table with corrections of 20 µm in 4 m × 4 m × 4 m around the zero point."""
    nodes = regular_nodes(((-2000.0, 2000.0),) * 3, (200.0,) * 3)
    x, y, z = np.meshgrid(*nodes, indexing="ij")
    waves = (np.sin(x / 900.0 + y / 700.0), np.cos(y / 500.0 - z / 800.0), np.sin(z / 600.0 + x / 1500.0))
    corrections = 0.02 * np.stack(waves, axis=-1)
    return CompensationTable(*nodes, corrections, np.zeros(3), Anchor(np.zeros(3)), np.zeros(x.shape, dtype=bool))


TABLE = table()
FIELD = RegularGridInterpolator(TABLE.nodes, TABLE.corrections)


def corrected(program: Path) -> tuple[str, int]:
    """Return the corrected program and its number of moves."""
    written: list[str] = []

    def files(name: str) -> list[str] | None:
        file = program.parent / f"{name}.ngc"
        return file.read_text(errors="replace").splitlines() if file.is_file() else None

    lines = program.read_text(errors="replace").splitlines(keepends=True)
    summary = correct_program(lines, TABLE, SETUP, CorrectionOptions(CHORD_MM), written.append, name="1", files=files)
    return "".join(written), summary.moves


def without_plasma(text: str) -> str:
    """Return the program without what needs a plasma machine: its signals, material codes and second spindle."""
    text = re.sub(r"(?i)F#<_hal[^>]*>", "F1000", text)
    return re.sub(r"(?im)^M190.*$|\$\d", "", text)


def largest_difference(original: Executed, after: Executed) -> float:
    """Return the largest distance in mm between the corrected path and the one that the table asks for, both ways. The
    first move begins at the position of the axes, which is not corrected.
    """
    wanted, written = [points + FIELD(points) for points in original.feeds], after.feeds
    if wanted and not original.feeds[0][0].any():
        wanted, written = wanted[1:], written[1:]
    found = [0.0]
    if wanted:
        found.append(farthest(np.concatenate(wanted), written))
        found.append(farthest(np.concatenate(written), wanted))
    ends = [end + FIELD(end)[0] for end in original.rapids if end.any()]
    if ends:
        found.append(float(np.max(cKDTree(after.rapids).query(ends)[0])))
    return max(found)


def metric_samples() -> list[Path]:
    if RS274 is None:
        return []
    found = sorted(SAMPLES.rglob("*.ngc"))
    return [path for path in found if re.search(r"(?im)^[^(;\n]*g21\b", path.read_text(errors="replace"))]


def compare(program: Path, folder: Path) -> float | None:
    """Return the largest difference in mm of a program, or None if it does not move."""
    text, moves = corrected(program)
    if not moves:
        return None
    source, out = folder / "source.ngc", folder / "out.ngc"
    source.write_text(without_plasma(program.read_text(errors="replace")))
    out.write_text(without_plasma(text))
    return largest_difference(execute(source, folder), execute(out, folder))


def test_sample_programs_in_mm(tmp_path: Path) -> None:
    samples = metric_samples()
    refused, differences = {}, {}
    for program in samples:
        try:
            found = compare(program, tmp_path)
        except FormatError as error:
            refused[program.name] = str(error)
            continue
        if found is not None:
            differences[program.name] = found
    assert sorted(refused) == sorted(OUT_OF_SCOPE), refused
    for name, reason in OUT_OF_SCOPE.items():
        assert reason in refused[name]
    assert len(differences) >= 13
    assert max(differences.values()) < CHORD_MM, differences


def test_spiral_in_polar_coordinates(tmp_path: Path) -> None:
    """Check a sample in inches, of which `rs274` prints positions rounded to 2.5 µm in each axis."""
    found = compare(SAMPLES / "spiral.ngc", tmp_path)
    assert found is not None
    assert found < CHORD_MM + 0.5 * 0.00254 * np.sqrt(3.0)


def test_every_statement_of_the_language(tmp_path: Path) -> None:
    program = tmp_path / "part.ngc"
    program.write_text(EVERYTHING)
    found = compare(program, tmp_path)
    assert found is not None
    assert found < CHORD_MM
