"""What a report is made of.

An offline identification fills the first block only; a run on a machine adds what it decided, verified and
noticed. Sections whose value is None or empty are left out of the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, Self

from agent.results.facts import ArtefactFacts, ProbeFacts, Quantity, TableFacts, VolumetricSummary
from agent.results.gates import Gate
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position
from twin.identification import Estimate, FieldKnowledge, Scales


class ReportedEstimate(FieldKnowledge, Protocol):
    """What a page shows of an estimate, whether it has just been found or is read back."""

    @property
    def formulation(self) -> str: ...
    @property
    def parameters(self) -> Array: ...
    @property
    def standard_uncertainty(self) -> Array: ...
    @property
    def chi2_normalised(self) -> float: ...
    @property
    def degrees_of_freedom(self) -> float: ...
    @property
    def rejected(self) -> tuple[tuple[int, int, int], ...]: ...
    @property
    def scales(self) -> Scales: ...
    @property
    def rank(self) -> int: ...
    @property
    def conditioning(self) -> float: ...
    @property
    def null_summary(self) -> tuple[str, ...]: ...


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
class VerificationFacts:
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
class QuestionFacts:
    """A question to a person, the machine minute of the run, and the answer; None: none was given."""

    minute: float
    text: str
    yes: bool | None
    error: str = ""


@dataclass(frozen=True)
class NightFacts:
    """What a verification or a night decided, `since` the last accepted run, and the rows that say why."""

    decision: str
    good: bool
    since: str
    rows: tuple[tuple[str, str], ...]
    ve_now_um: float | None = None
    ve_before_um: float | None = None


@dataclass(frozen=True)
class Provenance:
    """Where a run came from: `started_by`; name and SHA-256 of each input file; digest of the settings in full."""

    started_by: str
    files: tuple[tuple[str, str], ...]
    settings_sha256: str


@dataclass(frozen=True)
class RunFacts:
    """What only a run on a machine knows. `times`: rows about begin and end; `banks`: about tables before, written
    and at the end; `trend`: an SVG with all runs up to this one; `drifts_um`: of the first ball of each position."""

    touches: int | None = None
    machine_minutes: float | None = None
    balls: int | None = None
    reason: str = ""
    times: tuple[tuple[str, str], ...] = ()
    banks: tuple[tuple[str, str], ...] = ()
    verification: VerificationFacts | None = None
    night: NightFacts | None = None
    asked: tuple[QuestionFacts, ...] = ()
    provenance: Provenance | None = None
    trend: str = ""
    temperatures: tuple[TemperatureTrace, ...] = ()
    drifts_um: tuple[float, ...] = ()
    events: tuple[EventLine, ...] = ()
    probe: ProbeFacts | None = None


@dataclass(frozen=True, eq=False)
class IdentificationData:
    """What an identification found. `positions` are the poses that `observations.position` counts; `residuals_mm`
    (n, 3) in the order of the observations."""

    observations: Observations
    estimate: ReportedEstimate
    residuals_mm: Array
    positions: tuple[Position, ...]
    volumetric: VolumetricSummary
    table: TableFacts | None = None

    @classmethod
    def of(
        cls,
        observations: Observations,
        estimate: Estimate,
        positions: Sequence[Position],
        volumetric: VolumetricSummary,
        table: TableFacts | None = None,
    ) -> Self:
        return cls(observations, estimate, estimate.residuals_mm, tuple(positions), volumetric, table)


@dataclass(frozen=True)
class ReportData:
    """Everything a page is drawn from. `tool_offset` (3,) mm: what the table and every stated volumetric error belong
    to. `found` is None where a run did not come to an estimate. `gates_enforced`: whether they decided anything.
    """

    header: Header
    machine: str
    artefact: ArtefactFacts
    tool_name: str
    tool_offset: tuple[float, float, float]
    identification: IdentificationData | None = None
    gates: tuple[Gate, ...] = ()
    gates_enforced: bool = True
    warnings: tuple[str, ...] = ()
    run: RunFacts = RunFacts()
