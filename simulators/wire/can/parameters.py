"""Parameters of a simulated drive outside its state machine, with their power-on values, as listed in CiA 402.

Most parameters are only stored. The factor group (objects 0x608F, 0x6091 and 0x6092, which define the position unit)
and the polarity (0x607E) take effect. A position is increments * feed / (encoder resolution * gear ratio). Bit 7 of the
polarity reverses the sign of the position.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from simulators.wire.can.sdo import ABORT_VALUE, ObjectDictionary, ObjectEntry, SdoAbortError

Key = tuple[int, int]

RESOLUTION, RESOLUTION_TURNS = (0x608F, 1), (0x608F, 2)
GEAR, GEAR_TURNS = (0x6091, 1), (0x6091, 2)
FEED, FEED_TURNS = (0x6092, 1), (0x6092, 2)
POLARITY = (0x607E, 0)
LOWER_LIMIT, UPPER_LIMIT = (0x607D, 1), (0x607D, 2)
HOMING_METHOD, HOMING_SPEED = (0x6098, 0), (0x6099, 1)
QUICK_STOP_OPTION = (0x605A, 0)
REVERSED_POSITION = 0x80

_ALWAYS: dict[Key, tuple[str, int]] = {
    QUICK_STOP_OPTION: ("h", 2),  # ramp down, then switch on disabled
    (0x6083, 0): ("I", 0),
    (0x6084, 0): ("I", 0),
    (0x6085, 0): ("I", 0),
    LOWER_LIMIT: ("i", 0),  # both zero: no limits
    UPPER_LIMIT: ("i", 0),
    HOMING_METHOD: ("b", 0),
    HOMING_SPEED: ("I", 0),
    (0x6099, 2): ("I", 0),
    (0x609A, 0): ("I", 0),
}


@dataclass(frozen=True)
class FactorGroup:
    """Power-on values of the objects that define the position unit of a drive.

    `resolution`, `gear` and `feed` are the pairs of values in objects 0x608F, 0x6091 and 0x6092. `polarity` is object
    0x607E. `unit_codes` are the codes of SI units in objects 0x60A8 and 0x60A9.
    """

    resolution: tuple[int, int]
    gear: tuple[int, int]
    feed: tuple[int, int]
    polarity: int = 0
    unit_codes: tuple[int, int] = (0, 0)

    @classmethod
    def in_increments(cls, increments: int, gear: int) -> FactorGroup:
        """Return a factor group with which the position unit is one encoder increment."""
        return cls((increments, 1), (gear, 1), (increments * gear, 1))

    def entries(self) -> dict[Key, tuple[str, int]]:
        pairs = {0x608F: self.resolution, 0x6091: self.gear, 0x6092: self.feed}
        entries = {(index, place): ("I", pair[place - 1]) for index, pair in pairs.items() for place in (1, 2)}
        codes = dict(zip(((0x60A8, 0), (0x60A9, 0)), (("I", code) for code in self.unit_codes), strict=True))
        return {**entries, **codes, POLARITY: ("B", self.polarity)}


class Parameters:
    """Values of a drive's parameters by index and sub-index.

    If the drive has no factor group (the objects that define the position unit), its position unit is the encoder
    increment.
    """

    def __init__(self, factors: FactorGroup | None) -> None:
        self._defaults = {**_ALWAYS, **(factors.entries() if factors is not None else {})}
        self._has_factors = factors is not None
        self._values: dict[Key, int] = {}
        self.reset()

    def reset(self) -> None:
        """Restore the power-on values."""
        self._values = {key: value for key, (_, value) in self._defaults.items()}

    def __getitem__(self, key: Key) -> int:
        return self._values[key]

    def __setitem__(self, key: Key, value: int) -> None:
        """Set a value directly, not over the bus, as the manufacturer's own tool does."""
        self._values[key] = value

    @property
    def units_per_increment(self) -> float:
        """Number of position units per encoder increment. It is negative if the polarity is reversed."""
        if not self._has_factors:
            return 1.0
        resolution = self[RESOLUTION] / self[RESOLUTION_TURNS]
        gear = self[GEAR] / self[GEAR_TURNS]
        feed = self[FEED] / self[FEED_TURNS]
        return (-1.0 if self[POLARITY] & REVERSED_POSITION else 1.0) * feed / (resolution * gear)

    def within_limits(self, position: int) -> int:
        """Return `position` clipped to the drive's software limits, or unchanged if no limits are set."""
        lower, upper = self[LOWER_LIMIT], self[UPPER_LIMIT]
        return min(max(position, lower), upper) if lower < upper else position

    def dictionary(self) -> ObjectDictionary:
        entries = {
            key: ObjectEntry(code, partial(self._values_of, key), partial(self._write, key))
            for key, (code, _) in self._defaults.items()
        }
        for index in {index for index, subindex in self._defaults if subindex}:
            entries[index, 0] = ObjectEntry("B", lambda: 2)
        return entries

    def _values_of(self, key: Key) -> int:
        return self._values[key]

    def _write(self, key: Key, value: int) -> None:
        if key[0] in (0x608F, 0x6091, 0x6092) and value == 0:
            raise SdoAbortError(ABORT_VALUE)
        self._values[key] = value
