"""Random walk of a machine from night to night that the settings expect."""

from __future__ import annotations

import numpy as np

from agent.settings.schema import NightlySettings
from twin.arrays import Array
from twin.identification import process_noise
from twin.machine.machine_description import MachineDescription
from twin.units import MM_PER_UM

SCALES = ("EXX[1]", "EYY[1]", "EZZ[1]")


def expected_walk(machine: MachineDescription, tool_offset_mm: Array, nightly: NightlySettings) -> Array:
    """Return the standard deviation of the change of each of the p parameters of the machine in one night (24 h), as an
    array (p,) in mm or rad."""
    noise = process_noise(machine.family, MM_PER_UM * nightly.drift_um, tool_offset_mm)
    for name, (low, high) in zip(SCALES, machine.model.ranges_mm, strict=True):
        index = machine.model.names.index(name)
        # The coefficient of degree 1 is half the change of length over the axis range: 1 µm/m is 0.5e-6 of the range.
        noise[index] = np.hypot(noise[index], 0.5e-6 * nightly.scale_drift_um_per_m * (high - low))
    return noise
