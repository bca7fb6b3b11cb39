"""Command `volcal table export`, which writes a compensation table to neutral CSV and JSON files or in the format of a
controller.

For a controller's format, the command also states which part of the correction the format cannot represent.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
from click.decorators import FC

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, no_settings_file, optional_case_options
from twin.compensation.controllers.all_options import OPTIONS_OF_FORMATS, all_options, formats_with
from twin.compensation.controllers.format_options import (
    ExportOptions,
    FormatOption,
    OneOf,
    PositiveNumber,
    Switch,
    Text,
    WholeNumber,
)

if will_run():
    from rich.table import Table

    from agent.cli.printing import results_console, table_subject
    from agent.cli.table_commands.store_connection import connected
    from agent.files import write_all_atomically
    from agent.results.controller_export import (
        TableExportRequest,
        TableExportResult,
        TableToExport,
        export_table,
        load_table_to_export,
    )
    from agent.results.table_image import table_of
    from agent.results.usable_table import require_machine, require_unmarked
    from drivers.errors import InputError
    from twin.compensation.table import CompensationTable
    from twin.compensation.table_file import format_side_file, format_table


def _points(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, int, int] | None:
    if text is None:
        return None
    try:
        x, y, z = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise click.BadParameter("write points along X, Y and Z, such as 41x14x16") from None
    return x, y, z


def _click_option(option: FormatOption[object]) -> Callable[[FC], FC]:
    """Return the command-line option for an option that table formats declare. Its value is None if it is not given."""
    flag = "--" + option.key.replace("_", "-")
    match option.domain:
        case WholeNumber(minimum, maximum):
            return click.option(flag, option.key, type=click.IntRange(minimum, maximum), help=option.help)
        case PositiveNumber():
            return click.option(flag, option.key, type=click.FloatRange(min=0.0, min_open=True), help=option.help)
        case OneOf(words):
            return click.option(flag, option.key, type=click.Choice(words), help=option.help)
        case Switch():
            return click.option(flag, option.key, flag_value=True, default=None, type=bool, help=option.help)
        case Text(form, parse):
            return click.option(flag, option.key, metavar=form, callback=_parsed(parse), help=option.help)


def _parsed(parse: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, str | None], Any]:
    """Return a click callback that parses the text of an option and reports a ValueError of `parse` as a usage
    error."""

    def callback(_: click.Context, __: click.Parameter, text: str | None) -> Any:
        try:
            return None if text is None else parse(text)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None

    return callback


def options_of_formats(command: FC) -> FC:
    """Add to a command all options that the supported controller table formats declare, in the order in which the
    formats are listed.
    """
    for option in reversed(all_options()):
        command = _click_option(option)(command)
    return command


@click.command("export")
@optional_case_options
@click.option("--bank", type=int, help="Bank of the controller [default: the active one].")
@click.option("--table", "table_path", type=PATH, help="Instead of a bank: folder of a run, or CSV file of a table.")
@click.option("--estimate", type=PATH, help="Estimate of the table [default: estimate.json beside it].")
@click.option("--format", "format_name", type=click.Choice(list(OPTIONS_OF_FORMATS)), help="Format of the controller.")
@click.option("--out", type=PATH, required=True, help="Folder to write; without --format the CSV file to write.")
@click.option(
    "--points", metavar="NXxNYxNZ", callback=_points, help="Evenly spaced points instead of those of the table."
)
@click.option("--largest-um", type=click.FloatRange(min=0.0, min_open=True), default=1000.0, show_default=True)
@click.option("--opposite-sign", is_flag=True, help="Write every value with the opposite of the documented sign.")
@options_of_formats
@click.option("--even-so", is_flag=True, help="Export a table that was written although a gate did not pass.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
@reported
def export(
    *,
    config: Path | None,
    bank: int | None,
    table_path: Path | None,
    estimate: Path | None,
    format_name: str | None,
    out: Path,
    points: tuple[int, int, int] | None,
    largest_um: float,
    opposite_sign: bool,
    even_so: bool,
    as_json: bool,
    **format_options: Any,
) -> None:
    """Export a table of a bank or of a run: as neutral CSV with its side file, or with --format for a controller.

    With --format, the VE over the workspace is shown without the table, with the whole table, and with the part that
    the format can represent. Nothing is written if there is an error.
    """
    if table_path is not None and bank is not None:
        raise click.UsageError("--table and --bank name two tables: give one of the two")
    chosen = _chosen(format_name, format_options)
    if table_path is not None:
        source = load_table_to_export(table_path, estimate)
        if config is not None:
            require_machine(source.table, config, source.origin)
    elif config is not None:
        source = _from_bank(config, bank, estimate)
    else:
        raise no_settings_file()
    if not even_so:
        require_unmarked(source.table, source.origin)
    if format_name is None:
        if points or opposite_sign or as_json:
            raise click.UsageError("--points, --opposite-sign and --json need --format")
        _write_neutral(source.table, out)
        click.echo(f"{table_subject(source.table)}\n{source.origin} → {out}")
        return
    choices = ExportOptions(chosen, opposite_sign)
    result = export_table(source, TableExportRequest(format_name, out, points, largest_um, choices))
    if as_json:
        click.echo(json.dumps(result.as_json()))
    else:
        _show(result)


def _chosen(format_name: str | None, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the format options that were given. Raise UsageError for an option that the format does not use, instead
    of ignoring it."""
    chosen = {key: value for key, value in given.items() if value is not None}
    for key in chosen:
        if format_name not in formats_with(key):
            formats = ", ".join(formats_with(key))
            raise click.UsageError(f"--{key.replace('_', '-')} is an option of the formats {formats}")
    return chosen


def _from_bank(config: Path, bank: int | None, estimate: Path | None) -> TableToExport:
    with connected(config) as (job, rig):
        chosen = rig.store.active_bank() if bank is None else bank
        image = rig.store.read_table(chosen) if chosen else None
        if image is None:
            raise InputError(f"bank {chosen} holds no table", hint="`volcal table show` lists the banks", key="--bank")
        table = replace(table_of(image, job.tool_offset_mm), machine=job.machine.name)
        return TableToExport(table, f"bank {chosen}", estimate, image.resolution_mm)


def _write_neutral(table: CompensationTable, out: Path) -> None:
    texts = {out.name: format_table(table), f"{out.stem}.json": format_side_file(table)}
    write_all_atomically(out.parent, texts)


def _show(result: TableExportResult) -> None:
    found, said, console = result.loss, result.as_json(), results_console()
    console.print(table_subject(result.source.table), markup=False)
    table = Table(title=f"{result.source.origin} for {result.request.format}", title_justify="left")
    table.add_column("volumetric error")
    table.add_column("aligned", justify="right")
    for name, value in (("before", found.before), ("with the whole table", found.full), ("as written", found.reduced)):
        table.add_row(name, f"{value.aligned_um:.2f} µm")
    console.print(table)
    machine = "as estimated" if found.estimated else "as the table describes it (no estimate)"
    retained = f"{100.0 * found.retained_share:.0f} % of the improvement is retained"
    console.print(f"The machine is assumed {machine}; {retained}.")
    if found.unknown_mm is not None:
        console.print(
            f"The uncertainty of the estimate adds {1e3 * found.unknown_mm:.2f} µm to each (root sum of squares)."
        )
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
    if result.source.table.gates_not_passed:
        failed = ", ".join(result.source.table.gates_not_passed)
        console.print(f"The table did not pass the gates: {failed}.", style="yellow")
    if result.request.options.opposite_sign:
        console.print("Every value has the OPPOSITE sign of the documented one.", style="yellow")
    for name in result.exported.files:
        console.print(str(result.request.out / name), markup=False)
