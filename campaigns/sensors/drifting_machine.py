"""Machines whose errors drift with their temperatures, or with anything else, made without the code of the program.

A machine has 24 errors in µm. Scales grow with the body that carries them, squareness and bows follow differences of
two bodies, slightly more than in proportion; a head without a sensor adds its own; and all errors walk. Nights measure
combinations of the errors with noise, and an artefact whose error is the same in all nights. In the hours between,
nothing is measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from campaigns.sensors.hall_climate import BODIES, Array, hall_climate

Kind = Literal["thermal", "unrelated", "decoys", "stuck"]
KINDS: tuple[Kind, ...] = ("thermal", "unrelated", "decoys", "stuck")
ERRORS = 24
WIDTH_UM = 8.0
"""Standard deviation of the errors of machines of this kind, which the program is told."""
SENSOR_SIGMA_K = 0.1
_NIGHT_HOUR = 3
_CURVED = 0.03  # of the effect per kelvin
_COLUMN, _RAM, _BED, _AIR = range(4)
_DECOYS_FROM = 2


@dataclass(frozen=True, eq=False)
class DriftingMachine:
    """Measurements of a machine in n nights, and what it really did in every hour.

    `days` (n,) are the nights. `estimates` (n, p) in µm have the covariance `covariance` (p, p). `readings_c` (n, 4)
    and `spans_k` (n, 4) are mean and range of the sensors in the night. `explaining` are the sensors of bodies with
    which the errors change; `decoys` are those whose bodies have nothing to do with the machine; `stuck` those that
    stick. `true` (h, p) and `hourly_c` (h, 4) are errors and readings of each hour after the first midnight.
    """

    kind: Kind
    sensors: tuple[str, ...]
    days: Array
    estimates: Array
    covariance: Array
    readings_c: Array
    spans_k: Array
    explaining: frozenset[int]
    decoys: frozenset[int]
    stuck: frozenset[int]
    true: Array
    hourly_c: Array

    @property
    def last_hour(self) -> int:
        """Hour of the last night."""
        return round(24.0 * float(self.days[-1]))


def drifting_machine(number: int, kind: Kind) -> DriftingMachine:
    """Return the machine with this number, which with the kind is the seed of all that differs between machines."""
    rng = np.random.default_rng([17, number, KINDS.index(kind)])
    count = int(rng.integers(28, 90))
    climate = hall_climate(rng, count + 1)
    bodies = climate.bodies.copy()
    strength, active = (0.0, []) if kind == "unrelated" else (1.0, [_COLUMN, _RAM, _BED])
    shown = bodies.copy()
    decoys: frozenset[int] = frozenset()
    if kind == "unrelated":
        decoys = frozenset(range(4))
    elif kind == "decoys":  # two sensors hang in other halls; what they should have shown does not move the machine
        elsewhere = hall_climate(rng, count + 1).bodies
        shown[:, _DECOYS_FROM:] = elsewhere[:, _DECOYS_FROM:]
        bodies[:, _DECOYS_FROM:] = 20.0
        decoys, active = frozenset(range(_DECOYS_FROM, 4)), [_COLUMN, _RAM]
    true = strength * _thermal_um(rng, bodies, climate.head) + _other_um(rng, len(bodies), kind)
    nights = np.arange(count)[rng.uniform(size=count) > rng.choice([0.0, 0.1, 0.3])]
    hours = 24 * nights + _NIGHT_HOUR
    readings = shown + rng.normal(0.0, 0.3, 4) + rng.normal(0.0, SENSOR_SIGMA_K, shown.shape)
    stuck: frozenset[int] = frozenset()
    if kind == "stuck":
        place, since = int(rng.integers(0, 4)), 24 * int(count * rng.uniform(0.4, 0.75))
        readings[since:, place] = readings[since, place]
        stuck = frozenset({place})
        active = [body for body in active if body != place]
    covariance = _covariance(rng)
    constant = rng.multivariate_normal(np.zeros(ERRORS), 0.3 * covariance)
    noise = rng.multivariate_normal(np.zeros(ERRORS), 0.7 * covariance, len(hours))
    spans = np.where(np.isin(np.arange(4), list(stuck)), 0.0, rng.uniform(0.05, 0.2, (len(hours), 4)))
    return DriftingMachine(
        kind,
        BODIES,
        hours / 24.0,
        true[hours] + constant + noise,
        covariance,
        readings[hours],
        spans,
        frozenset(active),
        decoys,
        stuck,
        true,
        readings,
    )


def _thermal_um(rng: np.random.Generator, bodies: Array, head: Array) -> Array:
    """Return the thermal change (h, p) of the errors in µm: 2 to 12 µm per K at the end of the travel for a scale, and
    a tenth to a half of it for squareness and bows per K of a difference."""
    above = bodies - 20.0
    effect = np.zeros((len(bodies), ERRORS))
    scales = rng.uniform(2.0, 8.0, 3) * rng.choice([0.3, 1.0], 3)
    for error, body in enumerate((_BED, _RAM, _COLUMN)):
        effect[:, error] = scales[error] * above[:, body]
    pairs = ((_COLUMN, _BED), (_RAM, _COLUMN), (_AIR, _COLUMN), (_AIR, _BED))
    for error in range(3, 12):
        one, other = pairs[int(rng.integers(0, 3))]
        effect[:, error] = rng.uniform(-2.0, 2.0) * (above[:, one] - above[:, other])
    effect += _CURVED * effect * np.abs(above[:, [_COLUMN]])
    effect[:, 12:16] += rng.uniform(-0.25, 0.25, 4) * (head[:, None] - 20.0)
    return effect


def _other_um(rng: np.random.Generator, count: int, kind: Kind) -> Array:
    """Return what else changes (h, p): start, walk, wear, and for an unrelated machine cycles of its own."""
    start = rng.normal(0.0, WIDTH_UM, ERRORS)
    hours = np.arange(count, dtype=np.float64)[:, None]
    size = rng.choice([0.05, 0.2, 0.5]) * (2.0 if kind == "unrelated" else 1.0)
    walk = np.cumsum(size / np.sqrt(24.0) * rng.standard_normal((count, ERRORS)), axis=0)
    wear = rng.normal(0.0, 0.02, ERRORS) * hours / 24.0
    if kind != "unrelated":
        return np.asarray(start + walk + wear)
    period, phase = rng.uniform(9.0, 40.0, ERRORS), rng.uniform(0.0, 1.0, ERRORS)
    cycles = rng.uniform(0.0, 3.0, ERRORS) * np.sin(2.0 * np.pi * (hours / 24.0 / period + phase))
    return np.asarray(start + walk + wear + cycles)


def _covariance(rng: np.random.Generator) -> Array:
    """Return the covariance (p, p) in µm² of a night that sees some combinations well and others hardly."""
    rows = rng.normal(size=(40, ERRORS)) * np.geomspace(1.0, 0.05, ERRORS)[rng.permutation(ERRORS)]
    return np.asarray(np.linalg.inv(rows.T @ rows / rng.uniform(2.0, 20.0) + np.eye(ERRORS) / WIDTH_UM**2))
