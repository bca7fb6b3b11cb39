"""What a report is made of.

An offline identification fills the first block only; a run on a machine adds what it decided, verified and
noticed. Sections whose value is None or empty are left out of the page.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from agent.gates import Gate
from twin.artefact import Artefact
from twin.identification import Estimate
from twin.machine_description import MachineDescription
from twin.observations import Observations
from twin.position_set import Position
from twin.table import CompensationTable
from twin.volumetric import Volumetric

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Quantity:
    """A length in µm with its standard uncertainty (None: not known)."""

    value_um: float
    standard_uncertainty_um: float | None = None


@dataclass(frozen=True)
class VolumetricSummary:
    """VE of the bare machine as estimated (before), VCE as predicted (after); as defined and rigidly aligned."""

    before_raw: Quantity
    before_aligned: Quantity
    after_raw: Quantity
    after_aligned: Quantity

    @property
    def before(self) -> Volumetric:
        return Volumetric(1e-3 * self.before_raw.value_um, 1e-3 * self.before_aligned.value_um)

    @property
    def after(self) -> Volumetric:
        return Volumetric(1e-3 * self.after_raw.value_um, 1e-3 * self.after_aligned.value_um)


@dataclass(frozen=True)
class Header:
    """Who, what and when. `timestamp` is ISO 8601 UTC; `state` one of the run states."""

    title: str
    run_id: str
    timestamp: str
    software_version: str
    state: str
    position_set: str
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class VerifiedPosition:
    """A held-out position: rms of its ball deviations, and the standard uncertainty predicted for that rms."""

    label: str
    before_um: float | None
    after_um: float
    predicted_um: float


@dataclass(frozen=True)
class Verification:
    """Fresh measurements with the new table active."""

    accepted: bool
    verdict: str
    before: Quantity | None
    after: Quantity
    predicted_um: float
    positions: tuple[VerifiedPosition, ...] = ()


@dataclass(frozen=True)
class TemperatureTrace:
    """One sensor over the run: (n,) minutes since its start and (n,) °C."""

    name: str
    minutes: Array
    temperature_c: Array


@dataclass(frozen=True)
class EventLine:
    timestamp: str
    kind: str
    text: str


@dataclass(frozen=True)
class ProbeRing:
    """Touches of the qualification at one latitude (90°: the pole): (k,) angles about the stylus and residuals; the
    pretravel map along the ring, (m,) each, empty without one."""

    latitude_deg: float
    angle_deg: Array
    residual_um: Array
    map_angle_deg: Array
    map_um: Array


@dataclass(frozen=True)
class ProbeFacts:
    """What was found of probe and stylus before the run: name and text, and the touches of the qualification."""

    rows: tuple[tuple[str, str], ...]
    rings: tuple[ProbeRing, ...] = ()


@dataclass(frozen=True)
class RunFacts:
    """What only a run on a machine knows."""

    touches: int | None = None
    machine_minutes: float | None = None
    table_bank: str | None = None
    verification: Verification | None = None
    temperatures: tuple[TemperatureTrace, ...] = ()
    events: tuple[EventLine, ...] = ()
    probe: ProbeFacts | None = None


@dataclass(frozen=True)
class ReportData:
    """Everything a page is drawn from. `positions` are the poses that `observations.position` counts.

    `volumetric` is computed where it is not at hand. `gates_enforced`: whether they decided anything.
    """

    header: Header
    machine: MachineDescription
    artefact: Artefact
    observations: Observations
    estimate: Estimate
    positions: tuple[Position, ...]
    tool_name: str
    table: CompensationTable | None = None
    table_crc32: str | None = None
    volumetric: VolumetricSummary | None = None
    gates: tuple[Gate, ...] = ()
    gates_enforced: bool = True
    warnings: tuple[str, ...] = ()
    run: RunFacts = RunFacts()

    @property
    def tool_offset(self) -> Array:
        """(3,) mm: the offset that the table and every stated volumetric error belong to."""
        return np.asarray(self.machine.tools[self.tool_name], dtype=np.float64)
