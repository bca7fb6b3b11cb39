"""Machine as stated by a person, read from its controller or proposed from its class."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from agent.planning.new_machine.machine_class import MachineClass
from twin.collision.probe_frame import ProbeFrame
from twin.errors import DataError
from twin.machine.kinematic_chain import AXES, parse_chain

Limits = tuple[float, float]
Triple = tuple[float, float, float]
ThreeLimits = tuple[Limits, Limits, Limits]

STATED = "as stated"
PROPOSED = "proposed"
"""Origins of a value; others name their source."""

SHORTEST_TRAVEL_MM = 40.0
LONGEST_TRAVEL_MM = 20000.0
STEM_SHARE = 0.5
"""Length of the thin stem of the probe relative to the distance from the ram reference to the stylus centre."""
LONGEST_STEM_MM = 100.0
BODY_SHARE = 0.13
THICKEST_BODY_RADIUS_MM = 25.0
PROBE_FIELDS = {"tip_radius_mm": "tip_diameter", "stem_length_mm": "stem", "body_radius_mm": "probe_diameter"}
"""Name of the field in which each dimension of the probe is stated."""
WIDE_TIP_FROM_MM = 200.0
"""Stylus length from which a tip of 6 mm instead of 4 mm diameter is proposed."""


@dataclass(frozen=True)
class MachineSetup:
    """Machine with three linear axes and a probe in its spindle.

    `limits_mm` are the lowest and highest axis position of X, Y and Z. `stylus_mm` is the distance from the ram
    reference to the stylus centre along `spindle`. `origins` maps the name of a field to the origin of its value, for
    the comments of the machine file. `stated_probe` are the dimensions of the probe that a person stated.
    """

    name: str
    kind: MachineClass
    limits_mm: ThreeLimits
    spindle: ProbeFrame
    chain: str
    stylus_mm: float
    rapid_mm_per_min: Triple
    feed_mm_per_min: Triple
    acceleration_mm_per_s2: Triple
    origins: Mapping[str, str] = field(default_factory=dict)
    stated_probe: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        parse_chain(self.chain)
        for letter, (low, high) in zip(AXES, self.limits_mm, strict=True):
            check_travel(letter, low, high)
        if not self.stylus_mm > 0.0:
            raise DataError(f"the stylus length must be positive, got {self.stylus_mm:g}", key="stylus")
        for key, field_name in PROBE_FIELDS.items():
            if not self.probe[key] > 0.0:
                raise DataError(f"{key} must be positive, got {self.probe[key]:g}", key=field_name)
        length = self.probe["stem_length_mm"] + 2.0 * self.probe["body_radius_mm"]
        if length > self.stylus_mm:
            raise DataError(
                f"the stem and the body of the probe need {length:g} mm, the stylus centre is {self.stylus_mm:g} mm "
                "from the ram reference",
                hint="state a longer distance from the ram reference, or a smaller probe",
                key=next((PROBE_FIELDS[key] for key in self.stated_probe if key in PROBE_FIELDS), "stylus"),
            )

    @property
    def travel_mm(self) -> Triple:
        """Lengths of the travels of X, Y and Z in mm."""
        return lengths_of(self.limits_mm)

    @property
    def tool_offset_mm(self) -> Triple:
        x, y, z = (self.stylus_mm * self.spindle.stylus_axis).tolist()
        return x, y, z

    def stylus_range(self, axis: int) -> Limits:
        """Return the lowest and highest position of the stylus centre along an axis, in the workpiece frame, in mm."""
        low, high = self.limits_mm[axis]
        offset = self.tool_offset_mm[axis]
        return low + offset, high + offset

    @property
    def probe(self) -> dict[str, float]:
        """Dimensions in mm of the section `[probe]`: a thin stem, the probe body, and the ram behind it, proposed where
        not stated."""
        return {
            "tip_radius_mm": 2.0 if self.stylus_mm < WIDE_TIP_FROM_MM else 3.0,
            "stem_length_mm": _rounded(min(LONGEST_STEM_MM, STEM_SHARE * self.stylus_mm)),
            "body_radius_mm": _rounded(min(THICKEST_BODY_RADIUS_MM, BODY_SHARE * self.stylus_mm)),
            "reach_mm": self.stylus_mm,
            "ram_half_width_mm": self.kind.ram_half_width_mm,
            "ram_length_mm": _rounded(self.travel_mm[self.spindle.axis] + 100.0),
            **self.stated_probe,
        }


def lengths_of(limits_mm: ThreeLimits) -> Triple:
    """Return the lengths of three travels."""
    x, y, z = (high - low for low, high in limits_mm)
    return x, y, z


def check_travel(axis: str, low: float, high: float) -> None:
    """Raise DataError if the range of an axis position is not the travel of a machine tool in mm."""
    if not SHORTEST_TRAVEL_MM <= high - low <= LONGEST_TRAVEL_MM:
        raise DataError(
            f"{axis} from {low:g} to {high:g} mm is not a travel between {SHORTEST_TRAVEL_MM:g} and "
            f"{LONGEST_TRAVEL_MM:g} mm",
            hint="state lengths in mm, or LOWEST:HIGHEST axis position",
            key="travel",
        )


def _rounded(value: float) -> float:
    return float(round(value))
