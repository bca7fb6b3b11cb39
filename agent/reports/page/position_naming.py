"""Naming of a list of positions by the standard position sets that it consists of."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product

from twin.artefact.position_set import POSITION_SETS, Position, set_orientations

SAME_ANGLE_DEG = 0.01
SIDES_DEG = (0.0, 90.0, 180.0, -90.0)


def name_of_positions(positions: Sequence[Position]) -> str:
    """Return a name for a list of positions.

    The name is, for example, `S3, 4 stations` if every station has the orientations of the standard set S3, with the
    holders of the bar towards any of the four sides. The name may combine several sets. If no combination fits, the
    name states the number of positions.
    """
    stations: dict[int, set[tuple[float, float]]] = {}
    for position in positions:
        stations.setdefault(position.station, set()).add((position.azimuth_deg, position.elevation_deg))
    known = [names for count in range(1, len(POSITION_SETS) + 1) for names in combinations(POSITION_SETS, count)]
    for names, facing_deg in product(known, SIDES_DEG):
        wanted = {pair for name in names for pair in set_orientations(name, facing_deg)}
        if all(_same(found, wanted) for found in stations.values()):
            return f"{'+'.join(names)}, {len(stations)} station{'s' if len(stations) != 1 else ''}"
    return f"{len(positions)} user-defined positions"


def _same(found: set[tuple[float, float]], wanted: set[tuple[float, float]]) -> bool:
    return len(found) == len(wanted) and all(
        any(abs(a - c) < SAME_ANGLE_DEG and abs(b - d) < SAME_ANGLE_DEG for c, d in wanted) for a, b in found
    )
