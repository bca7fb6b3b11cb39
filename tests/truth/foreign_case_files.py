"""Machine file, artefact file and ball file of a foreign machine, as `volcal identify` reads them."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from campaigns.foreign.artefact import STATIONS_MM, ForeignBar, Measured, measure, tilted_bar
from campaigns.foreign.machine import CHAIN, RANGES, TOOL, ForeignMachine, aligned_rms_um, foreign_machine, grid
from campaigns.foreign.score import AMPLITUDES

HEADS = "position,station,azimuth_deg,elevation_deg,tool,ball,x_mm,y_mm,z_mm,sigma_um,temperature_c"


@dataclass(frozen=True)
class Case:
    """Foreign machine and the folder with its files."""

    machine: ForeignMachine
    folder: Path

    @property
    def arguments(self) -> list[str]:
        """Arguments of `volcal identify`, the folder of the results excepted."""
        names = (self.folder / name for name in ("balls.csv", "machine.toml", "artefact.toml"))
        balls, machine, artefact = map(str, names)
        return [balls, "--machine", machine, "--artefact", artefact]

    @property
    def true_ve_um(self) -> float:
        points = grid()
        return aligned_rms_um(points + TOOL, self.machine.deviation(points))

    def true_vce_um(self, table: Path) -> float:
        """Return the true error in µm that remains with the corrections in the file `table`, read by an own reader."""
        rows = np.array([line.split(",") for line in table.read_text().splitlines()[1:]], dtype=float)
        nodes = [np.unique(rows[:, axis]) for axis in range(3)]
        values = 1e-3 * rows[:, 3:].reshape(*(len(one) for one in nodes), 3)
        points = grid()
        added = RegularGridInterpolator(nodes, values, bounds_error=False, fill_value=None)(points)
        return aligned_rms_um(points + TOOL, added + self.machine.deviation(points + added))


def written_case(
    folder: Path,
    seed: int,
    orientations: Sequence[tuple[float, float]],
    *,
    stations: Sequence[Sequence[float]] = STATIONS_MM,
    worse: float = 1.0,
    stated_noise: float = 1.0,
) -> Case:
    """Draw a machine and a bar, measure, and write the files into `folder`.

    `stated_noise` is the ratio of the uncertainty in the ball file to the one with which the balls were measured.
    """
    rng = np.random.default_rng(seed)
    machine, bar = foreign_machine(rng, worse), tilted_bar(rng)
    found = measure(machine, bar, orientations, np.random.default_rng(seed + 100), stations=stations)
    (folder / "machine.toml").write_text(machine_text())
    (folder / "artefact.toml").write_text(artefact_text(bar))
    (folder / "balls.csv").write_text(balls_text(found, len(orientations), stated_noise))
    return Case(machine, folder)


def machine_text() -> str:
    axes = "".join(
        f"[axes.{name}]\nrange_mm = [{low}, {high}]\nrapid_mm_per_min = 20000.0\nfeed_mm_per_min = 3000.0\n"
        "acceleration_mm_per_s2 = 500.0\n"
        for name, (low, high) in zip("XYZ", RANGES, strict=True)
    )
    family = "".join(f"{name} = {value}\n" for name, value in AMPLITUDES.items())
    text = (
        f'name = "foreign"\nchain = "{CHAIN}"\n{axes}[tools.probe]\noffset_mm = {TOOL.tolist()}\n'
        f"[model]\norder = 5\ncross_effect = true\n[model.family]\n{family}"
    )
    assert tomllib.loads(text)
    return text


def artefact_text(bar: ForeignBar) -> str:
    artefact = bar.artefact
    balls = "".join(f"  {row},\n" for row in artefact.balls.tolist())
    return (
        f'name = "foreign"\ncertificate = "drawn"\nreference_temperature_c = {artefact.reference_temperature_c}\n'
        f"cte_per_k = {artefact.cte_per_k}\n"
        f"cte_standard_uncertainty_per_k = {artefact.cte_standard_uncertainty_per_k}\n"
        f"ball_diameter_mm = {artefact.ball_diameter_mm}\nholder_length_mm = {artefact.holder_length_mm}\n"
        f"standard_uncertainty_um = {1e3 * float(np.sqrt(artefact.covariance[0, 0]))}\nsag_um = 0.0\n"
        f"balls = [\n{balls}]\n"
    )


def balls_text(found: Measured, orientations: int, stated_noise: float) -> str:
    seen = found.seen
    assert seen.azimuth_rad is not None
    angles = np.degrees(np.stack((seen.azimuth_rad, seen.elevation_rad), axis=1))
    sigma_um = 1e3 * stated_noise * np.sqrt(seen.covariance[:, 0, 0])
    lines = [HEADS]
    for row in range(seen.size):
        position = int(seen.position[row])
        azimuth, elevation = angles[row]
        point = ",".join(f"{value:.7f}" for value in seen.axis_positions[row])
        head = f"{position},{1 + position // orientations},{azimuth:.6f},{elevation:.6f},probe,{seen.ball[row]}"
        lines.append(f"{head},{point},{sigma_um[row]:g},{seen.temperature_c[row]:.6f}")
    return "\n".join(lines) + "\n"
