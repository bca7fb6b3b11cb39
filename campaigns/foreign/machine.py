"""Machines that share nothing with the program: they have their own transforms, error functions and deflection.

The chain is tool-Y-Z-X-bed-workpiece with a ram along Y. The error motions of an axis are Legendre series of numpy,
sums of sines with free wavelengths, power series, or straight pieces of rail. The deflection is that of a ram and a
column which bend under gravity, with exponents and couplings that are drawn. The position of the tool point is the
exact product of rotations and translations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
TOOL = np.array([0.0, 250.0, 0.0])
CHAIN = "tool-Y-Z-X-bed-workpiece"
LOW, HIGH = np.array(RANGES).T
_TERMS = 9
_JOINTS = 7
KINDS = (0.15, 0.15, 0.15, 0.55)
"""Probabilities of waves, power series, rails and Legendre series."""
KIND_NAMES = ("waves", "powers", "rails", "polynomials")
_LINEAR_MM, _ANGULAR_RAD, _SQUARE_RAD = 6.0e-3, 5.0e-6, 7.0e-6


class Motion(Protocol):
    """Error motion of one axis."""

    def at(self, share: np.ndarray) -> np.ndarray:
        """Return displacements in mm and angles in rad (n, 6) at shares (n,) of the travel."""
        ...


class DrawnMachine(Protocol):
    """Machine whose true error field is known, whichever generator drew it."""

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Ends of the travel of each axis in mm."""
        ...

    @property
    def tool_offset(self) -> np.ndarray:
        """Vector (3,) in mm from the reference point of the ram to the tool centre point."""
        ...

    @property
    def motion_kinds(self) -> tuple[str, str, str]:
        """Kind of the error motions of each axis."""
        ...

    def deviation(self, axis_positions: np.ndarray, /) -> np.ndarray:
        """Return the position of the tool point minus the nominal one, (n, 3) in mm, at axis positions (n, 3)."""
        ...

    def angles(self, axis: int, positions: np.ndarray, /) -> np.ndarray:
        """Return the angular error motions (n, 3) in rad about X, Y and Z of the axis number `axis` at its positions
        (n,) in mm."""
        ...

    def axis_positions_at(self, points: np.ndarray) -> np.ndarray:
        """Return the axis positions (n, 3) at which the real tool point stands at workpiece points (n, 3)."""
        ...


@dataclass(frozen=True)
class Waves:
    """Sums of sines: amplitudes, wave numbers and phases (6, k), and a slope (6,) over the travel. The errors are as
    large in the middle of the travel as at its ends."""

    amplitude: np.ndarray
    wave: np.ndarray
    phase: np.ndarray
    slope: np.ndarray

    def at(self, share: np.ndarray) -> np.ndarray:
        angle = np.pi * self.wave[None] * share[:, None, None] + self.phase[None]
        found: np.ndarray = (self.amplitude[None] * np.sin(angle)).sum(axis=2) + self.slope * (share[:, None] - 0.5)
        return found


@dataclass(frozen=True)
class Polynomials:
    """Legendre series (6, k) of the orders 1 to k, by numpy. The errors grow towards the ends."""

    coefficients: np.ndarray

    def at(self, share: np.ndarray) -> np.ndarray:
        constant = np.zeros((6, 1))
        series = np.hstack((constant, self.coefficients)).T
        return np.asarray(np.polynomial.legendre.legval(2.0 * share - 1.0, series)).T


@dataclass(frozen=True)
class Powers:
    """Power series (6, k) about a point of the travel. The errors grow fast towards the ends."""

    coefficients: np.ndarray
    centre: float

    def at(self, share: np.ndarray) -> np.ndarray:
        argument = (share - self.centre) / max(self.centre, 1.0 - self.centre)
        powers = argument[:, None] ** np.arange(1, self.coefficients.shape[1] + 1)
        return np.asarray(powers @ self.coefficients.T)


@dataclass(frozen=True)
class Rails:
    """Rails of several pieces: values (6, k) at equally spaced joints, with a straight line between two joints."""

    values: np.ndarray

    def at(self, share: np.ndarray) -> np.ndarray:
        joints = np.linspace(0.0, 1.0, self.values.shape[1])
        return np.stack([np.interp(share, joints, row) for row in self.values], axis=1)


@dataclass(frozen=True)
class ForeignMachine:
    """Machine whose true error field is `deviation`, in mm, at axis positions (n, 3)."""

    motions: tuple[Motion, Motion, Motion]
    squareness: np.ndarray
    bending: np.ndarray
    ranges: tuple[tuple[float, float], ...] = RANGES
    worse: float = 1.0
    motion_kinds: tuple[str, str, str] = ("", "", "")

    @property
    def tool_offset(self) -> np.ndarray:
        """Vector (3,) in mm from the reference point of the ram to the tool centre point."""
        return TOOL

    def deviation(self, axis_positions: np.ndarray, /) -> np.ndarray:
        """Return the position of the tool point minus the nominal one, (n, 3) in mm."""
        low, high = np.array(self.ranges).T
        share = (axis_positions - low) / (high - low)
        square = self.worse * self.squareness
        directions = {  # X is the primary direction and Y the secondary one
            0: np.array([1.0, 0.0, 0.0]),
            1: np.array([-square[2], 1.0, 0.0]),
            2: np.array([square[1], -square[0], 1.0]),
        }
        point = np.broadcast_to(TOOL, axis_positions.shape)
        for axis in (1, 2, 0):  # from the tool to the bed
            found = self.worse * self.motions[axis].at(share[:, axis])
            travel = axis_positions[:, axis, None] - low[axis]
            point = _turned(found[:, 3:], point) + travel * directions[axis] + found[:, :3]
        nominal = axis_positions - low + TOOL
        return np.asarray(point - nominal + self.worse * self._bent(share))

    def angles(self, axis: int, positions: np.ndarray, /) -> np.ndarray:
        """Return the angular error motions (n, 3) in rad of one axis."""
        low, high = self.ranges[axis]
        return np.asarray(self.worse * self.motions[axis].at((positions - low) / (high - low))[:, 3:])

    def _bent(self, share: np.ndarray) -> np.ndarray:
        """Return the deflection (n, 3) in mm of ram and column."""
        x, y, z = np.clip(share, 0.0, 1.0).T
        droop, power, column, twist, swing, rail = self.bending
        dz = -droop * y**power * (1.0 + 0.4 * z) + rail * np.sin(7.0 * np.pi * x) * y
        dy = column * z**1.7 * y + swing * np.cos(2.2 * (x - z)) * y
        dx = twist * np.sin(np.pi * (x + 0.6 * y)) * z
        return 1e-3 * np.stack((dx, dy, dz), axis=1)

    def axis_positions_at(self, points: np.ndarray) -> np.ndarray:
        """Return the axis positions (n, 3) at which the real tool point stands at workpiece points (n, 3)."""
        found: np.ndarray = points - TOOL
        for _ in range(8):
            found = points - TOOL - self.deviation(found)
        return found


def foreign_machine(rng: np.random.Generator, worse: float = 1.0) -> ForeignMachine:
    """Draw a machine. Its error field is multiplied by `worse`."""
    x, y, z = (_motion(rng) for _ in range(3))
    bending = np.array([rng.uniform(3.0, 9.0), rng.uniform(1.4, 3.0), *rng.normal(0.0, [5.0, 4.0, 3.0, 1.5])])
    kinds = (type(x).__name__.lower(), type(y).__name__.lower(), type(z).__name__.lower())
    return ForeignMachine((x, y, z), rng.normal(0.0, _SQUARE_RAD, 3), bending, worse=worse, motion_kinds=kinds)


def _motion(rng: np.random.Generator) -> Motion:
    unit = np.array([_LINEAR_MM] * 3 + [_ANGULAR_RAD] * 3)[:, None]
    count = np.arange(1, _TERMS + 1)
    kind = rng.choice(4, p=KINDS)
    if kind == 3:
        return Polynomials(unit * rng.uniform(-1.25, 1.25, (6, _TERMS)) * 0.62 ** (count - 1))
    if kind == 0:
        wave = count + rng.uniform(-0.5, 0.5, (6, _TERMS))
        amplitude = unit * rng.uniform(-1.0, 1.0, (6, _TERMS)) / count**1.5
        return Waves(amplitude, wave, rng.uniform(0.0, 2.0 * np.pi, (6, _TERMS)), unit[:, 0] * rng.normal(size=6))
    if kind == 1:
        return Powers(unit * rng.uniform(-1.3, 1.3, (6, _TERMS)) * 0.75 ** (count - 1), rng.uniform(0.3, 0.7))
    return Rails(np.cumsum(unit * rng.normal(0.0, 0.45, (6, _JOINTS)), axis=1))


def _turned(angles: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Turn points (n, 3) about the origin by angles (n, 3) in rad, exactly: first about X, then Y, then Z."""
    x, y, z = point.T
    a, b, c = angles.T
    y, z = y * np.cos(a) - z * np.sin(a), y * np.sin(a) + z * np.cos(a)
    x, z = x * np.cos(b) + z * np.sin(b), -x * np.sin(b) + z * np.cos(b)
    x, y = x * np.cos(c) - y * np.sin(c), x * np.sin(c) + y * np.cos(c)
    return np.stack((x, y, z), axis=1)


def grid(counts: tuple[int, int, int] = (20, 10, 10)) -> np.ndarray:
    """Return axis positions (n, 3) over the whole travel, both ends included."""
    lines = [np.linspace(low, high, count) for (low, high), count in zip(RANGES, counts, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1).reshape(-1, 3)


GRID = grid()


def aligned_rms_um(points: np.ndarray, field: np.ndarray) -> float:
    """Return the rms in µm of the length of vectors (n, 3) in mm, after the best small rigid motion is removed."""
    arms = (points - points.mean(axis=0)) / 1000.0
    motions = np.zeros((len(points), 3, 6))
    motions[:, :, :3] = np.eye(3)
    for k, axis in enumerate(np.eye(3)):
        motions[:, :, 3 + k] = np.cross(axis, arms)
    flat = motions.reshape(-1, 6)
    rest = field.reshape(-1) - flat @ np.linalg.lstsq(flat, field.reshape(-1), rcond=None)[0]
    return 1e3 * float(np.sqrt((rest**2).sum() / len(points)))
