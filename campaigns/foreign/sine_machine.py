"""Machines of a second generator: uniform Legendre series of drawn orders, sines of short wavelength on them, and beams
that bend.

The generator shares no code with the program or with `campaigns.foreign.machine`. The chain is the same,
tool-Y-Z-X-bed-workpiece, but the tool point is found from homogeneous matrices (4, 4). The error motions have the
amplitudes of the program's family of machines, so the prior of the program is right for them. What the family does not
have is the rest: in each error motion, a sine with three to eight periods per travel, whose size is drawn for the whole
machine, and the deflection of a cantilever ram on a column. Most of the sines are too short for any set of positions to
resolve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_LOW = np.zeros(3)
_HIGH = np.array([4000.0, 1300.0, 1500.0])
_TOOL = np.array([0.0, 250.0, 0.0])
_ORDERS = (5, 9)
_DECAY = 0.6
_HALF_WIDTHS_UM = {"along": (8.0, 5.0, 3.0, 1.8, 1.1), "across": (5.5, 3.3, 2.0, 1.2)}
_HALF_WIDTHS_URAD = (4.6, 2.8, 1.7, 1.0, 0.6)
_SQUARENESS_URAD = 9.0
_LARGEST_SINE = 1.5  # µm, and µrad
_PERIODS = (3.0, 8.0)


@dataclass(frozen=True)
class SineMachine:
    """Machine whose true error field is `deviation`, in mm, at axis positions (n, 3).

    `series` (3, 6, k) holds the Legendre coefficients of the orders 0 to k - 1 of each axis, in mm and rad; the six
    errors are the displacements along X, Y and Z and the angles about X, Y and Z. `sines` (3, 6, 3) holds amplitude,
    periods per travel and phase of one sine in each error motion. `squareness` (3,) is that of Z to Y, Z to X and Y to
    X, in rad. `bending_um` (6,) holds the sizes of the deflections.
    """

    series: np.ndarray
    sines: np.ndarray
    squareness: np.ndarray
    bending_um: np.ndarray

    @property
    def ranges(self) -> tuple[tuple[float, float], ...]:
        """Ends of the travel of each axis in mm."""
        return tuple(zip(_LOW.tolist(), _HIGH.tolist(), strict=True))

    @property
    def tool_offset(self) -> np.ndarray:
        """Vector (3,) in mm from the reference point of the ram to the tool centre point."""
        return _TOOL

    @property
    def motion_kinds(self) -> tuple[str, str, str]:
        """Kind of the error motions of each axis."""
        return ("sines", "sines", "sines")

    def deviation(self, axis_positions: np.ndarray, /) -> np.ndarray:
        """Return the position of the tool point minus the nominal one, (n, 3) in mm."""
        share = (axis_positions - _LOW) / (_HIGH - _LOW)
        chain = np.broadcast_to(np.eye(4), (len(share), 4, 4))
        for axis in (0, 2, 1):  # from the bed to the tool
            chain = chain @ self._joint(axis, share[:, axis])
        point = (chain @ np.append(_TOOL, 1.0))[:, :3]
        return np.asarray(point - (axis_positions - _LOW + _TOOL) + self._bending(np.clip(share, 0.0, 1.0)))

    def angles(self, axis: int, positions: np.ndarray, /) -> np.ndarray:
        """Return the angular error motions (n, 3) in rad of one axis at its positions (n,) in mm."""
        return self._errors(axis, (positions - _LOW[axis]) / (_HIGH - _LOW)[axis])[:, 3:]

    def _errors(self, axis: int, share: np.ndarray) -> np.ndarray:
        """Return the error motions (n, 6) of an axis in mm and rad at shares (n,) of its travel."""
        amplitude, periods, phase = self.sines[axis].T
        errors = np.polynomial.legendre.legval(2.0 * share - 1.0, self.series[axis].T).T
        return np.asarray(errors + amplitude * np.sin(2.0 * np.pi * periods * share[:, None] + phase))

    def _joint(self, axis: int, share: np.ndarray) -> np.ndarray:
        """Return the homogeneous matrices (n, 4, 4) of an axis at shares (n,) of its travel."""
        errors = self._errors(axis, share)
        zy, zx, yx = self.squareness.tolist()
        along = np.array([[1.0, 0.0, 0.0], [-yx, 1.0, 0.0], [zx, -zy, 1.0]])[axis]
        joint = np.zeros((len(share), 4, 4))
        joint[:, 3, 3] = 1.0
        joint[:, :3, 3] = share[:, None] * (_HIGH - _LOW)[axis] * along + errors[:, :3]
        joint[:, :3, :3] = _rotation(errors[:, 3:])
        return joint

    def _bending(self, share: np.ndarray) -> np.ndarray:
        """Return the deflection (n, 3) in mm of a ram that reaches out along Y and of the column that carries it."""
        x, y, z = share.T
        droop, nod, lean, twist, sway, bed = self.bending_um
        ram = 0.5 * y**2 * (3.0 - y)  # deflection curve of a cantilever with a load at its end
        dx = twist * z**2 * y + sway * z * y**2 * (2.0 * x - 1.0)
        dy = nod * z**2 * ram + lean * z * y
        dz = -droop * ram * (1.0 + 0.3 * np.cos(np.pi * z)) + bed * y**2 * (2.0 * x - 1.0) ** 2
        return 1e-3 * np.stack((dx, dy, dz), axis=1)

    def axis_positions_at(self, points: np.ndarray) -> np.ndarray:
        """Return the axis positions (n, 3) at which the real tool point stands at workpiece points (n, 3)."""
        wanted: np.ndarray = points - _TOOL
        found = wanted
        for _ in range(8):
            found = wanted - self.deviation(found)
        return found


def sine_machine(rng: np.random.Generator, largest_sine: float = _LARGEST_SINE) -> SineMachine:
    """Draw a machine. The size of its sines lies between 0 and `largest_sine`, in µm and µrad."""
    series = np.zeros((3, 6, _ORDERS[1] + 1))
    for axis in range(3):
        for error in range(6):
            last = int(rng.integers(_ORDERS[0], _ORDERS[1] + 1))
            first = 1 if error == axis or error > 2 else 2  # a straightness has no slope
            widths = _widths(axis, error, last - first + 1)
            series[axis, error, first : last + 1] = widths * rng.uniform(-1.0, 1.0, len(widths))
    units = np.array([1e-3] * 3 + [1e-6] * 3)
    sines = np.empty((3, 6, 3))
    sines[:, :, 0] = rng.uniform(0.0, largest_sine) * units * rng.uniform(-1.0, 1.0, (3, 6))
    sines[:, :, 1] = rng.uniform(*_PERIODS, (3, 6))
    sines[:, :, 2] = rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    squareness = 1e-6 * _SQUARENESS_URAD * rng.uniform(-1.0, 1.0, 3)
    bending = np.array([rng.uniform(3.0, 9.0), *rng.normal(0.0, [4.0, 3.0, 3.0, 3.0, 2.0])])
    return SineMachine(series, sines, squareness, bending)


def _widths(axis: int, error: int, count: int) -> np.ndarray:
    """Return the half-widths (count,) of the coefficients of an error motion, from its lowest order, in mm or rad."""
    stated = _HALF_WIDTHS_URAD if error > 2 else _HALF_WIDTHS_UM["along" if error == axis else "across"]
    beyond = [stated[-1] * _DECAY**k for k in range(1, count - len(stated) + 1)]
    return np.array([*stated, *beyond][:count]) * (1e-6 if error > 2 else 1e-3)


def _rotation(angles: np.ndarray) -> np.ndarray:
    """Return the rotations (n, 3, 3) by angles (n, 3) in rad about X, then Y, then Z."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(angles).T, np.sin(angles).T
    rows = [
        [cb * cc, sa * sb * cc - ca * sc, ca * sb * cc + sa * sc],
        [cb * sc, sa * sb * sc + ca * cc, ca * sb * sc - sa * cc],
        [-sb, sa * cb, ca * cb],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
