"""Command `volcal acceptance`, which predicts the figures of acceptance tests after ISO 230 from an estimate.

The command contacts no device.
"""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH
from agent.cli.triples import point_in_mm

if will_run():
    from rich.console import Console

    from agent.cli.offline_commands.error_cells import UNCERTAINTY_HEADING, error_cells
    from agent.cli.printing import columns_table, results_console
    from agent.files import write_all_atomically
    from agent.workpiece.predicted_tests import AcceptanceRequest, PredictedTests, predict_acceptance

NAME = "acceptance"


@click.command(NAME)
@click.option(
    "--estimate", type=PATH, required=True, help="estimate.json, or the folder of a run or of `volcal identify`."
)
@click.option("--table", type=PATH, metavar="TABLE.csv", help="Table [default: table.csv beside the estimate].")
@click.option("--no-table", is_flag=True, help="Predict the machine without compensation only.")
@click.option(
    "--centre",
    callback=point_in_mm,
    metavar="X,Y,Z",
    help="Axis position in mm through which the lines pass and about which the circles run [default: the middle].",
)
@click.option(
    "--radius",
    "radii",
    type=click.FloatRange(min=1.0, max=1e5),
    multiple=True,
    metavar="MM",
    help="Radius of the circles; repeat the option for several [default: 150, or less if the travel is short].",
)
@click.option(
    "--tool-offset",
    callback=point_in_mm,
    metavar="X,Y,Z",
    help="Offset in mm of the reflector or of the ball of the ballbar [default: that of the table].",
)
@click.option("--draw", type=PATH, metavar="DIR", help="Write acceptance.png and acceptance.svg into DIR.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout instead of a table.")
@reported
def acceptance_command(
    *,
    estimate: Path,
    table: Path | None,
    no_table: bool,
    centre: tuple[float, float, float] | None,
    radii: tuple[float, ...],
    tool_offset: tuple[float, float, float] | None,
    draw: Path | None,
    as_json: bool,
) -> None:
    """Predict what a laser and a ballbar will show: the figures of ISO 230, each with its uncertainty.

    Positioning (ISO 230-2), straightness, squareness and angles (ISO 230-1), circles (ISO 230-4) and body diagonals
    (ISO 230-6). A, E, R and B of ISO 230-2 need the folder of a run that measured lost motion and repeatability.
    """
    if table is not None and no_table:
        raise click.UsageError("--table and --no-table exclude each other")
    found = predict_acceptance(AcceptanceRequest(estimate, table, no_table, centre, radii, tool_offset))
    if draw is not None:
        from agent.workpiece.acceptance_figure import draw_tests  # noqa: PLC0415  matplotlib takes a second to import

        drawn = draw_tests((*found.tests, *found.angles), found.heading)
        write_all_atomically(draw, {f"{NAME}.png": drawn.png, f"{NAME}.svg": drawn.svg})
    if as_json:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
    else:
        _show(found, results_console())


def _show(found: PredictedTests, console: Console) -> None:
    console.print(found.heading, markup=False)
    states = ("without table", "with table") if found.table is not None else ("without table",)
    headings = ["standard", "figure", "meaning"]
    for state in states:
        headings += [f"{state} / µm", UNCERTAINTY_HEADING]
    shown = columns_table(headings, whole=("standard", "figure"), numbers=headings[3:])
    for one in found.all_tests:
        cells = [one.test.standard, one.test.feature.name, one.test.title]
        for error in (one.figure.without_table, one.figure.with_table):
            if error is not None:
                cells += error_cells(one.test.feature, error)
        shown.add_row(*cells)
    console.print(shown)
    for note in found.not_measured:
        console.print(note, markup=False)
    console.print(
        "A, E, R and B contain what the run measured of lost motion and repeatability at one place. All other figures "
        "are those of the geometry alone: without reversal, repeatability and the servo errors of a moving ballbar.",
        markup=False,
    )
