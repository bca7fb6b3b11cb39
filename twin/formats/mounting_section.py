"""Sections of a machine file that describe its feet and its guides."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from twin.formats.toml_reading import StrictModel
from twin.machine.mounting import Foot, Guide, Mounting, require_distinct_feet

_LARGEST_MM = 1e5
_SHORTEST_MM = 1.0
Place = Annotated[float, Field(ge=-_LARGEST_MM, le=_LARGEST_MM)]
FootName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _-]{0,23}$")]


class GuideSection(StrictModel):
    """Section of a machine file for the guide of an axis, see `twin.machine.mounting.Guide`."""

    shoes_mm: Annotated[float, Field(ge=_SHORTEST_MM, le=_LARGEST_MM)]
    centre_mm: tuple[Place, Place, Place]

    @property
    def guide(self) -> Guide:
        return Guide(self.shoes_mm, self.centre_mm)


class FootSection(StrictModel):
    """Section of a machine file for a foot under the bed, see `twin.machine.mounting.Foot`."""

    name: FootName
    at_mm: tuple[Place, Place]


def mounting_of(guides: dict[str, GuideSection | None], feet: tuple[FootSection, ...]) -> Mounting:
    """Return the mounting that the sections state. Raises ModelError if the feet cannot twist a bed, or if two have the
    same name."""
    found = tuple(Foot(one.name, one.at_mm) for one in feet)
    require_distinct_feet(found)
    return Mounting({name: one.guide for name, one in guides.items() if one is not None}, found)
