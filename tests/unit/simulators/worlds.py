"""Worlds for tests: the shipped case study, with and without its errors."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

from drivers.clock import VirtualClock
from simulators.backend import SimulatedMachineDevice
from simulators.scenario import Scenario, read_scenario
from simulators.world.world import World

SHIPPED = Path(__file__).parents[3] / "config" / "simulators" / "case-study.toml"
REACH = 15.5
"""Sum of ball radius and tip radius, in mm."""
TOOL = np.array([0.0, 250.0, 0.0])


@cache
def case_study() -> Scenario:
    return read_scenario(SHIPPED)


def ideal_world(station: int = 2) -> World:
    """Return a world without errors; bar at `station`, level along X; machine in its corner."""
    world = World(case_study().without_errors())
    world.place_artefact(station)
    return world


def ball_axis_position(world: World, ball: int) -> np.ndarray:
    """Return the axis positions at which the tip of a perfect machine would be at the true ball centre."""
    return np.array(world.workpiece.snapshot(world.now).balls[ball]) - TOOL


def run(world: World) -> None:
    """Advance to the end of the current motion."""
    ends = world.controller.motion_ends_s
    world.advance_to(world.now if ends is None else ends)


def moved(world: World, target: np.ndarray) -> None:
    world.controller.begin_move(target, None, guarded=False)
    run(world)


def before_ball(world: World, ball: int, distance: float = 20.0) -> np.ndarray:
    """Move the tip in front of a ball, approaching along +Y; return the axis position of the ball."""
    centre = ball_axis_position(world, ball)
    moved(world, np.array([centre[0], 0.0, centre[2]]))
    moved(world, centre - [0.0, distance, 0.0])
    return centre


def device(world: World) -> tuple[SimulatedMachineDevice, VirtualClock]:
    clock = VirtualClock()
    played = SimulatedMachineDevice(world, clock)
    played.open()
    return played, clock
