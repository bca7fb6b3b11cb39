"""Settings file of the agent (TOML). The range of each value is limited, unknown keys are refused, and paths are
relative to the settings file.

The key of a quantity that has a unit ends with the unit, for example ``search_mm``. The JSON schema of this module is
committed under ``config/schema``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from agent.settings.history import HistorySettings
from agent.settings.notifications import NotificationSettings
from agent.settings.opcua import OpcUaSettings
from agent.settings.panel_gateway import GatewaySettings
from agent.settings.report import ReportSettings
from agent.settings.service import ServiceSettings
from agent.settings.temperature import TemperatureSettings
from twin.artefact.mount_geometry import MountGeometry, without_mount
from twin.collision.probe_geometry import ProbeSection
from twin.formats.toml_reading import StrictModel, forbid_unknown_keys, read_toml

Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]
Coordinates = tuple[float, float, float]
Angles = tuple[Annotated[float, Field(ge=-180.0, le=180.0)], Annotated[float, Field(ge=-90.0, le=90.0)]]
"""Azimuth and elevation of a mount, degrees."""
Order = Literal["evidence", "file"] | Annotated[int, Field(ge=1, le=15)]


class ClockSettings(StrictModel):
    """Clock of the run.

    `kind` is ``real`` on a real machine. With simulators it is ``scaled`` (machine time runs at `factor` times
    wall-clock time) or ``lockstep`` (the time server of the simulator at `host` and `port` sets the time).
    """

    kind: Literal["real", "scaled", "lockstep"] = "real"
    factor: PositiveFloat = 1.0
    host: str = "127.0.0.1"
    port: int = Field(default=0, ge=0, le=65535)


class DeviceSettings(StrictModel):
    """Device, given by the name of its driver plugin and by options, which this plugin validates."""

    driver: Name
    options: dict[str, Any] = Field(default_factory=dict)


class RoleSettings(StrictModel):
    """Names of the devices that serve as machine, probe, compensation store, thermometer, operator and mount. `mount`
    names one device for all stations, or maps each station number to a device. It is omitted if the artefact is placed
    by hand."""

    machine: Name
    probe: Name
    store: Name
    thermometer: Name
    operator: Name
    mount: Name | dict[PositiveInt, Name] | None = None


class StationSettings(StrictModel):
    """Stations of the mount, numbered from 1.

    `places_mm` contains one point for each station, in the workpiece frame: the point where the azimuth axis and the
    elevation axis of the mount meet.

    If each station has a mount of its own, `artefacts` lists one artefact file per station. It is omitted if a single
    artefact is moved between the mounts. `parked_deg` contains the azimuth and elevation of the mounts at which no
    artefact is being measured. `park_distance_mm` is the distance of the probe from the mount while the mount turns; if
    it is None, it follows from the travel (see `park_distance_mm` in `agent.planning.stations`).

    If `placed_by_hand` is True, there is no mount: the operator is asked to place the artefact in each position, and
    `places_mm` are the points at which the origin of the artefact frame is to stand. An artefact that is found farther
    than `placement_tolerance_mm` from its place, or turned by more than `placement_tolerance_deg`, is refused. After
    `placement_attempts` refused placements in one position, the run ends.
    """

    places_mm: list[Coordinates] = Field(min_length=1)
    standing_at: PositiveInt | None = None
    artefacts: list[Path] | None = Field(default=None, min_length=1)
    parked_deg: Angles = (0.0, 90.0)
    park_distance_mm: PositiveFloat | None = None
    placed_by_hand: bool = False
    placement_tolerance_mm: PositiveFloat = Field(default=5.0, le=30.0)
    placement_tolerance_deg: PositiveFloat = Field(default=1.5, le=5.0)
    placement_attempts: int = Field(default=10, ge=1, le=100)

    def resolved(self, base: Path) -> StationSettings:
        """Return these settings with relative paths resolved against the directory `base`."""
        if self.artefacts is None:
            return self
        return self.model_copy(update={"artefacts": [(base / path).resolve() for path in self.artefacts]})


class ProcedureSettings(StrictModel):
    """Measuring procedure. `position_set` consists of names joined by + (such as S1+S3), or is the path of a position
    file."""

    position_set: str = "S3"
    stations: list[PositiveInt] | None = None
    touches_per_ball: Literal[3, 5, 9, 13, 25] = 5
    touch_feed_mm_per_min: PositiveFloat = Field(default=300.0, le=3000.0)
    approach_mm: PositiveFloat = Field(default=3.0, le=50.0)
    search_mm: PositiveFloat = Field(default=3.0, le=10.0)
    wide_approach_mm: PositiveFloat = Field(default=8.0, le=50.0)
    wide_search_mm: PositiveFloat = Field(default=8.0, le=20.0)
    guarded_feed_mm_per_min: PositiveFloat = Field(default=3000.0, le=6000.0)
    recentre_mm: PositiveFloat = 0.3
    retract_mm: PositiveFloat = 45.0
    paths: Literal["shortest", "plain"] = "shortest"
    clearance_mm: PositiveFloat = Field(default=1.0, le=50.0)
    optimise_order: bool = True
    closing_positions: int = Field(default=0, ge=0, le=20)
    touch_stages: Literal[1, 2] = 1
    first_touch_feed_mm_per_min: PositiveFloat = Field(default=1000.0, le=3000.0)
    back_off_mm: PositiveFloat = Field(default=1.0, le=10.0)
    touch_sigma_um: PositiveFloat = 1.1
    radius_limit_um: PositiveFloat = 20.0
    form_limit_um: PositiveFloat = 10.0
    touch_limit_um: PositiveFloat = 6.0
    pole_limit_um: PositiveFloat = 10.0
    drift_limit_um: PositiveFloat = 10.0
    repeat_first_ball: bool = True
    position_false_alarm: float = Field(default=1e-3, gt=0.0, le=0.1)
    repeats: int = Field(default=2, ge=0, le=5)
    on_failure: Literal["stop", "skip"] = "skip"


class ProbeCheckSettings(StrictModel):
    """Repeatability check of the probe before a run.

    A ball is touched `touches` times at its pole. Twice the standard deviation of these touches must not exceed
    `limit_um`. If `latch_delay` is True, the ball is also touched `touches` times at each of two feeds, which shows the
    delay between the trip of the probe and the latching of the axis positions.
    """

    enabled: bool = True
    touches: int = Field(default=5, ge=3, le=50)
    limit_um: PositiveFloat = 3.0
    latch_delay: bool = False


class QualificationSettings(StrictModel):
    """Stylus qualification on the datum ball with 25 touches before a run.

    `ball` is the number of the datum ball; by default it is the first ball that is accessible from all sides.
    `limit_um` is the limit of the form error and of each residual of the sphere fitted to these touches.
    `ball_radius_sigma_um` is the standard deviation of the radii of the artefact's balls.
    """

    enabled: bool = True
    ball: int | None = Field(default=None, ge=0)
    pretravel_map: bool = False
    limit_um: PositiveFloat = 20.0
    ball_radius_sigma_um: float = Field(default=0.2, ge=0.0, le=10.0)


class ReversalSettings(StrictModel):
    """Reversal test of the linear axes on the datum ball.

    At each of two points per axis the ball is touched `touches` times from either side. Lost motion above `limit_um`
    causes a warning. If `on_excess` is ``stop`` and the lost motion exceeds the limit by more than its uncertainty, the
    run ends.
    """

    enabled: bool = True
    touches: int = Field(default=2, ge=1, le=20)
    limit_um: PositiveFloat = 10.0
    on_excess: Literal["warn", "stop"] = "warn"


class IdentificationSettings(StrictModel):
    """Identification of the machine errors.

    `order` is the order of the Legendre series of the geometric errors: ``evidence`` chooses the order with the largest
    Bayesian evidence from the measurements, ``file`` takes the order of the machine file, and a number sets the order
    itself.
    """

    formulation: Literal["centres", "distances"] = "centres"
    prior: bool = True
    weights: Literal["full", "unit"] = "full"
    order: Order = "evidence"


class TableSettings(StrictModel):
    """Grid and anchor of the compensation table. `step_mm` is the largest distance of the grid nodes per axis; if
    it is None, it is 100 mm, or a twelfth of the axis' range if that is less. `anchor_mm` contains the axis positions
    at which the correction is zero."""

    step_mm: Coordinates | None = None
    anchor_mm: Coordinates | None = None


EARLIER_CERTIFICATE_KEY = "max_certificate_sigma"
COVERAGE_FACTOR = 2.0
"""Coverage factor of the expanded uncertainties in which limits are stated."""


class _EarlierGateSettings(StrictModel):
    """Limit of the certificate in standard deviations, as settings of earlier versions state it."""

    max_certificate_sigma: float = Field(gt=0.0, strict=True)


class GateSettings(StrictModel):
    """Limits of the gates, which an estimate must pass before it is applied to a machine. A limit is in µm if its key
    says so.

    A run takes the limits from its settings file. `volcal identify` takes them from the settings file that it is given
    or, without a settings file, uses these defaults. No artefact reaches the corners of the travel, so a table always
    has nodes outside the measured region. They are accepted as long as their corrections are larger than their
    uncertainty (`max_unmeasured_fraction`), or never if `allow_extrapolation` is False.
    """

    max_chi2: PositiveFloat = 2.0
    min_degrees_of_freedom: PositiveInt = 30
    max_correction_um: PositiveFloat = 300.0
    max_slope_um_per_mm: PositiveFloat = 0.5
    max_change: PositiveFloat = 3.0
    night_false_alarm: float = Field(default=0.001, gt=0.0, lt=1.0)
    max_certificate_en: PositiveFloat = 2.5
    step_false_alarm: float = Field(default=0.01, gt=0.0, lt=1.0)
    pattern_false_alarm: float = Field(default=0.01, gt=0.0, lt=1.0)
    common_scale_false_alarm: float = Field(default=0.01, gt=0.0, lt=1.0)
    allow_extrapolation: bool = True
    max_unmeasured_fraction: float = Field(default=1.0, gt=0.0, le=10.0)

    @model_validator(mode="before")
    @classmethod
    def _earlier_form(cls, given: Any) -> Any:
        """Accept settings of earlier versions, which state the limit of the certificate in standard deviations."""
        if not isinstance(given, dict) or EARLIER_CERTIFICATE_KEY not in given:
            return given
        if "max_certificate_en" in given:
            return given
        # an error names the key that was written
        sigmas = _EarlierGateSettings.model_validate({EARLIER_CERTIFICATE_KEY: given[EARLIER_CERTIFICATE_KEY]})
        kept = {name: value for name, value in given.items() if name != EARLIER_CERTIFICATE_KEY}
        return kept | {"max_certificate_en": sigmas.max_certificate_sigma / COVERAGE_FACTOR}


class VerificationSettings(StrictModel):
    """Held-out positions, which are not used for the estimate. They are measured before and after a new compensation
    table is activated.

    If `positions_deg` is set, these orientations are held out at each of the `stations`. Otherwise, `positions` single
    positions are chosen automatically: positions at the `stations`, with orientations on a grid of `grid_deg`, whose
    balls are expected to keep the largest error with the table active.

    A full calibration writes a new table only if the volumetric error expected with it is lower than that expected with
    the active table (or without compensation) by at least the fraction `min_gain`. Otherwise it confirms the active
    table. Nor does it write a table whose effect the held-out balls would show with a probability of less than 95 %.
    The new table stays active if they show its effect (a table without effect would be found out with 95 %) and are as
    predicted: their normalised χ² is at most `max_chi2`.

    `min_gain` is larger than `nightly.min_gain`, because a full calibration knows nothing of the measurement behind the
    active table: of two equally good tables, it expects the one that it has just measured to be better by up to 22 %.
    """

    positions_deg: Annotated[list[Angles], Field(min_length=1)] | None = None
    positions: PositiveInt = 4
    grid_deg: PositiveFloat = Field(default=30.0, le=90.0)
    stations: list[PositiveInt] | None = None
    max_chi2: PositiveFloat = 2.0
    min_gain: float = Field(default=0.25, ge=0.0, lt=1.0)


RELOCATION_BY_HAND_MINUTES = 3.0
RELOCATION_BY_CRANE_MINUTES = 10.0
"""Minutes to move mount and artefact to another station, by one person and with a crane.

Both are estimates by work elements, not measurements. By hand: stop and open the door 0.5, unclamp 0.5, carry and put
down on the locators 1, clamp 0.5, close the door and confirm 0.5. With a crane: the same without carrying 2, fetch the
crane and attach the slings 3, lift and travel 3, lower and detach 2. A crane is needed above the reference mass of
25 kg of ISO 11228-1. The runs of a machine replace the estimate (`volcal timing`).
"""


class TimingSettings(StrictModel):
    """Parameters of the cycle time prediction. The speeds of the linear axes come from the machine file.

    `speed_deg_per_s` and `acceleration_deg_per_s2` are those of the mount. Each latency is added to the motion time of
    its command; `turn_latency_s` includes the settling of the mount. `relocation_minutes` is the time needed to move
    the artefact to another station. The default is an estimate for one person without a crane, 3 minutes; with a crane,
    10 minutes are typical. State 0 for an operator who is simulated without `carrying_minutes`.
    """

    speed_deg_per_s: PositiveFloat = 20.0
    acceleration_deg_per_s2: PositiveFloat = 40.0
    command_latency_s: float = Field(default=0.0, ge=0.0, le=60.0)
    touch_latency_s: float = Field(default=0.0, ge=0.0, le=60.0)
    turn_latency_s: float = Field(default=0.0, ge=0.0, le=600.0)
    relocation_minutes: float = Field(default=RELOCATION_BY_HAND_MINUTES, ge=0.0, le=600.0)


class NightlySettings(StrictModel):
    """Settings of the nights after a full calibration. They set the measurements of `volcal verify` and `volcal
    nightly`, and the limits beyond which the machine counts as changed.

    `held_out_positions` is the number of held-out positions at the artefact's station (see `verification`) that are
    measured at the start of a night, and again if a new compensation table is written. `check_positions` is the number
    of designed (optimally selected) positions that complete the check at the start of a night.

    `volcal verify` measures the fewest positions that find a step of any squareness by `verify_step_urad` with a
    probability of 95 %. `verify_false_alarm` is the largest probability with which it reports a step where none is.

    `drift_um` is the rms length of the field by which the machine may change per night; the change is distributed like
    the errors of the machine's family. `scale_drift_um_per_m` is an additional drift per night of the scale of each
    axis.

    The machine is out of limits in three cases. The normalised χ² of the prediction exceeds `max_chi2`. Or one error
    has changed abruptly, and the evidence for this step (ln of the likelihood ratio) is at least `step_evidence`; in a
    verification, the limit follows from `verify_false_alarm`. Or the volumetric error (VE) exceeds `max_ve_growth`
    times the VE after the last accepted night.

    A night writes a table if the volumetric error expected with it is lower than that expected with the active table by
    at least the fraction `min_gain`, and if the held-out balls can show its effect. This is the rule of a full
    calibration with a smaller margin: the estimate of a night contains everything that is known of the active table, so
    it does not overrate its own.
    """

    slot_minutes: PositiveFloat = Field(default=15.0, le=1440.0)
    reserve_minutes: float = Field(default=0.5, ge=0.0, le=60.0)
    held_out_positions: PositiveInt = 1
    check_positions: PositiveInt = 2
    verify_step_urad: PositiveFloat = Field(default=10.0, le=10000.0)
    verify_false_alarm: float = Field(default=0.01, ge=1e-6, le=0.5)
    grid_deg: PositiveFloat = Field(default=45.0, le=45.0)
    drift_um: float = Field(default=0.15, ge=0.0, le=100.0)
    scale_drift_um_per_m: float = Field(default=0.4, ge=0.0, le=100.0)
    max_chi2: PositiveFloat = 2.0
    step_evidence: PositiveFloat = 8.0
    max_ve_growth: float = Field(default=2.0, ge=1.0)
    min_gain: float = Field(default=0.02, ge=0.0, lt=1.0)
    full_allowed: bool = False


class PreflightSettings(StrictModel):
    """Settings of the preflight, a simulated execution of the complete plan before the machine moves. `driver` is the
    driver plugin that simulates the machine."""

    driver: Name = "simulated"


class Settings(StrictModel):
    """All settings of one machine and its procedure."""

    machine: Path
    artefact: Path
    tool: Name = "probe"
    state_directory: Path = Path("state")
    clock: ClockSettings = ClockSettings()
    devices: dict[Name, DeviceSettings]
    roles: RoleSettings
    mount: Annotated[MountGeometry, forbid_unknown_keys(MountGeometry)] = MountGeometry()
    probe: Annotated[ProbeSection, forbid_unknown_keys(ProbeSection)] = ProbeSection()
    stations: StationSettings
    procedure: ProcedureSettings = ProcedureSettings()
    probe_check: ProbeCheckSettings = ProbeCheckSettings()
    qualification: QualificationSettings = QualificationSettings()
    reversal: ReversalSettings = ReversalSettings()
    identification: IdentificationSettings = IdentificationSettings()
    table: TableSettings = TableSettings()
    gates: GateSettings = GateSettings()
    verification: VerificationSettings = VerificationSettings()
    nightly: NightlySettings = NightlySettings()
    temperature: TemperatureSettings = TemperatureSettings()
    timing: TimingSettings = TimingSettings()
    preflight: PreflightSettings = PreflightSettings()
    service: ServiceSettings = ServiceSettings()
    history: HistorySettings = HistorySettings()
    gateway: GatewaySettings = GatewaySettings()
    opcua: OpcUaSettings = OpcUaSettings()
    notifications: NotificationSettings = NotificationSettings()
    report: ReportSettings = ReportSettings()

    @model_validator(mode="before")
    @classmethod
    def _without_mount(cls, document: Any) -> Any:
        """Remove the parts of the mount from the geometry if the artefact is placed by hand."""
        if not isinstance(document, dict):
            return document
        stations, section = document.get("stations"), document.get("mount", {})
        by_hand = isinstance(stations, dict) and stations.get("placed_by_hand") is True
        return {**document, "mount": without_mount(section)} if by_hand and isinstance(section, dict) else document

    @model_validator(mode="after")
    def _stations_exist(self) -> Self:
        count = len(self.stations.places_mm)
        named = {
            "stations.standing_at": [self.stations.standing_at] if self.stations.standing_at else [],
            "procedure.stations": self.procedure.stations or [],
            "verification.stations": self.verification.stations or [],
        }
        for key, numbers in named.items():
            for number in numbers:
                if number > count:
                    raise ValueError(f"{key} names station {number}, but stations.places_mm has {count}")
        return self

    def resolved(self, base: Path) -> Settings:
        """Return these settings with relative paths resolved against the directory `base`."""
        paths = {name: (base / getattr(self, name)).resolve() for name in ("machine", "artefact", "state_directory")}
        doors = ("service", "gateway", "opcua", "history", "notifications", "report")
        sections = {name: getattr(self, name).resolved(base) for name in doors}
        return self.model_copy(update={**paths, **sections, "stations": self.stations.resolved(base)})


def parse_settings(text: str, source: str) -> Settings:
    """Parse settings from TOML text. Raises FormatError, which names the file, the invalid key, and the keys that are
    valid in its place."""
    return read_toml(text, source, Settings)
