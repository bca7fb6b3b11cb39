"""Geometry of the probe.

It has a separate module, because the settings import it and must not load numpy. The module of the collision bodies
loads numpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twin.errors import DataError

if TYPE_CHECKING:
    from twin.collision.bodies import Body
    from twin.collision.probe_frame import ProbeFrame


@dataclass(frozen=True)
class ProbeGeometry:
    """Dimensions of the probe and the ram in mm. Lengths are measured along the tool axis from the tip centre back to
    the ram face.

    `reach_mm` is the total length, which is at most the length of the tool offset. The probe body fills the whole
    length between the stem and the ram face. The ram is square.
    """

    tip_radius_mm: float = 3.0
    stem_radius_mm: float = 1.5
    stem_length_mm: float = 100.0
    body_radius_mm: float = 25.0
    reach_mm: float = 250.0
    ram_half_width_mm: float = 80.0
    ram_length_mm: float = 1600.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0.0:
                raise DataError(f"{name} must be positive, got {value}", key=f"probe.{name}")
        if self.reach_mm < self.stem_length_mm + 2.0 * self.body_radius_mm:
            raise DataError(
                f"reach_mm {self.reach_mm} is too short for the stem and the body of the probe",
                hint="reach_mm >= stem_length_mm + 2 * body_radius_mm",
                key="probe.reach_mm",
            )

    def bodies(self, frame: ProbeFrame) -> tuple[Body, ...]:
        """Return the tip, the stem, the probe body and the ram as collision bodies in the workpiece frame, relative to
        the tip centre. `frame` gives the direction in which the stylus points.
        """
        from twin.collision.bodies import TIP, Body  # noqa: PLC0415
        from twin.collision.geometry import Box, Capsule, sphere  # noqa: PLC0415

        stem_end, ram_face, half = -self.stem_length_mm, -self.reach_mm, self.ram_half_width_mm
        body_front, body_back = stem_end - self.body_radius_mm, ram_face + self.body_radius_mm
        along_y = (
            Body(TIP, sphere((0.0, 0.0, 0.0), self.tip_radius_mm)),
            Body("stem", Capsule((0.0, 0.0, 0.0), (0.0, stem_end, 0.0), self.stem_radius_mm)),
            Body("probe body", Capsule((0.0, body_front, 0.0), (0.0, body_back, 0.0), self.body_radius_mm)),
            Body("ram", Box((-half, ram_face - self.ram_length_mm, -half), (half, ram_face, half))),
        )
        return tuple(Body(body.name, frame.shape_in_workpiece(body.shape)) for body in along_y)


@dataclass(frozen=True)
class ProbeSection:
    """Section `[probe]` of a settings file or a scenario: the dimensions of `ProbeGeometry` in mm, two of which follow
    from the tool if they are None.

    `reach_mm` is then the length of the tool offset along the stylus, so the ram ends at the reference point of the
    tool. `stem_length_mm` is then 100 mm or, for a short tool, the length that two radii of the probe body leave.
    """

    tip_radius_mm: float = ProbeGeometry.tip_radius_mm
    stem_radius_mm: float = ProbeGeometry.stem_radius_mm
    stem_length_mm: float | None = None
    body_radius_mm: float = ProbeGeometry.body_radius_mm
    reach_mm: float | None = None
    ram_half_width_mm: float = ProbeGeometry.ram_half_width_mm
    ram_length_mm: float = ProbeGeometry.ram_length_mm

    def __post_init__(self) -> None:
        self.geometry(math.inf)

    def geometry(self, tool_length_mm: float) -> ProbeGeometry:
        """Return the geometry of the probe for a tool offset of `tool_length_mm` along the stylus.

        Raises DataError if a dimension is not positive or the probe is too short for its parts.
        """
        reach_mm = tool_length_mm if self.reach_mm is None else self.reach_mm
        stem_mm = self.stem_length_mm
        if stem_mm is None:
            stem_mm = min(ProbeGeometry.stem_length_mm, reach_mm - 2.0 * self.body_radius_mm)
            if stem_mm <= 0.0:
                raise DataError(
                    f"a reach of {reach_mm:g} mm is too short for the body of the probe",
                    hint=f"it must be longer than 2 * body_radius_mm, {2.0 * self.body_radius_mm:g} mm; by default it "
                    "is the length of the tool offset along the stylus",
                    key="probe.reach_mm",
                )
        return ProbeGeometry(**{**vars(self), "reach_mm": reach_mm, "stem_length_mm": stem_mm})
