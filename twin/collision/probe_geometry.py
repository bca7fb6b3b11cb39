"""Geometry of the probe.

It has a separate module, because the settings import it and must not load numpy. The module of the collision bodies
loads numpy.
"""

from __future__ import annotations

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
