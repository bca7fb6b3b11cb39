"""Measurements of a run, one per measured ball. A measurement gives the axis positions at which the stylus centre
coincides with a ball centre.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array
from twin.errors import DataError


@dataclass(frozen=True, eq=False)
class Observations:
    """Measured ball centres, with one ball centre in each of n rows.

    - `position` (n,) is the number of the artefact's position, counted from 0. The artefact has one pose per position.
    - `ball` (n,) is an index into the artefact's list of balls.
    - `tool` (n,) is an index into `tool_offsets` (T, 3), the offsets of T tools in mm.
    - `axis_positions` (n, 3) contains machine coordinates in mm, without tool offset.
    - `covariance` (n, 3, 3) is the covariance of each fitted centre in mm².
    - `temperature_c` (n,) is the temperature of the artefact.
    - `elevation_rad` (n,) is the elevation of the mount.
    - `thermal_regressors` (n, w) contains w thermal regressors in K. Each is a temperature change of the machine from
      the start of the run to the measurement of the row. If the machine is assumed not to drift, w is 0.
    - `azimuth_rad` (n,) is the azimuth of the mount, or None if it is not known. It serves only as the roll of a
      straight artefact whose roll the measurements do not show.

    Raises DataError if a value cannot be used. The error names the row, counted from 0.
    """

    position: np.ndarray[Any, np.dtype[np.int64]]
    ball: np.ndarray[Any, np.dtype[np.int64]]
    tool: np.ndarray[Any, np.dtype[np.int64]]
    axis_positions: Array
    covariance: Array
    temperature_c: Array
    elevation_rad: Array
    tool_offsets: Array
    thermal_regressors: Array = field(default_factory=lambda: np.zeros((0, 0)))
    azimuth_rad: Array | None = None

    def __post_init__(self) -> None:
        for name in ("position", "ball", "tool"):
            object.__setattr__(self, name, _whole_numbers(name, getattr(self, name)))
        for name in ("axis_positions", "covariance", "temperature_c", "elevation_rad", "tool_offsets"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        course = np.array(self.thermal_regressors, dtype=np.float64)
        object.__setattr__(self, "thermal_regressors", course if course.size else np.zeros((len(self.ball), 0)))
        if self.azimuth_rad is not None:
            object.__setattr__(self, "azimuth_rad", np.array(self.azimuth_rad, dtype=np.float64))
        self._check_shapes()
        self._check_values()
        self._check_covariance()
        self._check_duplicates()
        for one in fields(self):
            if getattr(self, one.name) is not None:
                # A later change of a value would escape these checks.
                getattr(self, one.name).setflags(write=False)

    @property
    def size(self) -> int:
        return len(self.ball)

    @property
    def used_tool_offsets(self) -> Array:
        """Offsets in mm of the tools with which at least one ball was measured, with one row (3,) per tool."""
        return np.asarray(self.tool_offsets[np.unique(self.tool)])

    @property
    def coordinate_variances_mm2(self) -> Array:
        """Stated variance (n,) in mm² of one coordinate of each ball centre, as a mean over the three directions."""
        return np.asarray(np.einsum("nii->n", self.covariance) / 3.0)

    @property
    def coordinate_variance_mm2(self) -> float:
        """Stated variance in mm² of one coordinate of a ball centre, as a mean over all rows and directions."""
        return float(self.coordinate_variances_mm2.mean())

    def select(self, mask: np.ndarray[Any, Any]) -> Observations:
        """Return the rows selected by `mask`, a boolean array (n,) or an array of row indices."""
        rows = {
            f.name: getattr(self, f.name)[mask] for f in fields(self) if f.name not in ("tool_offsets", "azimuth_rad")
        }
        azimuth_rad = None if self.azimuth_rad is None else self.azimuth_rad[mask]
        return Observations(**rows, tool_offsets=self.tool_offsets, azimuth_rad=azimuth_rad)

    def _check_shapes(self) -> None:
        n = len(self.ball)
        expected = {
            "position": (n,),
            "tool": (n,),
            "axis_positions": (n, 3),
            "covariance": (n, 3, 3),
            "temperature_c": (n,),
            "elevation_rad": (n,),
        }
        if self.azimuth_rad is not None:
            expected["azimuth_rad"] = (n,)
        for name, shape in expected.items():
            found = getattr(self, name).shape
            if found != shape:
                raise DataError(f"{name} has the shape {found}, expected {shape}", column=name)
        if self.thermal_regressors.ndim != 2 or len(self.thermal_regressors) != n:
            raise DataError(
                f"thermal_regressors has the shape {self.thermal_regressors.shape}, expected ({n}, w)",
                column="thermal_regressors",
            )
        if self.tool_offsets.ndim != 2 or self.tool_offsets.shape[1] != 3:
            raise DataError(f"tool_offsets has the shape {self.tool_offsets.shape}, expected (T, 3)")
        if n == 0:
            raise DataError("no ball centre given", hint="measure at least two positions")

    def _check_values(self) -> None:
        names = ["axis_positions", "covariance", "temperature_c", "elevation_rad", "thermal_regressors"]
        if self.azimuth_rad is not None:
            names.append("azimuth_rad")
        for name in names:
            finite = np.isfinite(getattr(self, name)).reshape(self.size, -1).all(axis=1)
            _refuse_rows(~finite, f"{name} is not a finite number", name)
        if not np.isfinite(self.tool_offsets).all():
            raise DataError("a tool offset is not a finite number")
        for name in ("position", "ball"):
            _refuse_rows(getattr(self, name) < 0, f"{name} is negative", name)
        unknown = (self.tool < 0) | (self.tool >= len(self.tool_offsets))
        _refuse_rows(unknown, f"unknown tool; there are {len(self.tool_offsets)} tool offsets", "tool")

    def _check_covariance(self) -> None:
        asymmetry = np.abs(self.covariance - self.covariance.transpose(0, 2, 1)).max(axis=(1, 2))
        scale = np.abs(self.covariance).max(axis=(1, 2))
        _refuse_rows(asymmetry > 1e-9 * scale, "the covariance is not symmetric", "covariance")
        _refuse_rows(~_positive_definite(self.covariance), "the covariance is not positive definite", "covariance")

    def _check_duplicates(self) -> None:
        seen: dict[tuple[object, ...], int] = {}
        # a ball measured again in another thermal state is a new measurement, not a duplicate
        thermal_states = map(tuple, self.thermal_regressors.tolist())
        keys = zip(self.position.tolist(), self.tool.tolist(), self.ball.tolist(), thermal_states, strict=True)
        for row, key in enumerate(keys):
            first = seen.setdefault(key, row)
            if first != row:
                raise DataError(
                    f"ball {key[2]} of position {key[0]} was already given in row {first}",
                    row=row,
                    hint="keep one centre per position, tool and ball (with thermal drift: and per instant)",
                )


def _whole_numbers(name: str, values: ArrayLike) -> np.ndarray[Any, np.dtype[np.int64]]:
    given = np.asarray(values)
    if given.ndim != 1 or not (np.issubdtype(given.dtype, np.integer) or given.size == 0):
        raise DataError(f"{name} must be a list of whole numbers", column=name)
    return given.astype(np.int64)


def _positive_definite(covariance: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Return (n,) bool: True for each positive definite covariance matrix.

    The criterion is that all leading minors of the correlation matrix are positive (Sylvester).
    """
    diagonal = np.einsum("nii->ni", covariance)
    positive = (diagonal > 0.0).all(axis=1)
    deviation = np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    c = covariance / (deviation[:, :, None] * deviation[:, None, :])
    a, b, d = c[:, 0, 1], c[:, 0, 2], c[:, 1, 2]
    # determinant of a correlation matrix with the off-diagonal elements a, b, d
    determinant = 1.0 + 2.0 * a * b * d - a * a - b * b - d * d
    return np.asarray(positive & (a * a < 1.0) & (determinant > 1e-12))


def _refuse_rows(bad: np.ndarray[Any, Any], message: str, column: str) -> None:
    if bad.any():
        raise DataError(message, row=int(np.argmax(bad)), column=column)
