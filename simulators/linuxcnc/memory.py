"""File through which the process of the simulated plant and the servo thread of LinuxCNC share the simulated state.

The layout is that of `components/volcal_plant.h`. Every number in the file has 8 bytes and is little-endian.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import ConfigurationError
from twin.arrays import Array

MAGIC = 0x31746E616C507656
BALLS = 32
TRACE = 8192

_SCENE = np.dtype(
    [
        ("balls", "<f8"),
        ("seed", "<f8"),
        ("reach_mm", "<f8"),
        ("overtravel_mm", "<f8"),
        ("pretravel_mm", "<f8"),
        ("lobing_mm", "<f8"),
        ("touch_sigma_mm", "<f8"),
        ("repeatability_mm", "<f8"),
        ("backlash_mm", "<f8", 3),
        ("tool_mm", "<f8", 3),
        ("drift_mm", "<f8", 3),
        ("temperature_c", "<f8", 3),
        ("ball_mm", "<f8", (BALLS, 3)),
    ]
)
_HEAD = np.dtype(
    [
        ("magic", "<u8"),
        ("sequence", "<u8"),
        ("scene", _SCENE),
        ("traced", "<u8"),
        ("trace_mm", "<f8", (TRACE, 3)),
        ("nodes", "<u8", 3),
        ("origin_mm", "<f8", 3),
        ("step_mm", "<f8", 3),
    ]
)


@dataclass(frozen=True, eq=False)
class DeviationGrid:
    """Deviations of the tool centre point on a grid of uncorrected axis positions, in mm.

    The grid nodes are at `origin_mm + index * step_mm`. `deviation_mm` has shape (nx, ny, nz, 3): the numbers of nodes
    along x, y and z, and the three components of a deviation.
    """

    origin_mm: Array
    step_mm: Array
    deviation_mm: Array


@dataclass(frozen=True)
class ProbeBehaviour:
    """Parameters of the simulated probe and axes; `reach_mm` is the distance between tip and ball centre at contact."""

    seed: int
    reach_mm: float
    overtravel_mm: float
    pretravel_mm: float
    lobing_mm: float
    touch_sigma_mm: float
    repeatability_mm: float
    backlash_mm: tuple[float, float, float]
    tool_mm: tuple[float, float, float]


class PlantMemory:
    """Shared memory through which this process and the servo thread of LinuxCNC exchange the simulated state.

    Closing the object does not remove the file at `path` that holds the memory.
    """

    def __init__(self, path: Path, grid: DeviationGrid, nature: ProbeBehaviour) -> None:
        size = _HEAD.itemsize + grid.deviation_mm.size * 8
        with path.open("wb+") as file:
            file.truncate(size)
            self._map = mmap.mmap(file.fileno(), size)
        path.chmod(0o666)  # rtapi_app runs as another user
        self._head = np.frombuffer(self._map, _HEAD, 1)[0:1]
        self._scene = self._head["scene"]
        values = np.frombuffer(self._map, "<f8", grid.deviation_mm.size, _HEAD.itemsize)
        values[:] = grid.deviation_mm.ravel()
        self._head["nodes"] = grid.deviation_mm.shape[:3]
        self._head["origin_mm"], self._head["step_mm"] = grid.origin_mm, grid.step_mm
        for name, value in vars(nature).items():
            self._scene[name] = value
        self._head["magic"] = MAGIC
        self._read = 0

    def show(self, balls_mm: Array, *, drift_mm: tuple[float, float, float], temperatures_c: list[float]) -> None:
        """Publish to the servo thread of LinuxCNC the ball centres, the thermal drift of the tip, and the temperatures.

        `balls_mm` has shape (n_balls, 3) and is in the workpiece frame.
        """
        if len(balls_mm) > BALLS:
            raise ConfigurationError(f"{len(balls_mm)} balls; the plant holds at most {BALLS}", key="artefacts")
        self._head["sequence"] += 1
        self._scene["balls"] = len(balls_mm)
        self._scene["ball_mm"][0, : len(balls_mm)] = balls_mm
        self._scene["drift_mm"] = drift_mm
        self._scene["temperature_c"] = temperatures_c
        self._head["sequence"] += 1

    def read_trace(self) -> Array:
        """Return the positions of the stylus tip since the previous call, in mm and with shape (n_positions, 3).

        The first position is the last one of the previous call. If the memory has overflowed since that call, the
        oldest positions are missing.
        """
        written = int(self._head["traced"][0])
        first = max(self._read - 1, written - TRACE + 1, 0)
        self._read = written
        return np.array(self._head["trace_mm"][0][np.arange(first, written) % TRACE])
