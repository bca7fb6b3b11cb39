"""World around LinuxCNC: the simulated true machine, artefact and mount.

The state of the world is published to the servo thread of LinuxCNC. The world's own simulated controller is not used:
LinuxCNC moves the axes, and a realtime component reports probe trips. Collisions are searched for along the path of the
tip.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from simulators.linuxcnc.memory import DeviationGrid, PlantMemory, ProbeBehaviour
from simulators.scenario import Scenario
from simulators.world.noise import generator
from simulators.world.thermal_effects import AMBIENT, ARTEFACT, MACHINE
from simulators.world.workpiece import WorkpieceSnapshot
from simulators.world.world import Collision, World
from twin.arrays import Array
from twin.collision.bodies import TIP
from twin.collision.geometry import Point, point
from twin.machine.true_machine import TrueMachine

GRID_STEP_MM = 25.0
STEM = "stem"
NEAR_MM = 2.0
"""Gap between tip and ball up to which the stem may touch that ball, because it deflects with the tip."""


class LinuxCncPlant:
    """Simulated plant (machine, balls and mount) around LinuxCNC; `on_advance` is called after each advance of the
    simulated time.
    """

    def __init__(self, scenario: Scenario, file: Path) -> None:
        self.world = World(scenario)
        settings = scenario.settings
        tool = point(scenario.machine.tool(settings.tool))
        self._reach_mm = self.world.table.ball_radius_mm + settings.probe.tip_radius_mm
        self._overtravel_mm = settings.trigger.overtravel_mm
        nature = ProbeBehaviour(
            seed=int(generator(settings.seed, "linuxcnc plant").integers(2**20)),
            reach_mm=self._reach_mm,
            overtravel_mm=self._overtravel_mm,
            pretravel_mm=1e-3 * settings.trigger.pretravel_um,
            lobing_mm=1e-3 * settings.trigger.lobing_um,
            touch_sigma_mm=1e-3 * settings.trigger.touch_sigma_um,
            repeatability_mm=1e-3 * settings.axes.repeatability_um,
            backlash_mm=_in_mm(settings.axes.backlash_of_axes_um),
            tool_mm=tool,
        )
        self.memory = PlantMemory(file, _sample_field(self.world.truth.machine, scenario), nature)
        self._shown: WorkpieceSnapshot | None = None
        self._tip: Point | None = None
        self._colliding: set[tuple[str, str]] = set()
        self.on_advance(0.0)

    def on_advance(self, now_s: float) -> None:
        """Publish the present state of the plant to LinuxCNC, and search for collisions on the path of the tip since
        the last call.
        """
        snapshot = self.world.table.snapshot(now_s)
        trace = self.memory.read_trace()
        if snapshot is not self._shown:
            self._show(snapshot)
            if self._tip is not None:
                self._look(snapshot, self._tip, self._tip)
        for start, end in zip(trace[:-1].tolist(), trace[1:].tolist(), strict=True):
            self._look(snapshot, point(start), point(end))
            self._tip = point(end)

    def _show(self, snapshot: WorkpieceSnapshot) -> None:
        temperatures = self.world.controller.temperatures()
        self.memory.show(
            np.array(snapshot.balls).reshape(-1, 3),
            drift_mm=(0.0, 0.0, 0.0),
            temperatures_c=[temperatures[ARTEFACT], temperatures[MACHINE], temperatures[AMBIENT]],
        )
        self._shown = snapshot

    def _look(self, snapshot: WorkpieceSnapshot, start: Point, end: Point) -> None:
        """Record a collision when it begins; a lasting collision counts once."""
        near = {
            (STEM, name)
            for name, ball in zip(snapshot.ball_names, snapshot.balls, strict=True)
            if min(math.dist(start, ball), math.dist(end, ball)) < self._reach_mm + NEAR_MM
        }
        hit = snapshot.scene.first_hit(start, end, ignored=snapshot.allowed_contacts | near)
        now = {(hit.moving, hit.obstacle)} if hit is not None else set()
        now |= {
            (TIP, name)
            for name, ball in zip(snapshot.ball_names, snapshot.balls, strict=True)
            if math.dist(end, ball) < self._reach_mm - self._overtravel_mm
        }
        for moving, obstacle in sorted(now - self._colliding):
            self.world.collisions.append(Collision(self.world.now, moving, obstacle))
        self._colliding = now


def _sample_field(machine: TrueMachine, scenario: Scenario) -> DeviationGrid:
    """Sample the machine's deviation on a grid so fine that interpolation errors are below 0.1 µm."""
    low, high = np.array(scenario.machine.limits, dtype=np.float64).T
    cells = np.maximum(np.ceil((high - low) / GRID_STEP_MM), 1).astype(int)
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low, high, cells, strict=True)]
    layers = [_layer(machine, x, axes[1], axes[2]) for x in axes[0]]
    return DeviationGrid(low, (high - low) / cells, np.array(layers))


def _layer(machine: TrueMachine, x: float, ys: Array, zs: Array) -> Array:
    y, z = np.meshgrid(ys, zs, indexing="ij")
    places = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1)
    return machine.deviation(places).reshape(*y.shape, 3)


def _in_mm(values_um: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = values_um
    return 1e-3 * x, 1e-3 * y, 1e-3 * z
