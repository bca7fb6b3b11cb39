"""Worlds to try things in: the shipped case study, with and without its errors."""

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
"""Radius of the ball and of the tip together."""
TOOL = np.array([0.0, 250.0, 0.0])


@cache
def case_study() -> Scenario:
    return read_scenario(SHIPPED)


def ideal_world(station: int = 2) -> World:
    """No error at all; the bar at `station`, level along X; the machine in its corner."""
    world = World(case_study().without_errors())
    world.place_artefact(station)
    return world


def ball_axis_position(world: World, ball: int) -> np.ndarray:
    """Axis positions at which the tip of a perfect machine would be in the middle of the true ball."""
    return np.array(world.workpiece.snapshot(world.now).balls[ball]) - TOOL


def run(world: World) -> None:
    """Let the current motion end."""
    ends = world.controller.motion_ends_s
    world.advance_to(world.now if ends is None else ends)


def moved(world: World, target: np.ndarray) -> None:
    world.controller.begin_move(target, None, guarded=False)
    run(world)


def before_ball(world: World, ball: int, distance: float = 20.0) -> np.ndarray:
    """Bring the tip in front of a ball, coming along +Y; returns the axis position of the ball."""
    centre = ball_axis_position(world, ball)
    moved(world, np.array([centre[0], 0.0, centre[2]]))
    moved(world, centre - [0.0, distance, 0.0])
    return centre


def device(world: World) -> tuple[SimulatedMachineDevice, VirtualClock]:
    clock = VirtualClock()
    played = SimulatedMachineDevice(world, clock)
    played.open()
    return played, clock
