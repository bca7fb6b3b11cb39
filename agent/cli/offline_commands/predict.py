"""Command `volcal predict`, which predicts the errors of the features of a workpiece and says which will conform to
their tolerances.

The command contacts no device.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable
from math import degrees, radians
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import FIGURE, PATH
from agent.cli.triples import parse_triple, point_in_mm

if will_run():
    from rich.console import Console
    from rich.text import Text

    from agent.cli.offline_commands.error_cells import UNCERTAINTY_HEADING, error_cells
    from agent.cli.printing import columns_table, results_console
    from agent.files import write_all_atomically, write_atomically
    from agent.workpiece.estimate_and_table import files_read
    from agent.workpiece.predicted_features import (
        RULE,
        PredictedFeatures,
        PredictionRequest,
        WantedPlace,
        csv_lines,
        predict_file,
    )
    from twin.units import UM_PER_MM
    from twin.workpiece.best_place import PlaceMap
    from twin.workpiece.conformity import Conformity
    from twin.workpiece.features import Tolerance
    from twin.workpiece.placement import Placement
    from twin.workpiece.prediction import FeatureError

BEST = "best"
_COLOURS = {"conforms": "green", "does not conform": "red", "undecided": "yellow", "no tolerance": "default"}


def _place(_: click.Context, __: click.Parameter, text: str) -> tuple[float, float, float] | None:
    """Parse the place of the workpiece; the word `best` is None."""
    return None if text.strip().lower() == BEST else parse_triple(text, f", or the word {BEST}")


@click.command("predict")
@click.argument("features", type=PATH, metavar="FEATURES.csv")
@click.option(
    "--estimate", type=PATH, required=True, help="estimate.json, or the folder of a run or of `volcal identify`."
)
@click.option("--table", type=PATH, metavar="TABLE.csv", help="Table [default: table.csv beside the estimate].")
@click.option("--no-table", is_flag=True, help="Predict the machine without compensation only.")
@click.option(
    "--at",
    "origin",
    callback=_place,
    required=True,
    metavar="X,Y,Z|best",
    help="Place of the workpiece's origin in mm, for the tip of the tool, or `best` for the place with the smallest "
    "errors.",
)
@click.option(
    "--height", type=click.FloatRange(-1e5, 1e5), metavar="MM", help="With --at best: Z of the workpiece's origin."
)
@click.option(
    "--turned-deg",
    type=click.FloatRange(-360.0, 360.0),
    default=0.0,
    help="Turn of the workpiece about Z [default: 0].",
)
@click.option(
    "--tool-offset",
    callback=point_in_mm,
    metavar="X,Y,Z",
    help="Offset of the tool that machines the workpiece, in mm [default: that of the table].",
)
@click.option("--map", "map_file", type=FIGURE, help="Picture of the errors at other places: .png, .svg, .pdf.")
@click.option("-o", "--out", type=PATH, metavar="OUT.csv", help="Write the predictions to a CSV file as well.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout instead of a table.")
@reported
def predict_command(
    *,
    features: Path,
    estimate: Path,
    table: Path | None,
    no_table: bool,
    origin: tuple[float, float, float] | None,
    height: float | None,
    turned_deg: float,
    tool_offset: tuple[float, float, float] | None,
    map_file: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Predict the errors of the features of a workpiece, with their uncertainty, and say which will conform.

    FEATURES.csv contains the points, distances, diameters, positions of holes and faces of a drawing, with their
    tolerances: see docs/reference/files.md. Exit code 4 means that a feature does not conform, or that nothing can be
    said about it, with the table if there is one.
    """
    if table is not None and no_table:
        raise click.UsageError("--table and --no-table exclude each other")
    if (origin is None) != (height is not None):
        raise click.UsageError("--height belongs to --at best, which needs it")
    _check_outputs([out, map_file], [features, *files_read(estimate, table)])
    found = predict_file(
        PredictionRequest(
            features=features,
            estimate=estimate,
            table=table,
            without_table=no_table,
            tool_offset_mm=tool_offset,
            place=WantedPlace(origin, height or 0.0, radians(turned_deg), with_map=map_file is not None),
        )
    )
    if out is not None:
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows(csv_lines(found.predictions))
        write_atomically(out, text.getvalue())
    if map_file is not None and found.places is not None:
        _write_map(found.places, found.placement, map_file)
    if as_json:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
    else:
        _show(found, results_console())
    if not all(_is_accepted(one.with_table or one.without_table) for one in found.predictions):
        raise SystemExit(4)


def _check_outputs(outputs: Iterable[Path | None], inputs: Iterable[Path | None]) -> None:
    """Raise BadParameter if a result would replace a file that is read, or the other result."""
    taken = {path.resolve() for path in inputs if path is not None}
    for path in outputs:
        if path is None:
            continue
        if path.resolve() in taken:
            raise click.BadParameter(
                f"'{path}' is read or written by this command and would be replaced; write to another file"
            )
        taken.add(path.resolve())


def _is_accepted(error: FeatureError) -> bool:
    return error.conformity in {Conformity.CONFORMS, Conformity.NO_TOLERANCE}


def _write_map(places: PlaceMap, placement: Placement, file: Path) -> None:
    from agent.workpiece.place_figure import draw_places  # noqa: PLC0415  matplotlib takes a second to import

    drawn = draw_places(places, placement, f"turned by {degrees(placement.turned_rad):g}°")
    write_all_atomically(file.parent, {file.name: drawn.in_format_of(file)})


def _show(found: PredictedFeatures, console: Console) -> None:
    x, y, z = found.placement.origin_mm
    console.print(
        f"Origin of the workpiece at X {x:.1f}, Y {y:.1f}, Z {z:.1f} mm, turned by "
        f"{degrees(found.placement.turned_rad):g}°; "
        + (f"table {found.table}" if found.table is not None else "no table"),
        markup=False,
    )
    states = ("without table", "with table") if found.table is not None else ("without table",)
    headings = ["feature", "kind", "tolerance / µm"]
    for state in states:
        headings += [f"{state} / µm", UNCERTAINTY_HEADING, "conformity"]
    numbers = [name for name in headings if "/ µm" in name or name == UNCERTAINTY_HEADING]
    shown = columns_table(headings, whole=("feature",), numbers=numbers)
    for one in found.predictions:
        limits = one.feature.tolerance
        cells: list[str | Text] = [one.feature.name, one.feature.kind.value, _limits_text(limits)]
        for error in (one.without_table, one.with_table):
            if error is not None:
                conformity = error.conformity.value
                cells += [*error_cells(one.feature, error), Text(conformity, _COLOURS[conformity])]
        shown.add_row(*cells)
    console.print(shown)
    console.print(f"Decision rule: {RULE}. Only the geometry of the machine is predicted.", markup=False)


def _limits_text(limits: Tolerance | None) -> str:
    if limits is None:
        return ""
    if limits.lower_mm is None or limits.upper_mm is None:
        sign, value_mm = ("≤", limits.upper_mm) if limits.lower_mm is None else ("≥", limits.lower_mm)
        return f"{sign} {UM_PER_MM * (value_mm or 0.0):g}"
    return f"{UM_PER_MM * limits.lower_mm:g} to {UM_PER_MM * limits.upper_mm:g}"
