"""Machine that the identification cannot represent, and the ball centres that it would measure.

It is richer than the identified model: Legendre orders up to 7, a gravity deflection field, an artefact that differs
from its certificate within the stated uncertainty, a temperature that drifts, touch noise.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from agent.model_files import load_artefact, load_machine
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, is_reachable, mount_pose, parse_position_set, station_locations
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.machine_description import MachineDescription
from twin.machine.machine_population import family_from_amplitudes

CONFIG = Path(__file__).parents[2] / "config"
MACHINE_FILE = CONFIG / "machines" / "case-study.toml"
ARTEFACT_FILE = CONFIG / "artefacts" / "ball-bar-1500.toml"
COLUMNS = [
    *("position", "station", "azimuth_deg", "elevation_deg", "tool", "ball"),
    *("x_mm", "y_mm", "z_mm", "sigma_um", "temperature_c"),
]
TOUCH_SIGMA_MM = 1e-3
MARGIN_MM = np.array([5.0, 40.0, 5.0])


@dataclass(frozen=True)
class HiddenMachine:
    """Hidden machine: `deviation(axis_positions)` is the truth in mm, `artefact` the true balls."""

    description: MachineDescription
    model: ErrorModel
    parameters: np.ndarray
    artefact: Artefact
    offset: np.ndarray

    def deviation(self, axis_positions: np.ndarray) -> np.ndarray:
        errors = exact_deviation(self.model, axis_positions, self.offset, self.parameters)
        assert self.description.deflection is not None
        return errors + self.description.deflection.at(axis_positions)

    def found_at(self, tool_points: np.ndarray) -> np.ndarray:
        """Return axis positions that bring the real tool point to `tool_points`: fixed point of p - t - d(X)."""
        axis_positions = tool_points - self.offset
        for _ in range(4):
            axis_positions = tool_points - self.offset - self.deviation(axis_positions)
        return axis_positions


def hidden_machine(rng: np.random.Generator) -> HiddenMachine:
    description = load_machine(MACHINE_FILE)
    model = ErrorModel.uniform(description.model.chain, description.model.ranges_mm, order=7)
    family = family_from_amplitudes(model, description.amplitudes)
    certified = load_artefact(ARTEFACT_FILE)
    slip = np.linalg.cholesky(certified.covariance) @ rng.standard_normal(certified.balls.size)
    real = replace(certified, balls=certified.balls + slip.reshape(-1, 3))
    return HiddenMachine(description, model, family.draw(rng, 1)[0], real, description.tool("probe"))


def measured_rows(machine: HiddenMachine, positions: tuple[Position, ...], rng: np.random.Generator) -> list[dict]:
    """Return the rows of a ball file as text; balls outside the axis travel are left out."""
    stations = max(position.station for position in positions)
    ranges = machine.description.model.ranges_mm
    y, z = 0.5 * sum(ranges[1]) + machine.offset[1], 0.5 * sum(ranges[2])
    places = station_locations(stations, ranges[0], 560.0, y, z)
    lower, upper = np.array(machine.description.limits).T
    rows = []
    for number, position in enumerate(positions):
        temperature = 20.0 + 0.8 * math.sin(0.2 * number)
        elevation = math.radians(position.elevation_deg)
        pose = mount_pose(places[position.station - 1], MountGeometry(), math.radians(position.azimuth_deg), elevation)
        points = pose.apply(machine.artefact.at(temperature, elevation))
        inside = is_reachable(points - machine.offset, lower, upper, MARGIN_MM)
        balls = np.flatnonzero(inside)
        found = machine.found_at(points[balls]) + rng.normal(0.0, TOUCH_SIGMA_MM, (len(balls), 3))
        for ball, place in zip(balls, found, strict=True):
            head = (number, position.station, position.azimuth_deg, position.elevation_deg, "probe", int(ball))
            values = (*head, *(f"{value:.6f}" for value in place), 1e3 * TOUCH_SIGMA_MM, f"{temperature:.2f}")
            rows.append(dict(zip(COLUMNS, map(str, values), strict=True)))
    return rows


def as_csv(rows: list[dict], columns: list[str] | None = None) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns or COLUMNS, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def ball_file(path: Path, seed: int = 7, expression: str = "S3", stations: int = 4) -> HiddenMachine:
    """Write a ball file and return the machine that it comes from."""
    rng = np.random.default_rng(seed)
    machine = hidden_machine(rng)
    path.write_text(as_csv(measured_rows(machine, parse_position_set(expression, stations), rng)))
    return machine
