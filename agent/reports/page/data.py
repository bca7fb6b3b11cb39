"""Data that a report shows.

If the data come from an identification of the machine's errors from files, `ReportData.run` is empty. A run on a
machine adds decisions, the verification and events. The report omits every section whose value is None or empty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Self, TypeAlias

import numpy as np

from agent.results.facts import ArtefactFacts, ProbeFacts, Quantity, TableFacts, VolumetricSummary
from agent.results.gates.gate import Gate
from agent.results.run_verdict import ACCEPTED, CONFIRMED, FUSED, MEASURED, OUT, WITHIN, RunVerdict
from agent.results.travel_parts import TravelParts
from agent.settings.report import ReportSettings
from agent.thermal.thermometer import ThermometerFacts
from agent.workpiece.predicted_tests import PredictedTests
from twin.arrays import Array
from twin.artefact.observations import Observations
from twin.artefact.position_set import SET_EXPRESSIONS, Position, set_orientations
from twin.formats.estimate_file import StoredEstimate
from twin.identification import Estimate, Misfit, Scales


@dataclass(frozen=True, eq=False)
class JournalEstimate(StoredEstimate):
    """Estimate read from the journal of a run.

    `unresolved_mm2` is the variance, in mm² for each direction, of a part of the misfit. This part varies over
    distances too short for the functions (modes) by which the misfit is estimated.
    """

    unresolved_mm2: float

    @property
    def formulation(self) -> str:
        return self.document.formulation

    @property
    def standard_uncertainty(self) -> Array:
        """Standard uncertainties (p,) of the p parameters of the error model, each in mm or rad."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance), 0.0))

    @property
    def chi2_normalised(self) -> float:
        return self.document.chi2_normalised

    @property
    def degrees_of_freedom(self) -> float:
        return self.document.degrees_of_freedom

    @property
    def rejected(self) -> tuple[tuple[int, int, int], ...]:
        """Position, ball and tool of each rejected measurement."""
        return tuple((row.position, row.ball, row.tool) for row in self.document.rejected)

    @property
    def scales(self) -> Scales:
        return self.document.scales.scales

    @property
    def rank(self) -> int:
        return self.document.rank

    @property
    def conditioning(self) -> float:
        return self.document.conditioning

    @property
    def null_summary(self) -> tuple[str, ...]:
        return self.document.null_summary

    @property
    def misfit(self) -> Misfit | None:
        """Estimated part of the error field that the error model cannot represent; None if it was not estimated."""
        return Misfit.of(self.unknowns, self.z, self.z_covariance, self.unresolved_mm2)


ReportedEstimate: TypeAlias = Estimate | JournalEstimate
"""Estimate of the machine's errors that has just been made, or that was read from the journal of a run."""
_MEASURED = (ACCEPTED, CONFIRMED, FUSED, WITHIN, OUT, MEASURED)
"""Verdicts on runs that measured what they were to measure."""
SAME_ANGLE_DEG = 0.01
SIDES_DEG = (0.0, 90.0, 180.0, -90.0)


@dataclass(frozen=True)
class Header:
    """Title and identity of the report. `timestamp` is the UTC time in ISO 8601; `state` is the state of the run.
    `verdict` is None for a report that belongs to no run."""

    title: str
    run_id: str
    timestamp: str
    software_version: str
    state: str
    position_set: str
    settings: Mapping[str, str] = field(default_factory=dict)
    verdict: RunVerdict | None = None

    @property
    def end(self) -> str:
        """Word for the end of the run, or its state if it has no verdict."""
        return self.state if self.verdict is None else self.verdict.word["en"]


@dataclass(frozen=True)
class VerifiedPosition:
    """Held-out position with its rms residuals in µm.

    `before_um` and `after_um` are the rms residuals of the position's balls before and after activation of the new
    compensation table. `predicted_um` is the predicted rms residual after activation.
    """

    label: str
    before_um: float | None
    after_um: float
    predicted_um: float


@dataclass(frozen=True)
class VerificationFacts:
    """Result of the verification of a new compensation table by held-out positions.

    `before` and `after` are the rms residuals per ball before and after activation of the table; `before` is None if it
    was not measured. `predicted_um` is the prediction of `after`. `least_known` is True if the positions were chosen
    where the table was expected to be least accurate, and False if the settings list them.
    """

    accepted: bool
    verdict: str
    before: Quantity | None
    after: Quantity
    predicted_um: float
    positions: tuple[VerifiedPosition, ...] = ()
    least_known: bool = False


@dataclass(frozen=True)
class TemperatureTrace:
    """Readings of one temperature sensor.

    `minutes` (n,) holds the times of the n readings in minutes since the start of the run. `temperature_c` (n,) holds
    the temperatures in °C.
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
    """Question that the run asked the operator.

    `minute` is the machine time of the question in minutes since the start of the run. `yes` is the operator's answer;
    it is None if there was no answer.
    """

    minute: float
    text: str
    yes: bool | None
    error: str = ""


@dataclass(frozen=True)
class NightFacts:
    """Decision of a nightly run or a verification.

    `since` is the identity of the run of the last accepted night. `rows` contains the name and the text of each value
    on which the decision is based.
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

    `started_by` is the source of the request, with the name of the client if it is known. `files` contains the name and
    the SHA-256 of each input file.
    """

    started_by: str
    files: tuple[tuple[str, str], ...]
    settings_sha256: str


@dataclass(frozen=True)
class RunFacts:
    """Data of a run on a machine.

    `times` contains table rows about the start and the end of the run. `banks` contains table rows about the
    compensation table before the run, the table that was written, and the controller's bank that is active at the end.
    `trend` is an SVG that shows the main results of all runs up to this run. `drifts_um` contains one value in µm for
    each position: the displacement of the position's first ball when it was measured again at the end of the position.
    `after_homing` states the accuracy after the next homing; it is empty if the run states none.
    `touches_checked_together` is the number of touches of a ball if these are so few that the balls of a position are
    checked against each other, else None.
    """

    touches: int | None = None
    machine_minutes: float | None = None
    forecast_minutes: float | None = None
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
    after_homing: str = ""
    touches_checked_together: int | None = None


@dataclass(frozen=True, eq=False)
class IdentificationData:
    """Result of an identification of the machine's errors, as a report shows it.

    `positions` is the list of positions to which the indices in `observations.position` refer. `residuals_mm` (n, 3)
    holds the residuals of the n observations, in the order of the observations. `thermometer` is the effect of the
    artefact's thermometer on the result, and `travel` the volumetric error inside and outside the measured region. Both
    are None if they are not known. `numbers` contains the number of each position in the
    file of the ball centres; it is empty if they were not read from a file. `family_prior` is False if the prior of the
    estimate was not the family of the machine, for example because an earlier estimate was carried over. `acceptance`
    contains the predicted figures of acceptance tests; it is None if they were not predicted.
    """

    observations: Observations
    estimate: ReportedEstimate
    residuals_mm: Array
    positions: tuple[Position, ...]
    volumetric: VolumetricSummary
    table: TableFacts | None = None
    thermometer: ThermometerFacts | None = None
    travel: TravelParts | None = None
    numbers: tuple[int, ...] = ()
    family_prior: bool = True
    acceptance: PredictedTests | None = None

    @classmethod
    def of(
        cls,
        observations: Observations,
        estimate: Estimate,
        positions: Sequence[Position],
        volumetric: VolumetricSummary,
        table: TableFacts | None = None,
        thermometer: ThermometerFacts | None = None,
        travel: TravelParts | None = None,
        numbers: tuple[int, ...] = (),
        *,
        family_prior: bool = True,
    ) -> Self:
        return cls(
            observations,
            estimate,
            estimate.residuals_mm,
            tuple(positions),
            volumetric,
            table,
            thermometer,
            travel,
            numbers,
            family_prior,
        )


@dataclass(frozen=True)
class ReportData:
    """Complete data of a report.

    `tool_offset` (3,) is the vector in mm from the ram's reference point to the stylus centre (tool offset), to which
    the table and all volumetric errors refer. `identification` is None if the run has no estimate. `document` is the
    section of the settings with the head of the document, the instruments and the tolerances.
    """

    header: Header
    machine: str
    artefact: ArtefactFacts
    tool_name: str
    tool_offset: tuple[float, float, float]
    identification: IdentificationData | None = None
    gates: tuple[Gate, ...] = ()
    warnings: tuple[str, ...] = ()
    run: RunFacts = RunFacts()
    document: ReportSettings = field(default_factory=ReportSettings)

    @property
    def tolerances(self) -> Mapping[str, float]:
        """Tolerances of the settings with which the results are compared. They are compared with none if the run was
        refused, stopped or not proved."""
        verdict = self.header.verdict
        return self.document.tolerances if verdict is None or verdict in _MEASURED else {}

    @property
    def withholds_conformity(self) -> bool:
        """True if the settings state tolerances with which the results are not compared."""
        return bool(self.document.tolerances) and not self.tolerances

    @property
    def new_table_active(self) -> bool:
        """True if the run ended with a new compensation table active and proved. A run that is stopped, or ends with an
        error, after its proof takes the table back."""
        proof, verdict = self.run.verification, self.header.verdict
        return proof is not None and proof.accepted and (verdict is None or verdict is ACCEPTED)


def name_of_positions(positions: Sequence[Position]) -> str:
    """Return a name for a list of positions.

    The name is, for example, `S3, 4 stations` if every station has the orientations of the standard set S3, with the
    holders of the bar towards any of the four sides. The name may combine several sets. If no combination fits, the
    name states the number of positions.
    """
    stations: dict[int, set[tuple[float, float]]] = {}
    for position in positions:
        stations.setdefault(position.station, set()).add((position.azimuth_deg, position.elevation_deg))
    for expression, facing_deg in product(SET_EXPRESSIONS, SIDES_DEG):
        wanted = {pair for name in expression.split("+") for pair in set_orientations(name, facing_deg)}
        if all(_same(found, wanted) for found in stations.values()):
            return f"{expression}, {len(stations)} station{'s' if len(stations) != 1 else ''}"
    return f"{len(positions)} user-defined positions"


def _same(found: set[tuple[float, float]], wanted: set[tuple[float, float]]) -> bool:
    return len(found) == len(wanted) and all(
        any(abs(a - c) < SAME_ANGLE_DEG and abs(b - d) < SAME_ANGLE_DEG for c, d in wanted) for a, b in found
    )
