"""Displacements and rotations at one point of a mesh file, read with meshio (VTU, VTK, Gmsh and others).

meshio is an optional package: it is imported only if a mesh file is read.
"""

from __future__ import annotations

import contextlib
import io
import resource
from collections.abc import Iterator
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


_NEAR = 1e-3
"""Largest distance of the nearest node, as a share of the diagonal of the mesh, unless another is stated."""
_MEMORY_BYTES = 1_000_000_000
"""Memory in which a mesh is read: a file of some kB may unpack to any size."""


@dataclass(frozen=True)
class ProbeOptions:
    """Place and names of the results in mesh files.

    `within` is the largest distance of the nearest node from the point, in the unit of the mesh; None for a thousandth
    of the diagonal of the mesh. `interpolate` linearly between the nodes around the point instead. `displacement` and
    `rotation` are the names of the point data, None for the usual ones; without a usual one there are no rotations.
    """

    within: float | None = None
    interpolate: bool = False
    displacement: str | None = None
    rotation: str | None = None


@dataclass(frozen=True)
class Probed:
    """Displacement (3,) and rotation (3,), if there is one, at a point of a mesh, in unit and frame of the file.
    `nearest` says which node was read, and how far from the point it is; None if the result is interpolated."""

    displacement: Array
    rotation: Array | None
    nearest: NearestNode | None


@dataclass(frozen=True)
class NearestNode:
    """Node of a file, numbered from 1, at `place` (3,) and at `distance` from the point that was asked for, both in the
    unit of the mesh."""

    file: str
    number: int
    place: Array
    distance: float

    def __str__(self) -> str:
        where = ", ".join(f"{value:g}" for value in self.place)
        return f"node {self.number} of {self.file} at ({where}), {self.distance:.3g} from the point"


def probe_mesh(path: Path, point: Array, options: ProbeOptions) -> Probed:
    """Return the results in a mesh file at `point` (3,), in the unit and the frame of the file. Raises InputError if
    the file cannot be read or has no result at the point."""
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
    distances = np.linalg.norm(points - point, axis=1)
    nearest = None
    if not options.interpolate:
        nearest = _nearest(points, distances, point, options.within, path)
    found = [
        _at(points, values, point, distances, nearest is None, path) for values in (moved, turned) if values is not None
    ]
    return Probed(found[0], found[1] if len(found) > 1 else None, nearest)


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
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), _bounded_memory(_MEMORY_BYTES):
            return meshio.read(path)
    except MemoryError:
        message = f"the mesh needs more than {_MEMORY_BYTES / 1e9:g} GB of memory"
        hint = "export only the nodes around the tool point, or a listing"
        raise InputError(message, hint=hint, file=str(path)) from None
    except (Exception, SystemExit) as error:  # noqa: BLE001  a reader of foreign files raises anything, and may exit
        cause = str(error) if isinstance(error, meshio.ReadError) else type(error).__name__
        hint = "listings and tables need the ending .lis, .txt, .out, .prn, .list or .csv"
        raise InputError(f"meshio cannot read the mesh ({cause:.120})", hint=hint, file=str(path)) from None


@contextlib.contextmanager
def _bounded_memory(further_bytes: int) -> Iterator[None]:
    """Let the process take `further_bytes` of memory at most while the `with` block runs; more is a MemoryError."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    bound = pages * resource.getpagesize() + further_bytes
    lower = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([bound, *lower]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


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


def _nearest(points: Array, distances: Array, point: Array, within: float | None, path: Path) -> NearestNode:
    """Return the nearest node. Raises InputError if it is further away than `within`."""
    index = int(distances.argmin())
    bound = _NEAR * float(np.linalg.norm(np.ptp(points, axis=0))) if within is None else within
    found = NearestNode(path.name, index + 1, points[index], float(distances[index]))
    if found.distance > bound:
        where = ", ".join(f"{value:g}" for value in point)
        message = f"the nearest node is {found.distance:.4g} away from ({where}), more than {bound:.4g}"
        hint = "check point, unit and frame, state --within, or interpolate with --interpolate"
        raise InputError(message, hint=hint, file=str(path))
    return found


def _at(points: Array, values: Array, point: Array, distances: Array, between: bool, path: Path) -> Array:
    """Return the values (n, 3) at the nearest node, or linearly `between` the nodes around the point."""
    nearest = int(distances.argmin())
    where = ", ".join(f"{value:g}" for value in point)
    found = values[nearest]
    if between:
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
