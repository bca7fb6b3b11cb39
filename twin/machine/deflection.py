"""Gravity deflection of a machine: displacements of the tool point on a grid of axis positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.arrays import Array, as_points
from twin.errors import ModelError
from twin.machine.kinematic_chain import AXES

_ROUNDING_MM = 1e-6  # a position computed to be on the border may miss it by its last digits


@dataclass(frozen=True)
class DeflectionGrid:
    """Displacements of the tool point on a grid of axis positions.

    `x`, `y` and `z` contain the node positions of the axes in mm, in ascending order. `values` (nx, ny, nz, 3) contains
    the displacements in mm at the nodes.
    """

    x: Array
    y: Array
    z: Array
    values: Array

    def __post_init__(self) -> None:
        for axis, nodes in zip(AXES, self.nodes, strict=True):
            if nodes.ndim != 1 or nodes.size < 2:
                raise ModelError("a deflection grid needs at least two nodes along every axis", axis=axis)
            if not (np.isfinite(nodes).all() and (np.diff(nodes) > 0.0).all()):
                raise ModelError("deflection grid nodes must be finite and ascending", axis=axis)
        expected = (self.x.size, self.y.size, self.z.size, 3)
        if self.values.shape != expected:
            raise ModelError(f"deflection values have shape {self.values.shape}, expected {expected}")
        if not np.isfinite(self.values).all():
            raise ModelError("deflection values must be finite")

    @property
    def nodes(self) -> tuple[Array, Array, Array]:
        return self.x, self.y, self.z

    def at(self, axis_positions: ArrayLike) -> Array:
        """Return the displacements (n, 3) in mm at axis positions (n, 3) in mm, by trilinear interpolation.

        Raises ModelError if an axis position is outside the grid; the message names the first such position.
        """
        points = as_points(axis_positions, "axis positions")
        self._check_inside(points)
        (i, u), (j, v), (k, w) = (_cell(nodes, points[:, axis]) for axis, nodes in enumerate(self.nodes))
        base = (i * self.y.size + j) * self.z.size + k
        flat = self.values.reshape(-1, 3)
        # trilinear: sum over the 8 corners of (1-u or u)(1-v or v)(1-w or w) times the corner value
        displacement = np.zeros_like(points)
        for step_x, share_x in ((0, 1.0 - u), (self.y.size * self.z.size, u)):
            for step_y, share_y in ((0, 1.0 - v), (self.z.size, v)):
                share, corner = share_x * share_y, base + (step_x + step_y)
                displacement += (share * (1.0 - w))[:, None] * flat.take(corner, axis=0)
                displacement += (share * w)[:, None] * flat.take(corner + 1, axis=0)
        return displacement

    def covers(self, ranges_mm: tuple[tuple[float, float], ...]) -> bool:
        """Return True if every axis range in `ranges_mm` lies inside the grid."""
        return all(
            nodes[0] <= low + _ROUNDING_MM and high <= nodes[-1] + _ROUNDING_MM
            for nodes, (low, high) in zip(self.nodes, ranges_mm, strict=True)
        )

    def _check_inside(self, points: Array) -> None:
        low, high = np.array([(nodes[0] - _ROUNDING_MM, nodes[-1] + _ROUNDING_MM) for nodes in self.nodes]).T
        outside = (points < low) | (points > high)
        if outside.any():
            row, axis = divmod(int(np.argmax(outside)), 3)
            point = ", ".join(f"{value:.3f}" for value in points[row])
            nodes = self.nodes[axis]
            message = f"axis position ({point}) lies outside the deflection grid, {nodes[0]:g} to {nodes[-1]:g} mm"
            hint = "Provide a grid that covers the whole travel"
            raise ModelError(message, hint=hint, axis=AXES[axis], row=row)


@dataclass(frozen=True)
class CantileverStructure:
    """Moving-column machine modelled as beams. Loads are in N, lengths in mm and the bending stiffness EI in N mm².

    `overhang_mm` is the overhang of the ram beyond the column at the lower end of the Y axis; travel in Y adds to the
    overhang. `column_foot_mm` is the height of the ram axis above the foot of the column at the lower end of the Z
    axis. The saddle of the column runs on two trucks, which are `wheelbase_mm` apart. The trucks run on a bed whose
    supports are `support_pitch_mm` apart.
    """

    ram_load_n_per_mm: float = 3.0
    head_weight_n: float = 3000.0
    overhang_mm: float = 250.0
    ram_stiffness_n_mm2: float = 1.6e15
    ram_joint_rad_per_n_mm: float = 1.5e-13
    column_foot_mm: float = 500.0
    column_stiffness_n_mm2: float = 4.0e15
    foot_joint_rad_per_n_mm: float = 1.0e-13
    support_pitch_mm: float = 800.0
    wheelbase_mm: float = 1100.0
    bed_sag_mm: float = 1.6e-3
    bed_roll_rad_per_n_mm: float = 2.0e-13
    column_rail_pitch_mm: float = 480.0
    column_rail_wave_mm: float = 0.8e-3


CASE_STUDY_NODES = (
    np.linspace(0.0, 4000.0, 9),
    np.linspace(0.0, 1300.0, 15),
    np.linspace(0.0, 1500.0, 13),
)


def cantilever_deflection(x: Array, y: Array, z: Array, structure: CantileverStructure | None = None) -> DeflectionGrid:
    """Return plausible deflections of a moving-column machine with an overhanging ram, computed from Euler-Bernoulli
    beams.

    `x`, `y` and `z` are the grid nodes in mm. The deflection is zero in the middle of the grid, where the machine was
    levelled.

    Four effects are added. First, the moment of the overhanging ram and its head bends the column. This is the
    cross-effect: a displacement along Y and a rotation about X that grow with height. Second, the ram bends under its
    own weight and the weight of the head. Third, the joint of the ram and the joint at the foot of the column rotate
    under this moment. Fourth, the bed and the column rails yield locally.
    """
    parts = structure or CantileverStructure()
    x3, y3, z3 = np.meshgrid(x, y, z, indexing="ij")
    reach = parts.overhang_mm + (y3 - y[0])
    height = parts.column_foot_mm + (z3 - z[0])
    moment = _ram_moment(parts, reach)
    sag, pitch, roll = _bed(parts, x3, moment)
    # Column as a cantilever with end moment M at height h: slope M h / EI, deflection M h² / 2EI;
    # the foot joint adds the slope M c and the deflection M c h.
    column_nod = moment * (height / parts.column_stiffness_n_mm2 + parts.foot_joint_rad_per_n_mm) + roll
    column_lean = moment * height**2 / (2.0 * parts.column_stiffness_n_mm2)
    column_lean += (moment * parts.foot_joint_rad_per_n_mm + roll) * height
    droop = _ram_droop(parts, reach) + moment * parts.ram_joint_rad_per_n_mm * reach
    values = np.stack(
        (
            pitch * height,
            column_lean + _column_rail_wave(parts, z3, moment),
            -(droop + column_nod * reach + sag),
        ),
        axis=-1,
    )
    middle = DeflectionGrid(x, y, z, values).at([[0.5 * (n[0] + n[-1]) for n in (x, y, z)]])
    return DeflectionGrid(x, y, z, values - middle[0])


def _ram_moment(parts: CantileverStructure, reach: Array) -> Array:
    """Return the moment of the overhanging ram about the column in N mm."""
    return 0.5 * parts.ram_load_n_per_mm * reach**2 + parts.head_weight_n * reach


def _ram_droop(parts: CantileverStructure, reach: Array) -> Array:
    """Return the sag in mm of the end of the ram, w L⁴ / 8EI + P L³ / 3EI.

    Here w is the weight of the ram per mm, P the weight of the head, L the overhang (`reach`) and EI the bending
    stiffness.
    """
    own = parts.ram_load_n_per_mm * reach**4 / (8.0 * parts.ram_stiffness_n_mm2)
    head: Array = parts.head_weight_n * reach**3 / (3.0 * parts.ram_stiffness_n_mm2)
    return own + head


def _bed(parts: CantileverStructure, x: Array, moment: Array) -> tuple[Array, Array, Array]:
    """Return the sag (mm), the pitch about Y (rad) and the roll about -X (rad) of the saddle. They arise because the
    bed yields between its supports."""
    half = 0.5 * parts.wheelbase_mm
    front, rear = (np.sin(np.pi * (x + arm) / parts.support_pitch_mm) ** 2 for arm in (half, -half))
    # The saddle rests on two trucks: it follows the mean of the sag under them and pitches with the difference.
    sag = 0.5 * parts.bed_sag_mm * (front + rear)
    pitch = parts.bed_sag_mm * (front - rear) / parts.wheelbase_mm
    roll = 0.5 * (front + rear) * parts.bed_roll_rad_per_n_mm * moment
    return sag, pitch, roll


def _column_rail_wave(parts: CantileverStructure, z: Array, moment: Array) -> Array:
    """Return the waviness in Y (mm) of the column rails between their screws. The waviness grows with the moment of the
    ram."""
    wave: Array = np.sin(2.0 * np.pi * z / parts.column_rail_pitch_mm) * (0.5 + moment / moment.max())
    return parts.column_rail_wave_mm * wave


def _cell(nodes: Array, positions: Array) -> tuple[NDArray[np.intp], Array]:
    """Return, for each position, the index of its grid cell and its location in the cell as a fraction (0 to 1) of the
    cell size."""
    inside = np.minimum(np.maximum(positions, nodes[0]), nodes[-1])
    cell = np.minimum(np.searchsorted(nodes, inside, side="right") - 1, nodes.size - 2)
    low = nodes[cell]
    return cell, (inside - low) / (nodes[cell + 1] - low)
