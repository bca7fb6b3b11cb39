"""Import of results of a finite element program: the files of the program become a deflection grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from agent.files import read_text, translated
from agent.finite_elements.mesh_results import NearestNode, ProbeOptions, probe_mesh
from drivers.errors import InputError
from twin.arrays import Array
from twin.finite_elements.axis_frame import AxisFrame
from twin.finite_elements.listing import is_listing, parse_listing
from twin.finite_elements.nodal_result import Components, StepResults
from twin.finite_elements.result_tables import (
    ListedPosition,
    has_positions,
    parse_positions_of_results,
    parse_results_at_positions,
    parse_results_by_step,
)
from twin.finite_elements.tool_displacements import (
    AssembledGrid,
    LengthUnit,
    assemble_grid,
    check_size,
    tool_displacements,
)

TEXT_SUFFIXES = frozenset([".csv", ".lis", ".txt", ".out", ".prn", ".list"])
"""Files of these names are listings or tables; all others are meshes."""


@dataclass(frozen=True)
class ImportOptions:
    """Statements of the user about the results. `node` and `probe` hold for positions whose table states none."""

    unit: LengthUnit
    frame: AxisFrame
    offset_mm: Array
    node: int | None = None
    probe: Components | None = None
    mesh: ProbeOptions = field(default_factory=ProbeOptions)
    fill: bool = False
    any_size: bool = False


@dataclass(frozen=True)
class ImportedGrid:
    """Deflection grid of imported results, before anything is subtracted. `unused` names results that no position
    uses; `largest_um` is the largest displacement in µm relative to the mean one; `furthest` is the node of a mesh that
    is furthest from its point, if nodes of meshes were read."""

    assembled: AssembledGrid
    unused: tuple[str, ...]
    largest_um: float
    furthest: NearestNode | None


@dataclass(frozen=True)
class _Found:
    """Result at one axis position, with the place from which it comes."""

    axes_mm: Components
    displacement: Components
    rotation: Components | None
    label: str
    nearest: NearestNode | None = None


def import_results(files: Sequence[Path], positions: Path | None, options: ImportOptions) -> ImportedGrid:
    """Return the deflection grid of result files. `positions` is the table of axis positions; None if a single CSV file
    contains them.

    Raises InputError, which names file, row and column where there are any, if something is missing, is given twice, or
    contradicts the statements of the user.
    """
    _check_options(files, positions, options)
    found, lost, unused = _read_all(files, positions, options)
    turned = [one.rotation for one in found if one.rotation is not None]
    if turned and len(turned) != len(found):
        bare = next(one.label for one in found if one.rotation is None)
        raise InputError(f"some results have rotations and others none, such as {bare}", hint="export all alike")
    read = [one.nearest for one in found if one.nearest is not None]
    furthest = max(read, key=lambda node: node.distance, default=None)
    with translated(InputError):
        moved = tool_displacements(
            np.array([one.axes_mm for one in found]),
            np.array([one.displacement for one in found]),
            np.array(turned) if turned else None,
            tuple(one.label for one in found),
            options.unit,
            options.frame,
            options.offset_mm,
        )
        if not options.any_size:
            check_size(moved, options.unit)
        return ImportedGrid(
            assemble_grid(moved, options.fill, np.array(lost).reshape(-1, 3)), unused, moved.largest_um, furthest
        )


def _check_options(files: Sequence[Path], positions: Path | None, options: ImportOptions) -> None:
    """Raise InputError if an option is stated that none of the files has a use for."""
    if options.mesh.interpolate and options.mesh.within is not None:
        hint = "--within is for the nearest node"
        raise InputError("--interpolate and --within exclude each other", hint=hint, option="--within")
    texts = [file for file in files if file.suffix.lower() in TEXT_SUFFIXES]
    mesh = {
        "--probe": options.probe is not None,
        "--within": options.mesh.within is not None,
        "--interpolate": options.mesh.interpolate,
        "--displacement": options.mesh.displacement is not None,
        "--rotation": options.mesh.rotation is not None,
    }
    if len(texts) == len(files) and any(mesh.values()):
        name = next(name for name, stated in mesh.items() if stated)
        raise InputError(f"{name} is for meshes, but there is none", hint=f"leave out {name}", option=name)
    if options.node is not None and positions is not None and not texts:
        message = "--node is for listings and tables of load steps, but there is none"
        raise InputError(message, hint="leave out --node; a mesh is read at --probe", option="--node")


def _read_all(
    files: Sequence[Path], table: Path | None, options: ImportOptions
) -> tuple[list[_Found], list[Components], tuple[str, ...]]:
    """Return the results, the axis positions in mm whose results are missing, and the names of unused results."""
    for number, file in enumerate(files):
        if file.name in (other.name for other in files[:number]):
            hint = "the table of positions names files without their folder: rename one of the two"
            raise InputError("a second file has the same name", hint=hint, file=str(file))
    if table is None:
        return _of_one_table(files, options), [], ()
    with translated(InputError, file=str(table)):
        positions = parse_positions_of_results(read_text(table), str(table))
    texts = {file.name: _steps(file) for file in files if file.suffix.lower() in TEXT_SUFFIXES}
    meshes = {file.name: file for file in files if file.name not in texts}
    used: set[tuple[str, int | None]] = set()
    found, lost, axes_lost = [], [], []
    for position in positions:
        name = _file_of(position, files, table)
        label = f"row {position.row} of {table.name}"
        if name in meshes:
            used.add((name, None))
            found.append(_of_mesh(position, meshes[name], options, label))
        elif position.load_step is not None and position.load_step not in texts[name].by_step:
            lost.append(f"load step {position.load_step} ({_spelled(position.axes_mm)})")
            axes_lost.append(position.axes_mm)
        else:
            step = _step_of(position, texts[name])
            used.add((name, step))
            with translated(InputError, position=label):
                result = texts[name].at(step, position.node if position.node is not None else options.node)
            found.append(_Found(position.axes_mm, result.displacement, result.rotation, label))
    if lost and not options.fill:
        more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
        hint = "compute these positions, or interpolate between others with --fill-missing"
        message = f"{len(lost)} results of the table are missing: {'; '.join(lost[:5])}{more}"
        raise InputError(message, hint=hint, file=str(table))
    if not found:
        raise InputError("no position of the table has a result", file=str(table))
    every: list[tuple[str, int | None]] = [(name, step) for name, steps in texts.items() for step in steps.by_step]
    every += [(name, None) for name in meshes]
    return (
        found,
        axes_lost,
        tuple(
            name if step is None else f"load step {step} of {name}" for name, step in every if (name, step) not in used
        ),
    )


def _of_one_table(files: Sequence[Path], options: ImportOptions) -> list[_Found]:
    text = read_text(files[0]) if len(files) == 1 and files[0].suffix.lower() in TEXT_SUFFIXES else ""
    with translated(InputError, file=str(files[0])):
        contained = has_positions(text, str(files[0]))
    if not contained:
        raise InputError(
            "the results do not contain the axis positions to which they belong",
            hint="state them in a table: --positions TABLE.csv with x_mm,y_mm,z_mm and load_step or file",
            file=str(files[0]),
        )
    if options.node is not None:
        message = "--node is for listings and tables of load steps, but the rows of this file are positions"
        raise InputError(message, hint="leave out --node", option="--node", file=str(files[0]))
    with translated(InputError, file=str(files[0])):
        positions, results = parse_results_at_positions(text, str(files[0]))
    found = []
    for position in positions:
        result = results.at(_step_of(position, results), None)
        label = f"row {position.row} of {files[0].name}"
        found.append(_Found(position.axes_mm, result.displacement, result.rotation, label))
    return found


def _steps(file: Path) -> StepResults:
    text = read_text(file)
    with translated(InputError, file=str(file)):
        return parse_listing(text, str(file)) if is_listing(text) else parse_results_by_step(text, str(file))


def _file_of(position: ListedPosition, files: Sequence[Path], table: Path) -> str:
    """Return the name of the file with the result of a position."""
    if position.file is None:
        if len(files) == 1:
            return files[0].name
        hint = "add a column 'file' to the table of positions"
        raise InputError("the row does not say which file it means", hint=hint, file=str(table), row=position.row)
    if position.file not in (file.name for file in files):
        hint = "name it on the command line, after `volcal fe import`"
        message = f"the file '{position.file}' is not among the results"
        raise InputError(message, hint=hint, file=str(table), row=position.row)
    return position.file


def _step_of(position: ListedPosition, results: StepResults) -> int:
    """Return the load step of a position; a file with one load step needs no statement."""
    if position.load_step is not None:
        return position.load_step
    if len(results.by_step) > 1:
        message = f"the row does not say which of the {len(results.by_step)} load steps of {results.source} it means"
        raise InputError(message, hint="add a column 'load_step'", row=position.row)
    return next(iter(results.by_step))


def _of_mesh(position: ListedPosition, file: Path, options: ImportOptions, label: str) -> _Found:
    probe = position.probe or options.probe
    if probe is None:
        hint = "state it with --probe x,y,z, or in columns probe_x, probe_y, probe_z of the table"
        raise InputError("the place at which the mesh is read is not stated", hint=hint, row=position.row)
    probed = probe_mesh(file, np.array(probe), options.mesh)
    turned = None if probed.rotation is None else _components(probed.rotation)
    return _Found(position.axes_mm, _components(probed.displacement), turned, label, probed.nearest)


def _components(vector: Array) -> Components:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def _spelled(axes_mm: Components) -> str:
    return ", ".join(f"{axis} {value:g}" for axis, value in zip("XYZ", axes_mm, strict=True))
