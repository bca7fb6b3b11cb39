"""Readings of an instrument beside the ball centres, with everything that is uncertain about them.

A reading y of an instrument at axis positions X is linear in the errors of the machine:

    y = n · d(X) + r · ω(X) + F a + L e + noise

Here d is the deviation of the tool point in mm and ω the rotation of the tool against the workpiece in rad, n and r are
the directions that the instrument observes. The columns of F are unknowns of the set-up that nothing limits (zero,
alignment, centre of a circle), and a their sizes. The columns of L are errors with a stated standard uncertainty which
several readings share (scale of a laser, length of a ballbar), and e has a unit normal distribution.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from twin.arrays import Array
from twin.errors import DataError

InstrumentKind = Literal["laser", "straightness", "ballbar", "level", "values"]
INSTRUMENT_KINDS: tuple[InstrumentKind, ...] = get_args(InstrumentKind)
_ROUNDED = 12  # decimals of mm or rad: below what any instrument shows, above the rounding of a conversion
_DEPENDENT = 1e-9  # of the largest singular value: set-up unknowns that the readings do not tell apart


@dataclass(frozen=True, eq=False)
class InstrumentReadings:
    """Readings (m,) of one instrument in mm or rad, as the module describes them.

    `points` (m, 3) are axis positions in mm and `tool_offset` (3,) is where the reflector, ball or level is. `along`
    (m, 3) and `about` (m, 3) are n and r. `noise` (m,) are the standard uncertainties of single readings, `free` (m, f)
    is F and `correlated` (m, c) is L. If `parameters` is not empty, reading number i is instead the value of the
    parameter of the error model with this name, as an earlier report states it, in the unit `units`. `lines` are the
    numbers of the readings in their file. `unresolved_mm2` is the variance per direction of errors whose wavelength is
    too short for the estimate; if it is None, it is the one expected beforehand.

    The first `shared` columns of L belong to the instrument itself, such as its scale or its length. Readings with the
    same `device` have the errors e of these columns in common. Without a device, all errors are independent.

    Raises DataError if a standard uncertainty is not positive, or if the set-up explains every possible reading.
    """

    name: str
    kind: InstrumentKind
    points: Array
    tool_offset: Array
    along: Array
    about: Array
    readings: Array
    noise: Array
    free: Array
    correlated: Array
    parameters: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    lines: tuple[int, ...] = ()
    unresolved_mm2: float | None = None
    device: str | None = None
    shared: int = 0

    def __post_init__(self) -> None:
        if not (self.noise > 0.0).all():
            worst = int(np.argmin(np.where(np.isnan(self.noise), -np.inf, self.noise)))
            raise DataError("a standard uncertainty of a reading is not above zero", row=self.line(worst))
        if self.size <= set_up_space(self.free).shape[1]:
            raise DataError(
                f"{self.size} reading(s) determine no more than the set-up of the instrument ({self.kind})",
                hint=f"give at least {self.free.shape[1] + 1} readings",
            )

    @property
    def size(self) -> int:
        return len(self.readings)

    def unit(self, index: int) -> str:
        """Return the unit of a reading, `mm` or `rad`. `values` state it with each parameter."""
        return self.units[index] if self.units else "rad" if self.kind == "level" else "mm"

    @property
    def stated_covariance(self) -> Array:
        """Covariance (m, m) of the readings as the instrument states it, without the unknowns of its set-up."""
        return np.asarray(np.diag(self.noise**2) + self.correlated @ self.correlated.T)

    @property
    def checksum(self) -> str:
        """Checksum of what was read and where, whatever the name of the file and the stated uncertainties."""
        values = (self.points, self.along, self.about, self.readings)
        content = b"".join(np.asarray(each, dtype="<f8").round(_ROUNDED).tobytes() for each in values)
        return hashlib.sha256(content + " ".join((self.kind, *self.parameters)).encode()).hexdigest()[:16]

    def line(self, index: int) -> int:
        """Return the number of a reading in its file, or its number from 1 if it was not read from a file."""
        return self.lines[index] if self.lines else index + 1

    def with_unresolved(self, unresolved_mm2: float) -> InstrumentReadings:
        """Return the same readings for a machine with errors of short wavelength of this variance per direction."""
        return replace(self, unresolved_mm2=unresolved_mm2)


def set_up_space(free: Array) -> Array:
    """Return an orthonormal basis (m, r) of the readings that the unknowns of a set-up `free` (m, f) can explain."""
    if not free.size:
        return np.zeros((len(free), 0))
    sizes = np.linalg.norm(free, axis=0)
    left, values, _ = np.linalg.svd(free / np.where(sizes > 0.0, sizes, 1.0), full_matrices=False)
    return np.asarray(left[:, values > _DEPENDENT * values[0]])


def shared_errors(instruments: Sequence[InstrumentReadings]) -> list[Array]:
    """Return for each instrument the effects (m, d) on its readings of the d errors, with unit variance, that several
    of the `instruments` share because they have the same device.

    Raises DataError if instruments of different kinds name the same device.
    """
    counts, first = Counter(one.device for one in instruments if one.device is not None), dict[str, slice]()
    kinds, size = dict[str, InstrumentReadings](), 0
    for one in instruments:
        if one.device is None or counts[one.device] == 1:
            continue
        other = kinds.setdefault(one.device, one)
        if other.kind != one.kind:
            raise DataError(
                f"{other.name} ({other.kind}) and {one.name} ({one.kind}) name the same device '{one.device}'",
                hint="give each device a name of its own",
            )
        if one.device not in first:
            first[one.device] = slice(size, size + one.shared)
            size += one.shared
    found = []
    for one in instruments:
        effects = np.zeros((one.size, size))
        if one.device in first:
            effects[:, first[one.device]] = one.correlated[:, : one.shared]
        found.append(effects)
    return found
