"""Errors of the motor positions that remain after compensation in a stock LinuxCNC, run without a realtime kernel.

The compensation is applied in two ways: by external offsets, and by the kinematics component of this project.

    .venv/bin/python benchmarks/linuxcnc_compensation.py

The benchmark needs root, linuxcnc-uspace and linuxcnc-uspace-dev. The compensation table has 11 × 6 × 5 nodes with
corrections up to 24 µm over 800 × 400 × 320 mm, and the servo period is 1 ms. The motor positions are recorded with the
sampler component of HAL (LinuxCNC's hardware abstraction layer). The expected corrections are computed from the table
by independent arithmetic.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "linuxcnc"))

from compensation_rig import Controller, compile_components, machine, running, smooth_table, trilinear

from drivers.clock import RealClock
from drivers.linuxcnc.compensation import CompensationSettings, LinuxCncStore, create_store
from drivers.roles import TableImage

TABLE = smooth_table(1)
START_MM, END_MM = np.array([0.5, 399.0, 5.0]), np.array([760.0, 40.0, 280.0])
COMPONENT = {"external-offsets": "volcal-eoffset", "kinematics": "volcal-kins"}


def at_rest_mm(controller: Controller) -> float:
    """Return the largest difference in mm between the actual and the expected motor position, at 30 random positions at
    rest.

    The expected motor position is the displayed axis position plus the correction of the compensation table.
    """
    worst = 0.0
    for place in np.random.default_rng(7).uniform([-50, -50, -50], [799, 399, 319], (30, 3)):
        controller.at(*place)
        controller("mdi", "G4 P0.05")
        expected = trilinear(TABLE, controller.displayed()[None])[0]
        worst = max(worst, float(np.abs(controller.motor() - controller.displayed() - expected).max()))
    return worst


def in_motion_mm(controller: Controller, feed_mm_per_min: int) -> float:
    """Return the largest distance in mm of the motor path from the programmed line.

    The correction of the compensation table is subtracted from the motor path first.
    """
    controller.at(*START_MM)
    controller("mdi", "G4 P0.1")
    x, y, z = END_MM
    controller.start_sampling()
    controller("mdi", f"G53 G1 F{feed_mm_per_min} X{x} Y{y} Z{z}")
    motor = controller.samples()[:, :3]
    nominal = motor.copy()
    # Invert motor = nominal + table(nominal) by fixed-point iteration.
    for _ in range(8):
        nominal = motor - trilinear(TABLE, nominal)
    return float(off_line(nominal).max())


def off_line(points: NDArray[np.float64]) -> NDArray[np.float64]:
    along = (END_MM - START_MM) / np.linalg.norm(END_MM - START_MM)
    away = points - START_MM
    return np.asarray(np.linalg.norm(away - (away @ along)[:, None] * along, axis=1))


def largest_table_s(store: LinuxCncStore) -> float:
    """Return the time in s that is needed to write, load and read back a compensation table of 262,144 nodes, the
    largest in this benchmark.
    """
    counts = np.random.default_rng(3).integers(-200, 200, (64, 64, 64, 3)).astype(np.int32)
    begun = time.perf_counter()
    store.stage(2, TableImage((0.0, 0.0, 0.0), (12.0, 6.0, 5.0), 1e-4, counts))
    return time.perf_counter() - begun


def measure(way: str, controller: Controller, store: LinuxCncStore) -> None:
    controller.ready()
    store.stage(1, TABLE)
    begun = time.perf_counter()
    store.activate(1)
    switched_s = time.perf_counter() - begun
    rest, fast, slow = at_rest_mm(controller), in_motion_mm(controller, 30000), in_motion_mm(controller, 6000)
    print(f"{way}: at rest {rest:.1e} mm; in motion {fast:.1e} mm at 30 m/min, {slow:.1e} mm at 6 m/min")
    print(f"  activation {switched_s:.2f} s, a table of 262,144 nodes staged in {largest_table_s(store):.2f} s")
    print(f"  longest run of the function {controller.get(COMPONENT[way] + '.tmax')} clock cycles of the processor")


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        build = compile_components(Path(folder) / "build")
        for way in COMPONENT:
            work = machine(Path(folder) / way, build, way)
            settings = CompensationSettings.model_validate({"method": way, "directory": work / "tables"})
            with running(work) as controller:
                measure(
                    way, controller, create_store(settings, controller, RealClock(), base_path=work, device="linuxcnc")
                )


if __name__ == "__main__":
    main()
