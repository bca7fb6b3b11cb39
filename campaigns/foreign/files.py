"""Texts of the files of a foreign machine: machine file, artefact file and ball file."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from benchmarks.family import AMPLITUDES
from campaigns.foreign.artefact import CERTIFICATE_MM, CTE_PER_K, CTE_UNCERTAINTY_PER_K, ForeignBar
from campaigns.foreign.machine import CHAIN, RANGES, TOOL
from twin.artefact.observations import Observations

COLUMNS = (
    *("position", "station", "azimuth_deg", "elevation_deg", "tool", "ball"),
    *("x_mm", "y_mm", "z_mm", "sigma_um", "temperature_c"),
)
Row = dict[str, str]


def rows_of(
    seen: Observations,
    first_position: int = 1,
    *,
    per_station: int | None = None,
    stated_noise: float = 1.0,
    with_temperature: bool = True,
) -> list[Row]:
    """Return the rows of a ball file, whose positions are numbered from `first_position`.

    `per_station` is the number of positions at each station; all are at the first one if it is None. `stated_noise` is
    the ratio of the stated uncertainty to that of `seen`.
    """
    assert seen.azimuth_rad is not None
    angles = np.degrees(np.stack((seen.azimuth_rad, seen.elevation_rad), axis=1))
    rows = []
    for k in range(seen.size):
        position = int(seen.position[k])
        station = 1 if per_station is None else 1 + position // per_station
        place = [position + first_position, station, *(f"{angle:.9f}" for angle in angles[k])]
        centre = (f"{value:.7f}" for value in seen.axis_positions[k])
        sigma_um = 1e3 * stated_noise * float(np.sqrt(seen.covariance[k, 0, 0]))
        temperature = f"{seen.temperature_c[k]:.6f}" if with_temperature else ""
        cells = (*place, "probe", int(seen.ball[k]), *centre, f"{sigma_um:g}", temperature)
        rows.append(dict(zip(COLUMNS, map(str, cells), strict=True)))
    return rows


def ball_text(rows: Iterable[Row]) -> str:
    return "\n".join([",".join(COLUMNS), *(",".join(row[name] for name in COLUMNS) for row in rows)]) + "\n"


def machine_text(low_mm: tuple[float, float, float] = (0.0, 0.0, 0.0), order: int | None = None) -> str:
    """Return a machine file whose axes begin at `low_mm`, with this Legendre order or the one that volcal assumes."""
    lines = ['name = "foreign"', f'chain = "{CHAIN}"']
    for axis, (low, high), moved in zip("XYZ", RANGES, low_mm, strict=True):
        lines += [f"[axes.{axis}]", f"range_mm = [{low + moved}, {high + moved}]"]
        lines += ["rapid_mm_per_min = 20000.0", "acceleration_mm_per_s2 = 500.0"]
    lines += ["[tools.probe]", f"offset_mm = {TOOL.tolist()}"]
    if order is not None:
        lines += ["[model]", f"order = {order}", "cross_effect = true"]
    lines += ["[model.family]"]
    return "\n".join(lines + [f"{name} = {value}" for name, value in AMPLITUDES.items()]) + "\n"


def artefact_text(bar: ForeignBar) -> str:
    values = {
        "name": '"foreign"',
        "certificate": '"drawn"',
        "reference_temperature_c": 20.0,
        "cte_per_k": CTE_PER_K,
        "cte_standard_uncertainty_per_k": CTE_UNCERTAINTY_PER_K,
        "ball_diameter_mm": 25.0,
        "holder_length_mm": 60.0,
        "standard_uncertainty_um": 1e3 * CERTIFICATE_MM,
        "balls": bar.certified.round(7).tolist(),
    }
    return "".join(f"{name} = {value}\n" for name, value in values.items())
