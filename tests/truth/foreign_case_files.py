"""Machine file, artefact file and ball file of a foreign machine, as `volcal identify` reads them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from campaigns.foreign.artefact import STATIONS_MM, measure, tilted_bar
from campaigns.foreign.files import artefact_text, ball_text, machine_text, rows_of
from campaigns.foreign.machine import TOOL, ForeignMachine, aligned_rms_um, foreign_machine, grid


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
    rows = rows_of(found.seen, 0, per_station=len(orientations), stated_noise=stated_noise)
    (folder / "machine.toml").write_text(machine_text(order=5))
    (folder / "artefact.toml").write_text(artefact_text(bar))
    (folder / "balls.csv").write_text(ball_text(rows))
    return Case(machine, folder)
