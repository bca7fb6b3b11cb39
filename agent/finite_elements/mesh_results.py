"""Displacements and rotations at one point of a mesh file, read with meshio (VTU, VTK, Gmsh and others).

meshio is an optional package: it is imported only if a mesh file is read.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import QhullError

from drivers.errors import ConfigurationError, InputError
from twin.arrays import Array
from twin.formats.compressed_text import MAX_TEXT_BYTES

EXTRA_HINT = "install the extra: pip install 'volcal[fe]'"
DISPLACEMENT_NAMES = ("displacement", "Displacement", "displacements", "U", "u", "DISP")
ROTATION_NAMES = ("rotation", "Rotation", "rotations", "UR", "ROT")
_NEIGHBOURS = 64
"""Nearest nodes between which a point is interpolated: the elements around it and their neighbours."""


@dataclass(frozen=True)
class ProbeOptions:
    """Place and names of the results in mesh files.

    `within` is the largest distance of the nearest node from the point, in the unit of the mesh; None to interpolate
    linearly between the nodes around the point instead. `displacement` and `rotation` are the names of the point data,
    None for the usual ones; without a usual one there are no rotations.
    """

    within: float | None
    displacement: str | None = None
    rotation: str | None = None


def probe_mesh(path: Path, point: Array, options: ProbeOptions) -> tuple[Array, Array | None]:
    """Return displacement (3,) and rotation (3,) of the results in a mesh file at `point` (3,), all in the unit and the
    frame of the file. Raises InputError if the file cannot be read or has no result at the point."""
    mesh = _read(path)
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points) or not np.isfinite(points).all():
        raise InputError("the mesh has no nodes in three dimensions", file=str(path))
    moved = _field(mesh, path, len(points), options.displacement, DISPLACEMENT_NAMES)
    if moved is None:
        known = ", ".join(map(str, mesh.point_data)) or "none"
        hint = f"name it with --displacement; point data of the file: {known}"
        raise InputError("the mesh has no displacements as point data", hint=hint, file=str(path))
    turned = _field(mesh, path, len(points), options.rotation, ROTATION_NAMES)
    found = [_at(points, values, point, options.within, path) for values in (moved, turned) if values is not None]
    return found[0], found[1] if len(found) > 1 else None


def _read(path: Path) -> Any:
    try:
        import meshio  # noqa: PLC0415  optional
    except ImportError:
        raise ConfigurationError("reading mesh files needs the package meshio", hint=EXTRA_HINT) from None
    if not path.is_file():
        raise InputError("there is no such file", hint="check the path", file=str(path))
    if path.stat().st_size > MAX_TEXT_BYTES:
        raise InputError(f"the file is larger than {MAX_TEXT_BYTES // 1_000_000} MB", file=str(path))
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            return meshio.read(path)
    except (Exception, SystemExit) as error:  # noqa: BLE001  a reader of foreign files raises anything, and may exit
        cause = str(error) if isinstance(error, meshio.ReadError) else type(error).__name__
        hint = "listings and tables need the ending .lis, .txt, .out, .prn, .list or .csv"
        raise InputError(f"meshio cannot read the mesh ({cause:.120})", hint=hint, file=str(path)) from None


def _field(mesh: Any, path: Path, count: int, name: str | None, usual: tuple[str, ...]) -> Array | None:
    """Return point data (n, 3), or None if no name is stated and none of the usual names is there."""
    chosen = name or next((other for other in usual if other in mesh.point_data), None)
    if chosen is None:
        return None
    if chosen not in mesh.point_data:
        known = ", ".join(map(str, mesh.point_data)) or "none"
        raise InputError(f"the mesh has no point data '{chosen}'", hint=f"it contains: {known}", file=str(path))
    try:
        values = np.asarray(mesh.point_data[chosen], dtype=np.float64)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (count, 3):
        raise InputError(f"the point data '{chosen}' are not three numbers for each node", file=str(path))
    return values


def _at(points: Array, values: Array, point: Array, within: float | None, path: Path) -> Array:
    distances = np.linalg.norm(points - point, axis=1)
    nearest = int(distances.argmin())
    where = ", ".join(f"{value:g}" for value in point)
    if within is not None:
        if distances[nearest] > within:
            message = f"the nearest node is {distances[nearest]:.4g} away from ({where}), more than {within:g}"
            hint = "check point, unit and frame, raise --within, or interpolate with --interpolate"
            raise InputError(message, hint=hint, file=str(path))
        found = values[nearest]
    else:
        around = np.argsort(distances)[:_NEIGHBOURS]
        try:
            found = LinearNDInterpolator(points[around], values[around])(point)[0]
        except (QhullError, ValueError):
            found = np.full(3, np.nan)
        if not np.isfinite(found).all() and distances[nearest] == 0.0:
            found = values[nearest]
        if not np.isfinite(found).all():
            message = f"the nodes around ({where}) do not enclose this point, or have no finite result"
            raise InputError(message, hint="check point, unit and frame, or read the nearest node", file=str(path))
    if not np.isfinite(found).all():
        raise InputError(f"the result at ({where}) is not finite", file=str(path))
    return np.asarray(found, dtype=np.float64)
