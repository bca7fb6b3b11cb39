"""Meaning of the quantities of a certificate for a ball artefact, by their `refType` or else by their name."""

from __future__ import annotations

import re
from collections.abc import Mapping
from enum import Enum
from typing import Final

from lxml import etree

from twin.formats.digital_certificate.xml_reading import DCC, child, contents


class Role(Enum):
    """Meaning of a quantity. The value is the last part of its `refType`, as in `volcal_ballCentres`.

    Centres are in the frame of the certificate, ball by ball as x, y, z, or each coordinate alone. Distances are those
    of the balls 1, 2, … from ball 0.
    """

    CENTRES = "ballCentres"
    CENTRE_X = "ballCentreX"
    CENTRE_Y = "ballCentreY"
    CENTRE_Z = "ballCentreZ"
    DISTANCES = "ballDistances"
    DIAMETER = "ballDiameter"
    EXPANSION = "thermalExpansionCoefficient"
    REFERENCE_TEMPERATURE = "referenceTemperature"


AXIS_ROLES: Final = (Role.CENTRE_X, Role.CENTRE_Y, Role.CENTRE_Z)

_NAMES: Final[Mapping[Role, tuple[str, ...]]] = {
    Role.CENTRES: ("ball centres", "ball centers", "coordinates of the ball centres", "kugelmittelpunkte"),
    Role.CENTRE_X: ("x", "x coordinate", "coordinate x", "x-koordinate", "koordinate x"),
    Role.CENTRE_Y: ("y", "y coordinate", "coordinate y", "y-koordinate", "koordinate y"),
    Role.CENTRE_Z: ("z", "z coordinate", "coordinate z", "z-koordinate", "koordinate z"),
    Role.DISTANCES: ("distances from ball 0", "distances from the first ball", "abstände von der ersten kugel"),
    Role.DIAMETER: ("ball diameter", "ball diameters", "diameter of the balls", "kugeldurchmesser"),
    Role.EXPANSION: (
        "coefficient of thermal expansion",
        "thermal expansion coefficient",
        "längenausdehnungskoeffizient",
        "thermischer längenausdehnungskoeffizient",
    ),
    Role.REFERENCE_TEMPERATURE: ("reference temperature", "bezugstemperatur", "referenztemperatur"),
}
_ROLE_OF_NAME: Final = {name: role for role, names in _NAMES.items() for name in names}
_ROLE_OF_TYPE: Final = {role.value: role for role in Role}


def role_of(quantity: etree._Element) -> Role | None:
    """Return the role of a `dcc:quantity`; None if neither its `refType` nor its name tells one."""
    for token in quantity.get("refType", "").split():
        role = _ROLE_OF_TYPE.get(token.rpartition("_")[2])
        if role is not None:
            return role
    for text in contents(child(quantity, DCC, "name")):
        role = _ROLE_OF_NAME.get(re.sub(r"\s+", " ", text).casefold())
        if role is not None:
            return role
    return None


_NOT_MEASURED: Final = ("nominalValue", "referenceValue", "measurementError")


def not_measured(quantity: etree._Element) -> str | None:
    """Return the `refType` that says that a `dcc:quantity` is not a measured value; None if there is none."""
    tokens = quantity.get("refType", "").split()
    return next((token for token in tokens if token.rpartition("_")[2] in _NOT_MEASURED), None)


def titles(element: etree._Element) -> tuple[str, ...]:
    """Return what an element may be called by: its names in all languages, its identity, and each `refType`."""
    names = [*contents(child(element, DCC, "name")), element.get("id", ""), *element.get("refType", "").split()]
    return tuple(dict.fromkeys(name for name in names if name))
