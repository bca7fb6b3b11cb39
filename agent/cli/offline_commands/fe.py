"""Commands `volcal fe import`, `volcal fe model` and `volcal fe compare`: deflection grids from finite elements.

The commands contact no device.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.options import FIGURE, PATH
from agent.cli.triples import parse_triple, point_in_mm

if will_run():
    import numpy as np

    from agent.cli.printing import columns_table, results_console
    from agent.files import check_folder, read_text, translated, write_all_atomically, write_atomically
    from agent.finite_elements.grid_figure import draw_grids
    from agent.finite_elements.import_results import ImportOptions, import_results
    from agent.finite_elements.mesh_results import EXTRA_HINT, ProbeOptions
    from agent.model_files import load_machine
    from drivers.errors import ConfigurationError, InputError
    from twin.finite_elements.axis_frame import parse_frame
    from twin.finite_elements.cross_effect_share import cross_effect_share
    from twin.finite_elements.structure_file import check_elements, parse_structure
    from twin.finite_elements.tool_displacements import (
        check_covers,
        middle_of,
        relative_to,
        resampled,
        without_rigid_motion,
    )
    from twin.formats.deflection_file import format_deflection, parse_deflection
    from twin.units import UM_PER_MM

if TYPE_CHECKING:
    from twin.arrays import Array
    from twin.machine.deflection import DeflectionGrid

_SHAPE = re.compile(r"([0-9]{1,3})x([0-9]{1,3})x([0-9]{1,3})")
_MOST_NODES = 200
_MOST_IN_ALL = 500_000
Reference = tuple[float, float, float] | Literal["middle", "none"]


def _reference(_: click.Context, __: click.Parameter, text: str) -> Reference:
    if text == "middle":
        return "middle"
    return "none" if text == "none" else parse_triple(text, ", and neither middle nor none")


_REFERENCE = click.option(
    "--reference",
    callback=_reference,
    default="middle",
    show_default=True,
    metavar="X,Y,Z|middle|none",
    help="Axis position in mm whose displacement is subtracted everywhere.",
)
_RIGID = click.option(
    "--remove-rigid", is_flag=True, help="Also subtract the small rigid motion that fits all nodes best."
)
_OUT = click.option("--out", "-o", type=PATH, default=Path("deflection.csv"), show_default=True, help="Grid file.")


_FIGURE = click.option("--figure", type=FIGURE, help="Figure of the grid: .png, .svg, .pdf.")


def _shape(_: click.Context, __: click.Parameter, text: str | None) -> tuple[int, int, int] | None:
    if text is None:
        return None
    found = _SHAPE.fullmatch(text)
    if found is None or not all(2 <= int(count) <= _MOST_NODES for count in found.groups()):
        raise click.BadParameter(f"'{text}' is not three numbers of nodes from 2 to {_MOST_NODES}, such as 9x15x13")
    x, y, z = map(int, found.groups())
    if x * y * z > _MOST_IN_ALL:
        raise click.BadParameter(f"{x * y * z} nodes are too many: at most {_MOST_IN_ALL} in all")
    return x, y, z


def _finite(_: click.Context, __: click.Parameter, number: float | None) -> float | None:
    if number is not None and not math.isfinite(number):
        raise click.BadParameter("the distance must be a finite number")
    return number


@click.group("fe", cls=VolcalGroup)
def fe_group() -> None:
    """Make deflection grids from finite elements: import results, solve a small solid model, compare."""


@fe_group.command("import")
@click.argument("files", type=PATH, nargs=-1, required=True)
@click.option("--positions", type=PATH, help="Table (CSV) with the axis positions of files, load steps and nodes.")
@click.option("--unit", type=click.Choice(("um", "mm", "m")), required=True, help="Unit of the displacements.")
@click.option(
    "--frame", default="X=+x,Y=+y,Z=+z", show_default=True, help="Directions of the machine axes in the model."
)
@click.option("--mirrored", is_flag=True, help="The model is a mirror image of the machine.")
@click.option("--node", type=click.IntRange(min=1), help="Node of the tool point, if several are listed.")
@click.option("--probe", metavar="x,y,z", help="Point at which meshes are read, in their frame and unit.")
@click.option(
    "--within",
    type=click.FloatRange(min=0.0),
    callback=_finite,
    help="Largest distance of its node, in the unit of the mesh [default: 1/1000 of the diagonal of the mesh].",
)
@click.option("--interpolate", is_flag=True, help="Interpolate between the nodes around the point instead.")
@click.option("--displacement", help="Point data of meshes with the displacements [default: the usual names].")
@click.option("--rotation", help="Point data of meshes with the rotations in rad [default: the usual names].")
@click.option(
    "--offset", callback=point_in_mm, metavar="X,Y,Z", help="Tool point from the node, in mm and machine axes."
)
@click.option("--fill-missing", is_flag=True, help="Interpolate missing nodes that lie between others.")
@click.option("--any-size", is_flag=True, help="Accept displacements of implausible size.")
@click.option("--resample", callback=_shape, metavar="9x15x13", help="Interpolate on this many evenly spaced nodes.")
@click.option("--machine", type=PATH, help="Machine file (TOML) whose axis ranges the grid must cover.")
@_REFERENCE
@_RIGID
@_OUT
@_FIGURE
@reported
def import_command(
    files: tuple[Path, ...],
    positions: Path | None,
    unit: Literal["um", "mm", "m"],
    frame: str,
    mirrored: bool,
    node: int | None,
    probe: str | None,
    within: float | None,
    interpolate: bool,
    displacement: str | None,
    rotation: str | None,
    offset: tuple[float, float, float] | None,
    fill_missing: bool,
    any_size: bool,
    resample: tuple[int, int, int] | None,
    machine: Path | None,
    reference: Reference,
    remove_rigid: bool,
    out: Path,
    figure: Path | None,
) -> None:
    """Make the grid file of a machine from the results of a finite element program.

    FILES are ANSYS listings (PRNSOL), CSV files, or meshes that meshio reads (VTU, VTK ...).
    """
    _check_outputs((out, figure), (*files, positions, machine))
    with translated(InputError, option="--frame"):
        axes = parse_frame(frame, mirrored)
    options = ImportOptions(
        unit=unit,
        frame=axes,
        offset_mm=np.array(offset or (0.0, 0.0, 0.0)),
        node=node,
        probe=None if probe is None else parse_triple(probe),
        mesh=ProbeOptions(within, interpolate, displacement, rotation),
        fill=fill_missing,
        any_size=any_size,
    )
    found = import_results(files, positions, options)
    grid, filled = found.assembled.grid, found.assembled.filled_mm
    if found.unused:
        more = f" and {len(found.unused) - 5} more" if len(found.unused) > 5 else ""
        click.echo(f"warning: no position uses {', '.join(found.unused[:5])}{more}", err=True)
    if found.furthest is not None:
        click.echo(f"nearest nodes were read, the furthest one: {found.furthest}", err=True)
    for place in filled.tolist():
        click.echo(f"warning: interpolated X {place[0]:g}, Y {place[1]:g}, Z {place[2]:g} mm", err=True)
    if machine is not None:
        described = load_machine(machine)
        with translated(InputError):
            check_covers(grid, described.model.ranges_mm, described.name)
    if resample is not None:
        grid = resampled(grid, resample)
    grid = _referenced(grid, reference, remove_rigid)
    _write(grid, out, figure, f"results of {len(files)} file{'s' if len(files) > 1 else ''}", filled)


@fe_group.command("model")
@click.argument("structure", type=PATH)
@click.option(
    "--cells",
    type=click.IntRange(1, 4),
    help="Elements between two ribs [default: that of the file]; a part with too many is refused.",
)
@_REFERENCE
@_RIGID
@_OUT
@_FIGURE
@reported
def model_command(
    structure: Path, cells: int | None, reference: Reference, remove_rigid: bool, out: Path, figure: Path | None
) -> None:
    """Solve a solid model of bed, column and ram under gravity and write its deflection grid.

    STRUCTURE is a structure file (TOML), such as config/structures/case-study.toml.
    """
    _check_outputs((out, figure), (structure,))
    text = read_text(structure, error=ConfigurationError)
    with translated(ConfigurationError, file=str(structure)):
        section = parse_structure(text, str(structure))
    if cells is not None:
        section = section.model_copy(update={"cells": cells})
    with translated(ConfigurationError, file=str(structure)):
        check_elements(section)
    try:
        from agent.finite_elements.machine_structure import solid_deflection  # noqa: PLC0415  an optional library
    except ImportError:
        raise ConfigurationError("solid models need the package scikit-fem", hint=EXTRA_HINT) from None
    solved = solid_deflection(section, lambda part: click.echo(part, err=True))
    table = columns_table(("part", "unknowns", "ux / µm", "uy / µm", "uz / µm"), numbers=("unknowns",))
    for name, grid in (*solved.parts.items(), ("together", solved.grid)):
        largest = UM_PER_MM * np.abs(relative_to(grid, middle_of(grid)).values).max(axis=(0, 1, 2))
        count = solved.unknowns.get(name, sum(solved.unknowns.values()))
        table.add_row(name, str(count), *(f"{value:.2f}" for value in largest))
    console = results_console()
    console.print(f"{section.name}: largest displacement from the middle of the grid", markup=False)
    console.print(table)
    _write(_referenced(solved.grid, reference, remove_rigid), out, figure, section.name)


@fe_group.command("compare")
@click.argument("grids", type=PATH, nargs=-1, required=True)
@click.option("--machine", type=PATH, required=True, help="Machine file (TOML) with axis ranges and cross-effect.")
@click.option("--figure", type=FIGURE, help="Figure of all grids: .png, .svg, .pdf.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout instead of a table.")
@reported
def compare_command(grids: tuple[Path, ...], machine: Path, figure: Path | None, as_json: bool) -> None:
    """Show what the error motions of single axes explain of deflection grids, and what only the cross-effect does.

    GRIDS are grid files.
    """
    _check_outputs((figure,), (*grids, machine))
    described = load_machine(machine)
    read = {}
    for file in grids:
        with translated(InputError, file=str(file)):
            read[str(file)] = parse_deflection(read_text(file), str(file))
    shares = {}
    for name, grid in read.items():
        with translated(InputError, file=name):
            shares[name] = cross_effect_share(grid, described)
    if figure is not None:
        labels = _labels(read)
        _draw(figure, {labels[name]: relative_to(one, middle_of(one)) for name, one in read.items()}, described.name)
    if as_json:
        values = {name: share.as_json() for name, share in shares.items()}
        click.echo(json.dumps({"machine": described.name, "grids": values}, allow_nan=False))
        return
    table = columns_table(("µm", *shares), numbers=tuple(shares))
    rows = [
        (f"largest displacement along {axis}", [share.largest_um[k] for share in shares.values()])
        for k, axis in enumerate("XYZ")
    ]
    rows += [
        ("rms from the middle", [share.raw_um for share in shares.values()]),
        ("rms without the best rigid motion", [share.aligned_um for share in shares.values()]),
        ("rms that single axes do not explain", [share.without_series_um for share in shares.values()]),
        ("rms that the cross-effect does not explain either", [share.rest_um for share in shares.values()]),
    ]
    first = next(iter(shares.values()))
    rows += [(f"{name} / {first.units[name]}", [one.terms[name] for one in shares.values()]) for name in first.terms]
    for name, cells in rows:
        table.add_row(name, *(f"{value:.2f}" for value in cells))
    results_console().print(table)


def _check_outputs(outputs: tuple[Path | None, ...], inputs: tuple[Path | None, ...]) -> None:
    """Raise InputError if a file cannot be written, or would replace one that is read or the other output."""
    others = [file.resolve() for file in inputs if file is not None]
    for file in outputs:
        if file is not None:
            if file.resolve() in others:
                hint = "choose another name for the output"
                raise InputError(
                    "the output would replace a file that is read or written too", hint=hint, file=str(file)
                )
            others.append(file.resolve())
            check_folder(file.parent)


def _labels(names: Collection[str]) -> dict[str, str]:
    """Return the name of the row in the figure for each grid file: its stem, or its whole name if stems are equal."""
    stems = [Path(name).stem for name in names]
    return {name: Path(name).stem if stems.count(Path(name).stem) == 1 else name for name in names}


def _referenced(grid: DeflectionGrid, reference: Reference, remove_rigid: bool) -> DeflectionGrid:
    """Return the grid without what the options ask to subtract."""
    if remove_rigid:
        grid = without_rigid_motion(grid)
    if reference == "none":
        return grid
    place = middle_of(grid) if reference == "middle" else np.array(reference)
    with translated(InputError, option="--reference"):
        return relative_to(grid, place)


def _write(grid: DeflectionGrid, out: Path, figure: Path | None, heading: str, filled: Array | None = None) -> None:
    write_atomically(out, format_deflection(grid))
    if figure is not None:
        _draw(figure, {out.stem: grid}, heading, filled)
    sizes = " x ".join(str(nodes.size) for nodes in grid.nodes)
    largest = ", ".join(f"{value:.2f}" for value in UM_PER_MM * np.abs(grid.values).max(axis=(0, 1, 2)))
    click.echo(f"{out}: {sizes} nodes, largest displacements {largest} µm along X, Y, Z")


def _draw(file: Path, grids: dict[str, DeflectionGrid], heading: str, filled: Array | None = None) -> None:
    drawn = draw_grids(grids, heading, filled)
    write_all_atomically(file.parent, {file.name: drawn.in_format_of(file)})
