"""Classes of machines, with the typical values of each class for what a person did not state."""

from __future__ import annotations

from dataclasses import dataclass

from twin.collision.probe_frame import VERTICAL, ProbeFrame
from twin.machine.kinematic_chain import AXES


@dataclass(frozen=True)
class MachineClass:
    """Class of machines and its typical values.

    `spindle` is the usual spindle direction and `moving_table` is True if the workpiece moves along at least one axis.
    `tolerance_share` is the amplitude of the errors as a multiple of the tolerances of an acceptance test.
    `cross_effect` is True if a ram that extends bends the machine, which the error model then describes.
    `stylus_mm` is the distance from the ram reference to the stylus centre, `ram_half_width_mm` half the width of the
    ram, quill or spindle nose behind the probe.
    """

    name: str
    description: str
    spindle: str
    moving_table: bool
    tolerance_share: float
    cross_effect: bool
    stylus_mm: float
    ram_half_width_mm: float
    rapid_mm_per_min: float
    feed_mm_per_min: float
    acceleration_mm_per_s2: float

    def chain(self, spindle: ProbeFrame, travel_mm: tuple[float, float, float]) -> str:
        """Return the usual kinematic chain of a machine of this class, from the tool to the workpiece, for a spindle
        direction and travels of X, Y and Z in mm."""
        sides = sorted(spindle.horizontal_across, key=lambda axis: travel_mm[axis])
        order = [spindle.axis, *((VERTICAL,) if not spindle.is_vertical else ()), *sides]
        letters = [AXES[axis] for axis in order]
        if not self.moving_table:
            return "-".join(("tool", *letters, "bed", "workpiece"))
        moved = 2 if spindle.is_vertical else 1
        return "-".join(("tool", *letters[: 3 - moved], "bed", *letters[3 - moved :], "workpiece"))


MACHINE_CLASSES = {
    kind.name: kind
    for kind in (
        MachineClass(
            name="mill",
            description="machining centre or milling machine whose table moves",
            spindle="-Z",
            moving_table=True,
            tolerance_share=0.5,
            cross_effect=False,
            stylus_mm=150.0,
            ram_half_width_mm=50.0,
            rapid_mm_per_min=20000.0,
            feed_mm_per_min=3000.0,
            acceleration_mm_per_s2=2000.0,
        ),
        MachineClass(
            name="router",
            description="light gantry machine with a fixed table, as driven by GRBL or LinuxCNC",
            spindle="-Z",
            moving_table=False,
            tolerance_share=3.0,
            cross_effect=False,
            stylus_mm=100.0,
            ram_half_width_mm=45.0,
            rapid_mm_per_min=6000.0,
            feed_mm_per_min=2000.0,
            acceleration_mm_per_s2=400.0,
        ),
        MachineClass(
            name="portal",
            description="portal or bridge machine with a fixed table",
            spindle="-Z",
            moving_table=False,
            tolerance_share=0.5,
            cross_effect=False,
            stylus_mm=250.0,
            ram_half_width_mm=100.0,
            rapid_mm_per_min=15000.0,
            feed_mm_per_min=3000.0,
            acceleration_mm_per_s2=500.0,
        ),
        MachineClass(
            name="large-ram",
            description="moving-column machine with a horizontal ram",
            spindle="+Y",
            moving_table=False,
            tolerance_share=0.5,
            cross_effect=True,
            stylus_mm=250.0,
            ram_half_width_mm=80.0,
            rapid_mm_per_min=20000.0,
            feed_mm_per_min=3000.0,
            acceleration_mm_per_s2=500.0,
        ),
    )
}
"""Machine classes by name."""
