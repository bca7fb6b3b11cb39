"""Ball file, artefact file and settings of a foreign measurement, as a user of `volcal identify` writes them."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path

import numpy as np

from campaigns.foreign.artefact import CERTIFICATE_MM, CTE_PER_K, CTE_UNCERTAINTY_PER_K, NOISE_MM, ForeignBar
from twin.artefact.observations import Observations

CONFIG = Path(__file__).resolve().parents[2] / "config"
MACHINE_FILE = CONFIG / "machines" / "case-study.toml"
HEADER = [
    "position",
    "station",
    "azimuth_deg",
    "elevation_deg",
    "tool",
    "ball",
    "x_mm",
    "y_mm",
    "z_mm",
    "sigma_um",
    "temperature_c",
]


def ball_text(seen: Observations, per_station: int, *, with_temperature: bool = True) -> str:
    """Return the text of a ball file. `per_station` is the number of positions at each station."""
    assert seen.azimuth_rad is not None
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEADER)
    for row in range(seen.size):
        number = int(seen.position[row])
        azimuth, elevation = (f"{np.degrees(angle[row]):.9f}" for angle in (seen.azimuth_rad, seen.elevation_rad))
        placement = (number, number // per_station + 1, azimuth, elevation, "probe", int(seen.ball[row]))
        centre = (f"{value:.7f}" for value in seen.axis_positions[row])
        temperature = f"{seen.temperature_c[row]:.6f}" if with_temperature else ""
        writer.writerow([*placement, *centre, 1e3 * NOISE_MM, temperature])
    return out.getvalue()


def artefact_text(bar: ForeignBar) -> str:
    rows = ",\n".join(str([round(value, 7) for value in ball]) for ball in bar.certified.tolist())
    return (
        'name = "foreign"\ncertificate = "drawn"\nball_diameter_mm = 25.0\nholder_length_mm = 60.0\n'
        f"cte_per_k = {CTE_PER_K}\ncte_standard_uncertainty_per_k = {CTE_UNCERTAINTY_PER_K}\n"
        f"standard_uncertainty_um = {1e3 * CERTIFICATE_MM}\nballs = [\n{rows}\n]\n"
    )


def settings_text(uncertainty_k: float | None) -> str:
    """Return the settings of the case study with this uncertainty of the thermometer, or without any."""
    text = (CONFIG / "case-study.toml").read_text(encoding="utf-8")
    stated = "" if uncertainty_k is None else f"[temperature]\nstandard_uncertainty_k = {uncertainty_k}\n"
    changed, count = re.subn(r"\[temperature\]\nstandard_uncertainty_k[^\n]*\n", stated, text)
    assert count == 1
    return changed
