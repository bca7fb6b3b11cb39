"""Command `volcal gcode correct`, which corrects a part program with a compensation table."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Literal

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, optional_case_options

if will_run():
    from agent.cli.printing import table_subject
    from agent.results.part_programs import correct_file, correct_to, load_part_setup, load_table
    from agent.results.usable_table import require_machine, require_unmarked
    from drivers.clock import wall_seconds
    from gcode.correction_summary import CorrectionSummary
    from gcode.setup import SYSTEMS, CorrectionOptions, PartSetup, Triple
    from twin.compensation.table import CompensationTable

_LENGTH = re.compile(r"(\d+\.?\d*|\.\d+)\s*(um|µm|μm|mm)$")
_PARAMETER = re.compile(r"#?<?(\w[^=<>]*?)>?\s*=\s*([-+]?(?:\d+\.?\d*|\.\d+))$")
_G_CODE = re.compile(r"G?(\d+)(?:\.(\d))?$", re.IGNORECASE)


def _length_mm(_: click.Context, __: click.Parameter, text: str) -> float:
    found = _LENGTH.match(text.strip())
    value = float(found[1]) * (1.0 if found[2] == "mm" else 1e-3) if found else 0.0
    if not value > 0.0:
        raise click.BadParameter(f"'{text}' is not a length above 0: write 2um or 0.002mm")
    return value


def _triple(text: str) -> Triple:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter(f"'{text}' is not X,Y,Z in mm, such as 100,200,-50.5") from None
    return x, y, z


def _start(_: click.Context, __: click.Parameter, text: str | None) -> Triple | None:
    return None if text is None else _triple(text)


def _named(_: click.Context, parameter: click.Parameter, texts: Sequence[str]) -> dict[str, Triple]:
    """Return the values of an option that may be given several times as NAME=X,Y,Z."""
    known = {"work_offset": SYSTEMS, "reference": ("G28", "G30")}.get(parameter.name or "", ())
    found = {}
    for text in texts:
        name, _equals, numbers = text.partition("=")
        name = name.strip().upper()
        if (known and name not in known) or (not known and not name.isdecimal()):
            raise click.BadParameter(f"'{name}' is not {'one of ' + ', '.join(known) if known else 'a tool number'}")
        found[name] = _triple(numbers)
    return found


def _g_codes(_: click.Context, __: click.Parameter, texts: Sequence[str]) -> frozenset[int]:
    codes = set()
    for text in texts:
        found = _G_CODE.match(text.strip())
        if found is None:
            raise click.BadParameter(f"'{text}' is not a G code such as G5.1")
        codes.add(10 * int(found[1]) + int(found[2] or 0))
    return frozenset(codes)


def _parameters(_: click.Context, __: click.Parameter, texts: Sequence[str]) -> dict[str, float]:
    values = {}
    for text in texts:
        found = _PARAMETER.match(text.strip())
        if found is None:
            raise click.BadParameter(f"'{text}' is not a number or name with its value, such as 100=2.5 or _depth=3")
        values[found[1].lower()] = float(found[2])
    return values


@click.group("gcode", cls=VolcalGroup)
def gcode_group() -> None:
    """Correct part programs for controllers that have no compensation table."""


@gcode_group.command("correct")
@click.argument("part", type=PATH, metavar="PART.nc")
@click.option(
    "--table", "table_file", type=PATH, required=True, help="table.csv, with its JSON side file in the same folder."
)
@optional_case_options
@click.option(
    "--max-chord-error",
    callback=_length_mm,
    required=True,
    metavar="LENGTH",
    help="Largest distance of the straight segments from the corrected curve: 2um, 0.002mm.",
)
@click.option("-o", "--out", type=PATH, metavar="OUT.nc", help="Corrected program [default: standard output].")
@click.option(
    "--setup", "setup_file", type=PATH, help="Work offsets, tools and start position of the controller (TOML)."
)
@click.option(
    "--work-offset",
    multiple=True,
    callback=_named,
    metavar="G54=X,Y,Z",
    help="Axis position of the zero of a work offset.",
)
@click.option("--tool", multiple=True, callback=_named, metavar="H=X,Y,Z", help="Offset that G43 H adds, in mm.")
@click.option(
    "--reference", multiple=True, callback=_named, metavar="G28=X,Y,Z", help="Axis position at the end of G28."
)
@click.option("--start", callback=_start, metavar="X,Y,Z", help="Axis position before the first block.")
@click.option("--tool-change", type=click.Choice(["moves", "stays"]), help="Whether M6 may move axes [default: moves].")
@click.option(
    "--parameter",
    multiple=True,
    callback=_parameters,
    metavar="NAME=VALUE",
    help="Value of a parameter in the controller before the program: 100=2.5, _depth=3.",
)
@click.option(
    "--outside",
    type=click.Choice(["refuse", "clamp"]),
    default="refuse",
    show_default=True,
    help="Points outside the table: refuse, or correct as at its border.",
)
@click.option(
    "--decimals",
    type=click.IntRange(2, 8),
    default=4,
    show_default=True,
    help="Decimals of values in mm; values in inches get one more.",
)
@click.option("--divide-rapids", is_flag=True, help="Divide G0 moves too, not only G1 to G3.")
@click.option("--keep", multiple=True, callback=_g_codes, metavar="G", help="Pass this unknown G code through.")
@click.option("--even-so", is_flag=True, help="Use a table that was written although a gate did not pass.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout; the program then needs --out.")
@reported
def correct(
    *,
    part: Path,
    config: Path | None,
    table_file: Path,
    max_chord_error: float,
    out: Path | None,
    setup_file: Path | None,
    work_offset: dict[str, Triple],
    tool: dict[str, Triple],
    reference: dict[str, Triple],
    start: Triple | None,
    tool_change: Literal["moves", "stays"] | None,
    parameter: dict[str, float],
    outside: Literal["refuse", "clamp"],
    decimals: int,
    divide_rapids: bool,
    keep: frozenset[int],
    even_so: bool,
    as_json: bool,
) -> None:
    """Add the corrections of a table to the positions of a part program (G-code).

    Lines and arcs are divided into straight segments within the chord error. Parameters, O-words, subprograms and
    canned cycles become single moves. A block that cannot be corrected is
    refused with its line number (exit code 2), and nothing is written.
    """
    started = wall_seconds()
    if as_json and out is None:
        raise click.UsageError("--json and the program cannot both go to standard output: give --out")
    table, crc = load_table(table_file)
    if not even_so:
        require_unmarked(table, str(table_file))
    if config is not None:
        require_machine(table, config, str(table_file))
    setup = load_part_setup(setup_file) if setup_file else PartSetup()
    setup = replace(
        setup,
        work_offsets={**setup.work_offsets, **work_offset},
        reference_points={**setup.reference_points, **reference},
        tools={**setup.tools, **{int(number): offset for number, offset in tool.items()}},
        start=start or setup.start,
        parameters={**setup.parameters, **parameter},
        tool_change_moves=setup.tool_change_moves if tool_change is None else tool_change == "moves",
    )
    options = CorrectionOptions(max_chord_error, decimals, outside, divide_rapids, keep)
    name = f"table {crc}, tool offset {_joined(table)}"
    if out is None:
        counts = correct_to(sys.stdout.buffer, part, table, name, setup, options)
    else:
        counts = correct_file(part, out, table, name, setup, options)
    if as_json:
        click.echo(json.dumps(_document(counts, part, out, table, crc, wall_seconds() - started)))
    else:
        for line in _told(counts, part, out, table):
            click.echo(line, err=True)


def _joined(table: CompensationTable) -> str:
    return " ".join(f"{value:g}" for value in table.tool_offset)


def _document(
    counts: CorrectionSummary, part: Path, out: Path | None, table: CompensationTable, crc: str, seconds: float
) -> dict[str, Any]:
    document: dict[str, Any] = {"part": str(part), "out": str(out)}
    for name, value in asdict(counts).items():
        document[name.replace("_mm", "_um")] = round(1e3 * value, 4) if name.endswith("_mm") else value
    document |= {"machine": table.machine or None, "artefact": table.artefact or None}
    return {**document, "table_crc32": crc, "tool_offset_mm": table.tool_offset.tolist(), "wall_seconds": seconds}


def _told(counts: CorrectionSummary, part: Path, out: Path | None, table: CompensationTable) -> list[str]:
    told = [
        table_subject(table),
        f"{part}: {counts.moves} moves corrected, by up to {1e3 * counts.largest_correction_mm:.1f} µm; "
        f"{counts.divided} divided, {counts.arcs} arcs; {counts.lines} lines became {counts.written_lines}",
        f"the table holds for the tool offset ({_joined(table)}) mm",
    ]
    if counts.not_corrected:
        told.append(f"note: {counts.not_corrected} rapid moves from an unknown position were left as they are")
    if counts.outside:
        told.append(f"note: {counts.outside} points lie up to {counts.outside_mm:.3f} mm outside the table")
    if counts.held:
        told.append(
            f"note: {counts.held} points were held at its border, up to {1e3 * counts.held_mm:.1f} µm are missing"
        )
    if counts.extrapolated:
        told.append(f"note: {counts.extrapolated} points lie where nothing was measured")
    return [*told, f"written: {out}"] if out else told
