"""Data of a report.

An identification from files leaves `ReportData.run` empty; a run on a machine adds decisions, verification and events.
Sections whose value is None or empty are omitted from the page.
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
    """Part of an estimate that a report shows; the estimate is new or read from the journal."""

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
    """Title and identity of the report. `timestamp` is the UTC time in ISO 8601; `state` is the state of the run."""

    title: str
    run_id: str
    timestamp: str
    software_version: str
    state: str
    position_set: str
    settings: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class VerifiedPosition:
    """Held-out position.

    Its values are the rms residuals of its balls before and after activation of the table, and the predicted rms, in
    µm.
    """

    label: str
    before_um: float | None
    after_um: float
    predicted_um: float


@dataclass(frozen=True)
class VerificationFacts:
    """Verification by held-out positions before and after activation of the new table.

    `before` and `after` are the rms residuals per ball. `predicted_um` is the predicted rms after activation.
    """

    accepted: bool
    verdict: str
    before: Quantity | None
    after: Quantity
    predicted_um: float
    positions: tuple[VerifiedPosition, ...] = ()


@dataclass(frozen=True)
class TemperatureTrace:
    """Readings of one sensor.

    They consist of n times in minutes since the start of the run and n temperatures in °C.
    """

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
    """Question to the operator.

    `minute` is the machine time in minutes since the start of the run. `yes` is the answer; it is None if there was
    none.
    """

    minute: float
    text: str
    yes: bool | None
    error: str = ""


@dataclass(frozen=True)
class NightFacts:
    """Decision of a night or verification.

    `since` is the run of the last accepted night. `rows` contains the name and the text of each value on which the
    decision is based.
    """

    decision: str
    good: bool
    since: str
    rows: tuple[tuple[str, str], ...]
    ve_now_um: float | None = None
    ve_before_um: float | None = None


@dataclass(frozen=True)
class Provenance:
    """Origin of a run.

    `started_by` is the source of the request. `files` contains the name and the SHA-256 of each input file.
    """

    started_by: str
    files: tuple[tuple[str, str], ...]
    settings_sha256: str


@dataclass(frozen=True)
class RunFacts:
    """Data of a run on a machine.

    `times` contains rows on the start and the end. `banks` contains rows on the former table, the table written and the
    bank active at the end. `trend` is an SVG of the trends of all runs up to this one. `drifts_um` contains, for each
    position, the displacement of its first ball in µm at the end of the position.
    """

    touches: int | None = None
    machine_minutes: float | None = None
    balls: int | None = None
    reason: str = ""
    times: tuple[tuple[str, str], ...] = ()
    banks: tuple[tuple[str, str], ...] = ()
    verification: VerificationFacts | None = None
    night: NightFacts | None = None
    questions: tuple[QuestionFacts, ...] = ()
    provenance: Provenance | None = None
    trend: str = ""
    temperatures: tuple[TemperatureTrace, ...] = ()
    drifts_um: tuple[float, ...] = ()
    events: tuple[EventLine, ...] = ()
    probe: ProbeFacts | None = None


@dataclass(frozen=True, eq=False)
class IdentificationData:
    """Result of an identification.

    `positions` contains the poses to which the indices in `observations.position` refer. `residuals_mm` has the shape
    (n, 3) and the order of the observations.
    """

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
    """Complete data of a report.

    `tool_offset` is the offset (3,) in mm to which the table and all volumetric errors refer. `identification` is None
    if the run has no estimate. `gates_enforced` is False if the gates are informative only.
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
