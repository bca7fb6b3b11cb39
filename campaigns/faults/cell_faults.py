"""Faults of the cell: the artefact, its mount, the probe, the units of the controller."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from agent.settings.schema import ProcedureSettings
from campaigns.faults.fault_scene import FaultScene
from drivers.roles import AxisLimits, Vector
from twin.arrays import Array
from twin.artefact.artefact import Artefact
from twin.collision.bodies import ball_name, post_name
from twin.collision.geometry import Point

MM_PER_INCH = 25.4
CLEARANCE_MM = ProcedureSettings().clearance_mm


def mount_off(scene: FaultScene, rng: Generator) -> None:
    """Turn the mount about the vertical by some tenths of a degree, as after a knock."""
    by_deg = float(rng.uniform(0.02, 0.5) * rng.choice([-1.0, 1.0]))
    scene.size = f"{by_deg:+.2f}°"
    _shift(scene, (0.0, 0.0, 0.0), by_deg)


def mount_knocked(scene: FaultScene, rng: Generator) -> None:
    """Displace the mount by up to some millimetres."""
    x, y = (float(value) for value in rng.uniform(-1.0, 1.0, 2) * np.exp(rng.uniform(np.log(0.002), np.log(5.0))))
    scene.size = f"{x:+.3f}, {y:+.3f} mm"
    _shift(scene, (x, y, 0.0), 0.0)


def bar_reversed(scene: FaultScene, _: Generator) -> None:
    """Mount the bar the other way round: half a turn about the axis of its holders."""
    artefact = scene.world.workpiece.artefact
    _carry(scene, artefact.balls * (-1.0, 1.0, -1.0))


def ball_missing(scene: FaultScene, rng: Generator) -> None:
    """Remove one ball."""
    artefact = scene.world.workpiece.artefact
    ball = int(rng.integers(artefact.count))
    scene.size = f"ball {ball}"
    left = np.arange(artefact.count) != ball
    rows = np.repeat(left, 3)
    feet = artefact.body.feet_mm
    body = artefact.body if feet is None else replace(artefact.body, feet_mm=feet[left])
    scene.world.workpiece.carry(
        replace(artefact, balls=artefact.balls[left], covariance=artefact.covariance[np.ix_(rows, rows)], body=body)
    )


def ball_exchanged(scene: FaultScene, rng: Generator) -> None:
    """Displace one ball, as after an exchange of its stem."""
    balls = scene.world.workpiece.artefact.balls.copy()
    ball = int(rng.integers(len(balls)))
    by_mm = rng.standard_normal(3) * np.exp(rng.uniform(np.log(0.005), np.log(2.0)))
    scene.size = f"ball {ball} by {np.linalg.norm(by_mm):.3f} mm"
    balls[ball] += by_mm
    _displace(scene, balls)


def wrong_bar(scene: FaultScene, rng: Generator) -> None:
    """Mount another specimen of the same bar, whose certificate is not the one in the settings."""
    artefact = scene.world.workpiece.artefact
    sigma_mm = float(np.exp(rng.uniform(np.log(0.01), np.log(1.0))))
    scene.size = f"balls scatter by {sigma_mm:.3f} mm"
    _displace(scene, artefact.balls + sigma_mm * rng.standard_normal(artefact.balls.shape))


def _shift(scene: FaultScene, by_mm: Point, turned_deg: float) -> None:
    """Move the mount with all balls and posts, and note them if one of them may be off by more than the clearance."""
    balls = scene.world.workpiece.artefact.balls
    lever_mm = float(np.linalg.norm(balls, axis=1).max())
    if np.linalg.norm(by_mm) + abs(np.deg2rad(turned_deg)) * lever_mm > CLEARANCE_MM:
        scene.displaced |= {name(ball) for name in (ball_name, post_name) for ball in range(len(balls))}
    scene.world.workpiece.shift(by_mm, turned_deg)


def _displace(scene: FaultScene, balls: Array) -> None:
    """Put the balls elsewhere, and note those that are off by more than the clearance of the paths."""
    off_mm = np.linalg.norm(balls - scene.world.workpiece.artefact.balls, axis=1)
    scene.displaced |= {ball_name(int(ball)) for ball in np.flatnonzero(off_mm > CLEARANCE_MM)}
    _carry(scene, balls)


def _carry(scene: FaultScene, balls: Array) -> None:
    artefact: Artefact = scene.world.workpiece.artefact
    scene.world.workpiece.carry(replace(artefact, balls=balls))


def inches(scene: FaultScene, rng: Generator) -> None:
    """Let the controller display and accept inches."""
    told = bool(rng.integers(2))
    scene.size = "limits in inches" if told else "limits in mm"
    device = scene.machine

    def move(real: Any, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        feed = None if feed_mm_per_s is None else feed_mm_per_s * MM_PER_INCH
        real(target_mm * MM_PER_INCH, feed_mm_per_s=feed, guarded=guarded)

    def touch(real: Any, target_mm: Vector, *, feed_mm_per_s: float) -> Any:
        touched = real(target_mm * MM_PER_INCH, feed_mm_per_s=feed_mm_per_s * MM_PER_INCH)
        return replace(touched, position_mm=tuple(value / MM_PER_INCH for value in touched.position_mm))

    def limits(real: Any) -> AxisLimits:
        found: AxisLimits = real()
        if not told:
            return found
        inch = {name: tuple(value / MM_PER_INCH for value in getattr(found, name)) for name in vars(found)}
        return AxisLimits(**inch)

    device.alter(move_to=move, touch_towards=touch, position=lambda real: real() / MM_PER_INCH, limits=limits)


def probe_battery(scene: FaultScene, _: Generator) -> None:
    """Let the battery of the probe die."""
    controller = scene.world.controller
    controller.probe_healthy = False

    def renew() -> None:
        controller.probe_healthy = True

    scene.repairs.append(renew)
