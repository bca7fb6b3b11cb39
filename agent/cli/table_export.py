"""`volcal table export`: a table as neutral files, or in the words of a controller with what is lost."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.table import Table

from agent.cli.errors import reported
from agent.cli.options import config_option
from agent.cli.store_connection import connected
from agent.files import write_all_atomically
from agent.results.controller_export import Material, Request, Result, export_table, table_in_files
from agent.results.table_image import table_of
from drivers.errors import InputError
from twin.compensation.controllers.export_format import ExportOptions
from twin.compensation.controllers.registry import WRITERS
from twin.compensation.table import CompensationTable
from twin.compensation.table_file import format_side_file, format_table

PATH = click.Path(path_type=Path)
_KNOWN_BY: Mapping[str, tuple[str, ...]] = {
    "reference_mm": ("linuxcnc-comp", "siemens-lec", "siemens-cec", "heidenhain-com", "fanuc-pitch", "fanuc-3d"),
    "axis_names": ("siemens-lec", "siemens-cec", "heidenhain-com"),
    "encoder": ("siemens-lec",),
    "first_table": ("siemens-cec",),
    "most_tables": ("siemens-cec",),
    "products": ("siemens-cec",),
    "detection_unit_um": ("fanuc-pitch", "fanuc-3d"),
    "magnification": ("fanuc-pitch", "fanuc-3d"),
    "bank_letter": ("heidenhain-com",),
}
"""Which formats know an option; the others are refused, so that nobody believes it was heeded."""

_OPTION = {"axis_names": "--axes", "most_tables": "--tables", "products": "--no-products", "bank_letter": "--cma-bank"}


def _points(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, int, int] | None:
    if text is None:
        return None
    try:
        x, y, z = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise click.BadParameter("write points along X, Y and Z, such as 41x14x16") from None
    return x, y, z


def _place(_: click.Context, __: click.Parameter, text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise click.BadParameter("write three positions in mm, such as 0,650,0") from None
    return x, y, z


def _names(_: click.Context, __: click.Parameter, text: str | None) -> tuple[str, str, str] | None:
    if text is None:
        return None
    names = tuple(part.strip() for part in text.split(","))
    if len(set(names)) != 3 or len(names) != 3 or not all(name.isidentifier() for name in names):
        raise click.BadParameter("write three different names of letters and digits for X, Y and Z, such as X1,Y1,Z1")
    return names[0], names[1], names[2]


@click.command("export")
@config_option
@click.option("--bank", type=int, help="Bank of the controller; the active one when not said.")
@click.option("--table", "table_path", type=PATH, help="Instead of a bank: folder of a run, or a table's CSV file.")
@click.option("--estimate", type=PATH, help="Estimate of the table [default: estimate.json beside it].")
@click.option("--format", "format_name", type=click.Choice(list(WRITERS)), help="In the words of this controller.")
@click.option("--out", type=PATH, required=True, help="Folder to write; without --format the CSV file to write.")
@click.option("--points", metavar="NXxNYxNZ", callback=_points, help="Evenly spaced points instead of the table's.")
@click.option("--reference-mm", metavar="X,Y,Z", callback=_place, help="Reference point [default: the anchor].")
@click.option("--largest-um", type=click.FloatRange(min=0.0, min_open=True), default=1000.0, show_default=True)
@click.option("--opposite-sign", is_flag=True, help="Every value with the other sign than documented.")
@click.option("--axes", "axis_names", metavar="X1,Y1,Z1", callback=_names, help="Names of X, Y, Z in the controller.")
@click.option("--encoder", type=click.IntRange(0, 1), help="Siemens LEC: measuring system, 0 or 1.")
@click.option("--first-table", type=click.IntRange(min=0), help="Siemens CEC: index of the first table.")
@click.option("--tables", "most_tables", type=click.IntRange(min=1), help="Siemens CEC: so many at most [default: 62].")
@click.option("--no-products", "products", flag_value=False, default=None, type=bool, help="Siemens CEC: no factors.")
@click.option("--detection-unit-um", type=click.FloatRange(min=0.0, min_open=True), help="Fanuc: [default: 1].")
@click.option("--magnification", type=click.IntRange(1, 100), help="Fanuc: [default: the smallest that fits].")
@click.option("--cma-bank", "bank_letter", type=click.Choice(["A", "B"]), help="HEIDENHAIN: active line [default: A].")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout.")
@reported
def export(
    *,
    config: Path,
    bank: int | None,
    table_path: Path | None,
    estimate: Path | None,
    format_name: str | None,
    out: Path,
    points: tuple[int, int, int] | None,
    largest_um: float,
    opposite_sign: bool,
    as_json: bool,
    **of_controllers: Any,
) -> None:
    """A table of a bank or of a run: as neutral CSV with its side file, or with --format for a controller.

    With --format, VE before, with the whole table and with what the format can say of it is computed over the
    workspace and shown. Nothing is written where something is wrong.
    """
    if table_path is not None and bank is not None:
        raise click.UsageError("--table and --bank name two tables: give one of them")
    chosen = _chosen(format_name, of_controllers)
    material = _from_bank(config, bank, estimate) if table_path is None else table_in_files(table_path, estimate)
    if format_name is None:
        if points or opposite_sign or as_json:
            raise click.UsageError("--points, --opposite-sign and --json need --format")
        _write_neutral(material.table, out)
        click.echo(f"{material.origin} → {out}")
        return
    choices = ExportOptions(opposite_sign=opposite_sign, **chosen)
    result = export_table(material, Request(format_name, out, points, largest_um, choices))
    if as_json:
        click.echo(json.dumps(result.as_json()))
    else:
        _show(result)


def _chosen(format_name: str | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Those options that were given, as `ExportOptions` calls them."""
    chosen = {name: value for name, value in given.items() if value is not None}
    for name in chosen:
        if format_name not in _KNOWN_BY[name]:
            option = _OPTION.get(name, "--" + name.replace("_", "-"))
            raise click.UsageError(f"{option} is of the formats {', '.join(_KNOWN_BY[name])}")
    if "bank_letter" in chosen:
        chosen["bank"] = chosen.pop("bank_letter")
    return {field.name: chosen[field.name] for field in fields(ExportOptions) if field.name in chosen}


def _from_bank(config: Path, bank: int | None, estimate: Path | None) -> Material:
    with connected(config) as (job, rig):
        chosen = rig.store.active_bank() if bank is None else bank
        image = rig.store.read_table(chosen) if chosen else None
        if image is None:
            raise InputError(f"bank {chosen} holds no table", hint="`volcal table show` lists the banks", key="--bank")
        return Material(table_of(image, job.tool_offset_mm), f"bank {chosen}", estimate, image.resolution_mm)


def _write_neutral(table: CompensationTable, out: Path) -> None:
    texts = {out.name: format_table(table), f"{out.stem}.json": format_side_file(table)}
    write_all_atomically(out.parent, texts)


def _show(result: Result) -> None:
    found, said, console = result.loss, result.as_json(), Console(highlight=False, soft_wrap=True)
    table = Table(title=f"{result.material.origin} for {result.request.format}", title_justify="left")
    table.add_column("volumetric error")
    table.add_column("aligned", justify="right")
    table.add_column("as defined", justify="right")
    for name, value in (("before", found.before), ("with the whole table", found.full), ("as written", found.reduced)):
        table.add_row(name, f"{value.aligned_um:.2f} µm", f"{value.raw_um:.2f} µm")
    console.print(table)
    machine = "as estimated" if found.estimated else "as the table describes it (no estimate)"
    console.print(
        f"The machine is taken {machine}; {100.0 * found.retained_share:.0f} % of what the table removes is kept."
    )
    if found.unknown_mm is not None:
        console.print(f"What the estimate does not know adds {1e3 * found.unknown_mm:.2f} µm to each (as squares).")
    at, moves = (", ".join(f"{value:g}" for value in said[key]) for key in ("check_at_mm", "check_moves_um"))
    console.print(f"To check the sign: at {at} mm, switching it on must move X, Y, Z by {moves} µm.")
    tool = ", ".join(f"{value:g}" for value in said["tool_offset_mm"])
    outside = (
        f"; {said['extrapolated_percent']:g} % of its nodes were not measured" if said["extrapolated_percent"] else ""
    )
    console.print(f"The table holds for the tool offset {tool} mm{outside}.")
    for text in result.exported.losses:
        console.print(f"lost: {text}", markup=False)
    for name, fact in result.exported.facts.items():
        console.print(f"{name}: {fact}", markup=False)
    if result.request.choices.opposite_sign:
        console.print("Every value has the OPPOSITE sign of the documented one.", style="yellow")
    for name in result.exported.files:
        console.print(str(result.request.out / name), markup=False)
