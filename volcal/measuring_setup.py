"""Description of a measuring set-up: a machine and an artefact at its stations, before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from twin.arrays import Array, as_points
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position, parse_position_set
from twin.artefact.touch_pattern import approach_directions, centre_covariance
from twin.collision.measuring_layout import MeasuringLayout
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry
from twin.design.procedure import Procedure
from twin.display import Displayed
from twin.errors import DataError
from twin.machine.machine_description import MachineDescription
from volcal.files import read_artefact, read_machine, shipped_file

CASE_STUDY_STATIONS_MM = (
    (700.0, 1000.0, 750.0),
    (1567.0, 1000.0, 750.0),
    (2433.0, 1000.0, 750.0),
    (3300.0, 1000.0, 750.0),
)


@dataclass(frozen=True, eq=False)
class MeasuringSetup(Displayed):
    """Set-up of a machine and an artefact on a mount at several stations. Each ball is touched five times.

    `stations_mm`, shape (S, 3), contains one point for each of S stations, starting with station 1. It is the point
    where the azimuth axis and the elevation axis of the mount meet, in the workpiece frame. `tool` is the name of the
    tool used for measuring; None means the first tool of the machine. `touch_sigma_um` is the standard
    deviation of the noise of one touch, in µm. `clearance_mm` is the distance to the ends of travel that a touch needs
    in addition to the radii of ball and tip. Raises DataError or ModelError if a value is invalid.

    >>> setup = volcal.case_study()
    >>> setup.machine.name, setup.artefact.count, len(setup.stations_mm)
    ('case-study', 11, 4)
    >>> len(setup.position_set("S3"))
    24
    """

    machine: MachineDescription
    artefact: Artefact
    stations_mm: Array
    tool: str | None = None
    touch_sigma_um: float = 1.1
    clearance_mm: float = 8.0
    mount: MountGeometry = field(default_factory=MountGeometry)
    probe: ProbeGeometry = field(default_factory=ProbeGeometry)

    def __repr__(self) -> str:
        return (
            f"<MeasuringSetup: machine {self.machine.name!r}, artefact {self.artefact.name!r}, "
            f"{len(self.stations_mm)} stations>"
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "stations_mm", as_points(self.stations_mm, "stations"))
        self.machine.tool(self.tool_name)
        for name in ("touch_sigma_um", "clearance_mm"):
            if not getattr(self, name) > 0.0:
                raise DataError(f"{name} must be positive, not {getattr(self, name):g}", key=name)

    @property
    def tool_name(self) -> str:
        """Name of the tool used for measuring."""
        return self.tool or next(iter(self.machine.tools))

    @property
    def tool_offset_mm(self) -> Array:
        """Offset of the tool used for measuring (from the reference point of the ram to the stylus centre), in mm,
        shape (3,).
        """
        return np.asarray(self.machine.tool(self.tool_name), dtype=np.float64)

    def position_set(self, name: str) -> tuple[Position, ...]:
        """Return the artefact positions of the named set `S1`, `S2` or `S3`, or of a union such as `S1+S3`, at all
        stations.

        A ball bar lies along the axes (`S1`), along space diagonals (`S2`) or along the face diagonals of the planes
        XY, ZX and YZ (`S3`). Its holders face a horizontal stylus.

        Raises TwinError if the name is unknown.
        """
        return parse_position_set(name, len(self.stations_mm), ProbeFrame.nearest(self.tool_offset_mm).facing_deg)

    @cached_property
    def procedure(self) -> Procedure:
        """Measuring procedure of the set-up in the form that the package `twin.design` uses.

        It contains the geometric layout of the measurement with the tool, and the covariance of one measured ball
        centre.
        """
        room_mm = self.artefact.ball_radius_mm + self.probe.tip_radius_mm + self.clearance_mm
        travel = np.array(self.machine.limits)
        layout = MeasuringLayout(
            artefact=self.artefact,
            mount=self.mount,
            probe=self.probe,
            locations_mm=dict(enumerate(self.stations_mm, start=1)),
            tool_offset_mm=self.tool_offset_mm,
            lower_mm=travel[:, 0] + room_mm,
            upper_mm=travel[:, 1] - room_mm,
            contact_mm=self.artefact.ball_radius_mm + self.probe.tip_radius_mm,
            approach_mm=self.clearance_mm,
        )
        covariance_mm2 = centre_covariance(approach_directions(5, layout.frame.stylus_axis), 1e-3 * self.touch_sigma_um)
        return Procedure({self.tool_name: layout}, covariance_mm2)

    def at(self, stations_mm: ArrayLike) -> MeasuringSetup:
        """Return a copy of this set-up with the artefact's mount at S other stations, given by `stations_mm`, shape (S,
        3), in mm.
        """
        return replace(self, stations_mm=as_points(stations_mm, "stations"))


def case_study() -> MeasuringSetup:
    """Return the measuring set-up of the case study that is shipped with volcal.

    The machine is a moving-column milling machine. The artefact is a 1500 mm ball bar, which is measured at four
    stations along X.

    >>> volcal.case_study().machine.model.ranges_mm
    ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
    """
    return MeasuringSetup(
        machine=read_machine(shipped_file("machines/case-study.toml")),
        artefact=read_artefact(shipped_file("artefacts/ball-bar-1500.toml")),
        stations_mm=np.array(CASE_STUDY_STATIONS_MM),
        tool="probe",
    )
