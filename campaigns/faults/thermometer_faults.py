"""Faults of the thermometers of artefact, machine and cell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.random import Generator

from campaigns.faults.fault_scene import FaultScene
from campaigns.faults.faulty_device import DEVICE
from drivers.errors import LinkTimeout
from twin.units import S_PER_MIN

SILENT = "the thermometers do not answer"

Readings = Mapping[str, float]


def wrong(scene: FaultScene, rng: Generator) -> None:
    """Let all thermometers show one value from now on, such as those that a failed sensor shows."""
    value = float(rng.choice([0.0, 85.0, -127.0, float("nan"), 18.0, 21.0, 25.0]))
    _alter(scene, f"{value:g} °C", lambda found: dict.fromkeys(found, value))


def stuck(scene: FaultScene, _: Generator) -> None:
    """Let all thermometers show what they show now, whatever the temperatures become."""
    shown: dict[str, float] = {}
    _alter(scene, "at the next reading", lambda found: shown or shown.update(found) or shown)


def wrong_unit(scene: FaultScene, rng: Generator) -> None:
    """Let all thermometers show degrees Fahrenheit or kelvins."""
    if rng.integers(2):
        _alter(scene, "°F", lambda found: {name: 1.8 * value + 32.0 for name, value in found.items()})
    else:
        _alter(scene, "K", lambda found: {name: value + 273.15 for name, value in found.items()})


def jumps(scene: FaultScene, rng: Generator) -> None:
    """Let one of the thermometers show a wild value for some readings."""
    left = int(rng.choice([1, 2, 3, 4, 20]))
    by_k = float(np.exp(rng.uniform(np.log(1.0), np.log(200.0))) * rng.choice([-1.0, 1.0]))
    which = int(rng.integers(3))

    def change(found: Readings) -> Readings:
        nonlocal left
        left -= 1
        return _changed(found, which, by_k) if left >= 0 else found

    _alter(scene, f"{left} readings, sensor {which}, by {by_k:+.1f} K", change)


def drifts(scene: FaultScene, rng: Generator) -> None:
    """Let one of the thermometers show more and more, or less and less, as one that falls off."""
    per_h = float(np.exp(rng.uniform(np.log(0.2), np.log(60.0))) * rng.choice([-1.0, 1.0]))
    which, began_s, clock = int(rng.integers(3)), scene.clock.now(), scene.clock

    def change(found: Readings) -> Readings:
        return _changed(found, which, per_h * (clock.now() - began_s) / (60.0 * S_PER_MIN))

    _alter(scene, f"sensor {which} by {per_h:+.1f} K/h", change)


def lost(scene: FaultScene, rng: Generator) -> None:
    """Lose the thermometers: one or all give no number, or they do not answer; for some readings or until the
    morning."""
    how, left = int(rng.integers(3)), int(rng.choice([1, 3, 4, 10**9]))
    until = "until the morning" if left > 4 else f"{left} readings"

    def change(found: Readings) -> Readings:
        nonlocal left
        left -= 1
        if left < 0:
            return found
        if how == 2:
            raise LinkTimeout(SILENT, hint="check their cable", link="1-wire", device=DEVICE)
        return {} if how else {name: float("nan") for name in found}

    _alter(scene, f"{('no number', 'no sensor', 'no answer')[how]}, {until}", change)


def _changed(found: Readings, which: int, by_k: float) -> Readings:
    """Return the readings with that of the sensor number `which`, in the order of their names, changed."""
    names = sorted(found)
    changed = names[which % len(names)]
    return {name: value + by_k * (name == changed) for name, value in found.items()}


def _alter(scene: FaultScene, size: str, change: Callable[[Readings], Readings]) -> None:
    scene.size = size

    def read(real: Any) -> Readings:
        return change(real())

    scene.machine.alter(temperatures_c=read)
