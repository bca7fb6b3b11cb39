"""Standard uncertainty of the artefact's temperature if no uncertainty is stated.

The values are large on purpose: a thermometer without a calibration must not decide on the scales of a machine. A steel
bar of 1 m changes by 11.5 µm per kelvin.
"""

from __future__ import annotations

ASSUMED_IF_READ_K = 1.0
"""Standard uncertainty in K of a temperature that was read on the artefact, by a thermometer without a statement.

Class B platinum sensors and class 2 thermocouples may be wrong by 0.4 to 2.5 K (IEC 60751, IEC 60584-1), and a sensor
on a surface reads a temperature between those of the surface and the air. An error of 2 K is twice this uncertainty.
"""

ASSUMED_IF_NOT_READ_K = 3.0
"""Standard uncertainty in K of an artefact whose temperature was not read and therefore counts as 20 °C.

Workshops are between 15 and 25 °C; a rectangular distribution of this width has a standard deviation of 2.9 K.
"""


def assumed_uncertainty_k(was_read: bool) -> float:
    """Return the standard uncertainty in K of the artefact's temperature if none is stated."""
    return ASSUMED_IF_READ_K if was_read else ASSUMED_IF_NOT_READ_K
