"""Decoders of files: TOML, CSV, JSON and part programs, with the shipped files as good inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from agent.files import read_text
from agent.finite_elements.mesh_results import ProbeOptions, probe_mesh
from agent.settings.schema import parse_settings
from campaigns.fuzz.certificate_decoders import certificate_decoders
from campaigns.fuzz.memory_file import MemoryFile, MemoryFolder
from campaigns.fuzz.trial import Decoder
from campaigns.part_programs.comparison import SETUP, TABLE
from drivers.errors import InputError
from drivers.roles import TableImage
from drivers.serial_cnc.tape.blocks import TapeError, parse_tape
from drivers.tables.text import format_table as format_bank
from drivers.tables.text import parse_table as parse_bank
from gcode.correction import correct_program
from gcode.setup import CorrectionOptions
from gcode.setup_file import parse_part_setup
from simulators.scenario import read_scenario
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import format_side_file, format_table, parse_table
from twin.finite_elements.listing import parse_listing
from twin.finite_elements.result_tables import parse_positions_of_results, parse_results_by_step
from twin.finite_elements.structure_file import parse_structure
from twin.formats.artefact_file import parse_artefact
from twin.formats.ball_file import parse_balls
from twin.formats.deflection_file import format_deflection, parse_deflection
from twin.formats.machine_file import parse_machine
from twin.formats.position_set_file import parse_positions
from twin.machine.anchor import Anchor
from twin.machine.deflection import DeflectionGrid, cantilever_deflection
from twin.machine.machine_description import MachineDescription

CONFIG = Path(__file__).resolve().parents[2] / "config"
CASE = CONFIG / "case-study.toml"
MACHINE = CONFIG / "machines" / "case-study.toml"
STRUCTURE = CONFIG / "structures" / "case-study.toml"
SCENARIO = "scenario.toml"
HEAD = b"N10 G21 G90 G17 G54 F500 S1000 M3\nN20 #1 = [2 * [3 + 4]]\n"
PROGRAMS = (
    b"%\n" + HEAD + b"N30 G0 X0 Y0 Z10\nN40 G1 X[#1 / 2] Y-3.5 Z1.25 F300\nN50 G2 X10 Y0 R5\nM30\n%\n",
    HEAD + b"N60 G81 X20 Y5 Z-3 R2 L2\nN140 G90 G3 X0 Y0 R40\nN150 G43 H1 (comment) ; and another\nN160 G28 X0\n",
    HEAD + b"o100 while [#1 LT 30]\n#1 = [#1 + 5]\nG1 X#1\no100 endwhile\no200 if [#1 GT 5]\nG91 G1 X1\no200 endif\n",
)
"""Short programs, so that most of the time of an input belongs to what was changed in it."""
MOST_WRITTEN_LINES = 4096
PART_SETUP = b"""[work_offsets_mm]
G54 = [100.0, 200.0, 300.0]
"""
LISTING = b"""  ***** POST1 NODAL DEGREE OF FREEDOM LISTING *****

  LOAD STEP=     1  SUBSTEP=     1
   TIME=    1.0000      LOAD CASE=   0

  THE FOLLOWING DEGREE OF FREEDOM RESULTS ARE IN THE GLOBAL COORDINATE SYSTEM

    NODE       UX           UY           UZ           USUM
     901  0.10000E-05-0.20000E-05-0.30000E-05 0.37417E-05
     902  0.0000       0.0000      0.12345E-004 0.12345E-004

 MAXIMUM ABSOLUTE VALUES
 NODE        901          901          901          901
 VALUE   0.10000E-05-0.20000E-05-0.30000E-05 0.37417E-05
"""
FE_RESULTS = b"load_step,node,ux,uy,uz,rotx,roty,rotz\n1,901,1e-6,-2e-6,3e-6,1e-5,0,0\n2,901,0,0,0,0,0,0\n"
MESH = b"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="0.1" byte_order="LittleEndian"><UnstructuredGrid>
<Piece NumberOfPoints="4" NumberOfCells="1"><Points>
<DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points>
<Cells><DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">4</DataArray>
<DataArray type="Int64" Name="types" format="ascii">10</DataArray></Cells>
<PointData><DataArray type="Float64" Name="displacement" NumberOfComponents="3" format="ascii">
0 0 0 1e-3 0 0 0 2e-3 0 0 0 3e-3</DataArray></PointData></Piece></UnstructuredGrid></VTKFile>
"""
PUNCHED = b"%\nN10G0X0Y0Z0\nN20G1X1.5Y-2.5F100\nM30\n%\n"


def _small_grid() -> DeflectionGrid:
    x, y, z = np.array([0.0, 2000.0, 4000.0]), np.array([0.0, 1300.0]), np.array([-10.5, 1500.0])
    return cantilever_deflection(x, y, z)


def _coarse(table: CompensationTable) -> CompensationTable:
    """Return the table with the nodes at its corners only."""
    corners = np.ix_((0, -1), (0, -1), (0, -1))
    x, y, z = (nodes[[0, -1]] for nodes in table.nodes)
    return replace(
        table, x=x, y=y, z=z, corrections=table.corrections[corners], extrapolated=table.extrapolated[corners]
    )


COARSE_TABLE = _coarse(TABLE)
SMALL_GRID = format_deflection(_small_grid())
GRID = "case-study-deflection.csv"
"""Name of the shipped grid, which the machine file states."""


def file_decoders() -> Iterator[Decoder]:
    machine = _described_machine()
    yield _text("settings (TOML)", [CASE, CONFIG / "grbl.toml"], lambda text: parse_settings(text, "volcal.toml"))
    yield _text("machine (TOML)", [MACHINE], lambda text: parse_machine(text, "machine.toml", _beside(MACHINE)))
    artefacts = sorted((CONFIG / "artefacts").glob("*.toml"))
    yield _text("artefact (TOML)", artefacts, lambda text: parse_artefact(text, "artefact.toml", lambda _: ""))
    yield Decoder("part set-up (TOML)", [PART_SETUP], _decoding(lambda text: parse_part_setup(text, "part.toml")))
    yield _scenario_decoder()
    positions = [CONFIG / "bridge-positions.csv", CONFIG / "hand-placed-positions.csv"]
    yield _text("positions (CSV)", positions, lambda text: parse_positions(text, "positions.csv"))
    rows = (CONFIG / "examples" / "case-study-balls.csv").read_bytes().splitlines(keepends=True)
    # A few rows of two positions: nearly every change to all 260 meets a cell of the same kind. So it is with a grid.
    balls = [b"".join([rows[0], *rows[1:5], *rows[-4:]])]
    read_balls = _decoding(lambda text: parse_balls(text, "balls.csv", machine.tools, travel=machine.limits))
    yield Decoder("balls (CSV)", balls, read_balls)
    grid = [SMALL_GRID.encode()]
    yield Decoder("deflection (CSV)", grid, _decoding(lambda text: parse_deflection(text, "deflection.csv")))
    yield from _finite_element_decoders()
    table, side = format_table(_small_table()), format_side_file(_small_table())
    yield Decoder("table (CSV)", [table.encode()], _decoding(lambda text: parse_table(text, side, "t.csv", "t.json")))
    yield Decoder("table (JSON)", [side.encode()], _decoding(lambda text: parse_table(table, text, "t.csv", "t.json")))
    counts = np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3)
    bank = format_bank(TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, counts))
    yield Decoder("bank of a controller (text)", [bank.encode()], _decoding(parse_bank))
    yield Decoder("part program", PROGRAMS, _correct)
    yield Decoder("punched tape", [PUNCHED], _decoding(parse_tape), (TapeError,))
    yield from certificate_decoders()


def _text(name: str, paths: list[Path], parse: Callable[[str], object]) -> Decoder:
    return Decoder(name, [path.read_bytes() for path in paths], _decoding(parse))


def _decoding(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    """Return a decoder of bytes that reads them from a file as the commands do."""
    file = MemoryFile()
    return lambda data: parse(read_text(file.holding(data)))


def _scenario_decoder() -> Decoder:
    """Return the decoder of scenarios. The files that one names lie beside its folder, as the shipped ones do."""
    folder = MemoryFolder()
    good = (CONFIG / "simulators" / "case-study.toml").read_bytes()
    machine = MACHINE.read_bytes()

    def read(path: Path) -> object:
        (path / "artefacts").symlink_to(CONFIG / "artefacts")
        machines = path / "machines"
        machines.mkdir()
        (machines / MACHINE.name).write_bytes(machine)
        (machines / GRID).write_text(SMALL_GRID, encoding="utf-8")
        moved = path / "simulators"
        moved.mkdir()
        return read_scenario((path / SCENARIO).rename(moved / SCENARIO))

    return Decoder("scenario (TOML)", [good], lambda data: folder.reading({SCENARIO: data}, read))


def _correct(data: bytes) -> object:
    """Correct a part program up to some thousand written lines: a short one may ask for millions."""
    lines = data.decode(errors="surrogateescape").splitlines(keepends=True)
    written = 0

    def emit(text: str) -> None:
        nonlocal written
        written += text.count("\n")
        if written > MOST_WRITTEN_LINES:
            raise InputError(f"the program has more than {MOST_WRITTEN_LINES} lines")

    return correct_program(lines, COARSE_TABLE, SETUP, CorrectionOptions(0.01), emit)


def _described_machine() -> MachineDescription:
    return parse_machine(MACHINE.read_text(), str(MACHINE), _beside(MACHINE))


def _beside(path: Path) -> Callable[[str], str]:
    """Return the function that reads the files beside that at `path`, and a small grid instead of the shipped one."""
    return lambda name: SMALL_GRID if name == GRID else read_text(path.parent / name, error=InputError)


def _finite_element_decoders() -> Iterator[Decoder]:
    yield Decoder("FE listing (text)", [LISTING], _decoding(lambda text: parse_listing(text, "r.lis")))
    yield Decoder("FE results (CSV)", [FE_RESULTS], _decoding(lambda text: parse_results_by_step(text, "r.csv")))
    positions = [b"x_mm,y_mm,z_mm,file,load_step,node\n0,0,0,r.lis,1,901\n10.5,-2,3e2,r.lis,2,901\n"]
    yield Decoder("FE positions (CSV)", positions, _decoding(lambda text: parse_positions_of_results(text, "p.csv")))
    yield _text("FE structure (TOML)", [STRUCTURE], lambda text: parse_structure(text, "s.toml"))
    folder = MemoryFolder()
    options = ProbeOptions(interpolate=True)

    def probe(path: Path) -> object:
        return probe_mesh(path / "m.vtu", np.array([0.1, 0.1, 0.1]), options)

    yield Decoder("FE mesh (VTU)", [MESH], lambda data: folder.reading({"m.vtu": data}, probe))


def _small_table() -> CompensationTable:
    nodes = (np.array([0.0, 1000.0]), np.array([0.0, 500.0]), np.array([0.0, 300.0]))
    corrections = np.linspace(-0.01, 0.01, 24).reshape(2, 2, 2, 3)
    return CompensationTable(*nodes, corrections, np.zeros(3), Anchor(np.zeros(3)), np.zeros((2, 2, 2), dtype=bool))
