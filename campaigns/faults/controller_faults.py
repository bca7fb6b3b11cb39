"""Faults of the controller and of its compensation store."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.random import Generator

from campaigns.aborts.case import FORMER_BANK
from campaigns.faults.fault_scene import OTHER_BANK, FaultScene
from campaigns.faults.faulty_device import DEVICE
from drivers.errors import CommandRejected, StoreError
from drivers.roles import Miss, Permission, TableImage, Touch, Vector

COMMANDS = ("move_to", "touch_towards", "orient_to", "stage", "activate")
SHORTEST_S, LONGEST_S = 0.1, 300.0


def duration_s(rng: Generator) -> float:
    """Return a duration of a fault in s; the logarithm is distributed evenly."""
    return float(np.exp(rng.uniform(np.log(SHORTEST_S), np.log(LONGEST_S))))


def busy(scene: FaultScene, rng: Generator) -> None:
    """Let the controller refuse every command for some time."""
    lasts_s = duration_s(rng)
    until_s = scene.clock.now() + lasts_s
    scene.size = f"{lasts_s:.1f} s"

    def refuse(name: str) -> None:
        if name in COMMANDS and scene.clock.now() < until_s:
            raise CommandRejected("the controller is busy", hint="wait until it is ready", device=DEVICE)

    scene.machine.check(refuse)


def emergency_stop(scene: FaultScene, _: Generator) -> None:
    """Press the emergency stop; it is released in the morning."""
    scene.world.controller.fail("emergency stop")
    scene.note_stop()

    def refuse(_: Any) -> None:
        raise CommandRejected("the emergency stop is pressed", hint="release it", device=DEVICE)

    scene.machine.alter(reset=refuse)


def door(scene: FaultScene, _: Generator) -> None:
    """Open the doors: the controller stops and permits no motion."""
    controller = scene.world.controller
    controller.granted[Permission.DOORS_CLOSED] = False
    controller.fail("door opened")
    scene.note_stop()
    scene.repairs.append(lambda: controller.granted.update({Permission.DOORS_CLOSED: True}))


def wrong_bank(scene: FaultScene, rng: Generator) -> None:
    """Let an activation make another bank active, and report that bank or the one asked for."""
    lies, lasting = bool(rng.integers(2)), bool(rng.integers(2))
    asked = [FORMER_BANK]
    scene.size = f"{'reported as asked' if lies else 'reported'}, {'always' if lasting else 'once'}"

    def activate(real: Any, bank: int) -> None:
        asked[:] = [bank]
        real(OTHER_BANK)
        scene.deceived.update([bank] if lies else [])
        if not lasting:
            end()

    def active_bank(real: Any) -> int:
        found = int(real())
        return asked[0] if lies and found == OTHER_BANK else found

    end = scene.machine.alter(activate=activate)
    scene.machine.alter(active_bank=active_bank)


def no_effect(scene: FaultScene, rng: Generator) -> None:
    """Let an activation change nothing, and report the bank that acts or the one asked for."""
    lies = bool(rng.integers(2))
    asked: list[int] = []
    scene.size = "reported as active" if lies else "reported as it is"

    def activate(_: Any, bank: int) -> None:
        asked[:] = [bank]
        scene.deceived.update([bank] if lies else [])

    def active_bank(real: Any) -> int:
        return asked[0] if lies and asked else int(real())

    scene.machine.alter(activate=activate, active_bank=active_bank)


def flipped_bit(scene: FaultScene, rng: Generator) -> None:
    """Let the controller store the next table with one bit altered."""
    bit, where = int(rng.integers(12)), float(rng.random())
    scene.size = f"bit {bit}"

    def stage(real: Any, bank: int, table: TableImage) -> None:
        counts = table.counts.copy()
        flat = counts.reshape(-1)
        flat[int(where * flat.size)] ^= 1 << bit
        real(bank, replace(table, counts=counts))

    scene.machine.alter(stage=stage)


def _distorted(scene: FaultScene, factor: float) -> None:
    held: dict[int, TableImage] = {}

    def stage(real: Any, bank: int, table: TableImage) -> None:
        counts = np.rint(table.counts * factor).astype(np.int32)
        held[bank] = table
        real(bank, replace(table, counts=counts))

    def read_table(real: Any, bank: int) -> TableImage | None:
        return held.get(bank) or real(bank)

    scene.size = f"factor {factor:g}"
    scene.machine.alter(stage=stage, read_table=read_table)


def reversed_sign(scene: FaultScene, _: Generator) -> None:
    """Let the controller subtract the corrections of the next table, and read back what was written."""
    _distorted(scene, -1.0)


def wrong_unit(scene: FaultScene, rng: Generator) -> None:
    """Let the controller apply a part or a multiple of the corrections of the next table."""
    _distorted(scene, float(rng.choice([0.0, 0.1, 0.5, 2.0, 10.0])))


def refused_table(scene: FaultScene, rng: Generator) -> None:
    """Let the store refuse the writing or the activation of a table, once or always."""
    name, lasting = str(rng.choice(["stage", "activate", "read_table"])), bool(rng.integers(2))
    scene.size = f"{name}, {'always' if lasting else 'once'}"

    def refuse(_: Any, *__: Any) -> Any:
        if not lasting:
            end()
        raise StoreError("the store refuses", hint="check its protection", device=DEVICE)

    end = scene.machine.alter(**{name: refuse})


def stale_latch(scene: FaultScene, rng: Generator) -> None:
    """Let touches return the position that was latched before: once, several times, or always."""
    left = int(rng.choice([1, 3, 10**9]))
    scene.size = "always" if left > 3 else f"{left} times"
    last: list[Touch] = []

    def touch(real: Any, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        nonlocal left
        touched: Touch | Miss = real(target_mm, feed_mm_per_s=feed_mm_per_s)
        if isinstance(touched, Miss):
            return touched
        stale = last[0] if last and left > 0 else None
        if stale is None:
            last[:] = [touched]
            return touched
        left -= 1
        return stale

    scene.machine.alter(touch_towards=touch)


def stops_short(scene: FaultScene, rng: Generator) -> None:
    """Let the next move end at a part of its way."""
    part = float(rng.uniform(0.0, 0.999))
    scene.size = f"after {100.0 * part:.0f} % of the way"

    def move(real: Any, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        end()
        began = scene.world.controller.displayed_position()
        real(began + part * (target_mm - began), feed_mm_per_s=feed_mm_per_s, guarded=guarded)

    end = scene.machine.alter(move_to=move)
