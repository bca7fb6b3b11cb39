"""Simulated ball centres of an artificial machine, for tests of the identification."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.family import AMPLITUDES, RANGES, TOOL
from twin.artefact.artefact import Artefact, ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import is_reachable, mount_pose, parse_position_set, station_locations
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import Family, family_from_amplitudes

Deviation = Callable[[np.ndarray, np.ndarray], np.ndarray]


def case_study(order: int, cross_effect: tuple[str, ...] = ("b1", "b2", "c1")) -> tuple[ErrorModel, Family]:
    model = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, order, cross_effect)
    return model, family_from_amplitudes(model, AMPLITUDES)


def bar(
    balls: int = 11, tilt_deg: float = 15.0, sigma_mm: float = 0.0, cte_standard_uncertainty_per_k: float = 0.0
) -> Artefact:
    return ball_bar(
        "bar",
        balls=balls,
        length_mm=1500.0,
        tilt_rad=np.radians(tilt_deg),
        holder_length_mm=60.0,
        ball_diameter_mm=25.0,
        standard_uncertainty_mm=sigma_mm,
        cte_standard_uncertainty_per_k=cte_standard_uncertainty_per_k,
    )


def truth_of(model: ErrorModel, parameters: np.ndarray) -> Deviation:
    """Return the deviation in mm of a machine with exactly these parameters."""
    return lambda at, tool: exact_deviation(model, at, tool, parameters)


def measured(
    expression: str,
    stations: int,
    artefact: Artefact,
    deviation: Deviation,
    rng: np.random.Generator,
    *,
    sigma_mm: float = 1e-3,
    tools: tuple[np.ndarray, ...] = (TOOL,),
    temperature_c: float = 20.0,
) -> Observations:
    """Measure every reachable ball of the set once with every tool; `deviation(axis positions, tool)` is the truth in
    mm."""
    places = station_locations(stations, RANGES[0], 560.0, 900.0, 750.0)
    lower, upper = np.array(RANGES).T
    rows, found = [], []
    for number, position in enumerate(parse_position_set(expression, stations)):
        azimuth, elevation = np.radians(position.azimuth_deg), np.radians(position.elevation_deg)
        pose = mount_pose(places[position.station - 1], MountGeometry(), azimuth, elevation)
        points = pose.apply(artefact.at(temperature_c, elevation))
        for number_of_tool, tool in enumerate(tools):
            inside = is_reachable(points - tool, lower, upper, np.full(3, 10.0))
            nominal = points[inside] - tool
            at = nominal.copy()
            for _ in range(4):
                at = nominal - deviation(at, tool)
            found.append(at + rng.normal(0.0, sigma_mm, at.shape))
            rows += [(number, int(ball), number_of_tool, elevation) for ball in np.flatnonzero(inside)]
    numbers, balls, tool_numbers, elevations = zip(*rows, strict=True)
    return Observations(
        position=np.array(numbers),
        ball=np.array(balls),
        tool=np.array(tool_numbers),
        axis_positions=np.concatenate(found),
        covariance=np.tile(np.eye(3) * max(sigma_mm, 1e-5) ** 2, (len(rows), 1, 1)),
        temperature_c=np.full(len(rows), temperature_c),
        elevation_rad=np.array(elevations),
        tool_offsets=np.array(tools),
    )
