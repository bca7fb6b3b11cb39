"""The settings of an agent: one TOML file, every key bounded, unknown keys refused, paths relative to the file.

Units are in the key where they are not mm. The JSON schema of this module is committed under ``config/schema``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from agent.settings.history import HistorySettings
from agent.settings.opcua import OpcUaSettings
from agent.settings.panel_gateway import GatewaySettings
from agent.settings.service import ServiceSettings
from agent.settings.temperature import TemperatureSettings
from twin.artefact.position_set import MountGeometry
from twin.collision.bodies import ProbeGeometry
from twin.formats.toml_reading import Strict, read_toml, refuse_unknown

Name = Annotated[str, Field(min_length=1, pattern=r"^[A-Za-z0-9_.-]+$")]
Coordinates = tuple[float, float, float]
Angles = tuple[Annotated[float, Field(ge=-180.0, le=180.0)], Annotated[float, Field(ge=-90.0, le=90.0)]]
"""Azimuth and elevation of a mount, degrees."""
Order = Literal["evidence", "file"] | Annotated[int, Field(ge=1, le=15)]


class ClockSettings(Strict):
    """`real` on a machine; `scaled` and `lockstep` against simulators."""

    kind: Literal["real", "scaled", "lockstep"] = "real"
    factor: PositiveFloat = 1.0
    host: str = "127.0.0.1"
    port: int = Field(default=0, ge=0, le=65535)


class DeviceSettings(Strict):
    """One device: which plugin drives it, and the options that this plugin validates."""

    driver: Name
    options: dict[str, Any] = Field(default_factory=dict)


class RoleSettings(Strict):
    """Which device plays which role. `mount`: one device for every station, or one for each."""

    machine: Name
    probe: Name
    store: Name
    thermometer: Name
    operator: Name
    mount: Name | dict[PositiveInt, Name]


class StationSettings(Strict):
    """`places_mm`: foot of the mount at each station (counted from 1), workpiece frame.

    Where each station has a mount of its own: `artefacts`, one file a station, if nothing is carried; `parked_deg`:
    azimuth and elevation of every mount but the one that is measured at.
    """

    places_mm: list[Coordinates] = Field(min_length=1)
    standing_at: PositiveInt | None = None
    artefacts: list[Path] | None = Field(default=None, min_length=1)
    parked_deg: Angles = (0.0, 90.0)
    park_distance_mm: PositiveFloat = 1000.0

    def resolved(self, base: Path) -> StationSettings:
        """The same with every path made absolute, starting from `base`."""
        if self.artefacts is None:
            return self
        return self.model_copy(update={"artefacts": [(base / path).resolve() for path in self.artefacts]})


class ProcedureSettings(Strict):
    """What is measured and how. `position_set`: names joined by + (S1+S3), or the path of a position file."""

    position_set: str = "S3"
    stations: list[PositiveInt] | None = None
    touches_per_ball: Literal[5, 9, 13, 25] = 5
    touch_feed_mm_per_min: PositiveFloat = Field(default=300.0, le=3000.0)
    approach_mm: PositiveFloat = Field(default=3.0, le=50.0)
    search_mm: PositiveFloat = Field(default=3.0, le=10.0)
    wide_approach_mm: PositiveFloat = Field(default=8.0, le=50.0)
    wide_search_mm: PositiveFloat = Field(default=8.0, le=20.0)
    careful_feed_mm_per_min: PositiveFloat = Field(default=3000.0, le=6000.0)
    recentre_mm: PositiveFloat = 0.3
    retract_mm: PositiveFloat = 45.0
    paths: Literal["shortest", "plain"] = "shortest"
    clearance_mm: PositiveFloat = Field(default=1.0, le=50.0)
    reorder: bool = True
    touch_stages: Literal[1, 2] = 1
    find_feed_mm_per_min: PositiveFloat = Field(default=1000.0, le=3000.0)
    back_off_mm: PositiveFloat = Field(default=1.0, le=10.0)
    touch_sigma_um: PositiveFloat = 1.1
    radius_limit_um: PositiveFloat = 20.0
    form_limit_um: PositiveFloat = 10.0
    touch_limit_um: PositiveFloat = 6.0
    pole_limit_um: PositiveFloat = 10.0
    drift_limit_um: PositiveFloat = 10.0
    repeats: int = Field(default=2, ge=0, le=5)
    on_failure: Literal["stop", "skip"] = "skip"


class ProbeCheckSettings(Strict):
    """Before a run the pole of one ball is touched `touches` times; 2σ of them against `limit_um`."""

    enabled: bool = True
    touches: int = Field(default=5, ge=3, le=50)
    limit_um: PositiveFloat = 2.0


class QualificationSettings(Strict):
    """The stylus on the datum ball, touched 25 times before a run.

    `ball`: its number; by default the first that is free all around. `limit_um`: of form and of each residual there.
    `ball_spread_um`: standard deviation of the radii of the artefact's balls.
    """

    enabled: bool = True
    ball: int | None = Field(default=None, ge=0)
    pretravel_map: bool = False
    limit_um: PositiveFloat = 20.0
    ball_spread_um: float = Field(default=0.2, ge=0.0, le=10.0)


class ReversalSettings(Strict):
    """Lost motion of the linear axes when they turn round, on the datum ball: `touches` from either side at each of two
    places an axis. Above `limit_um` a warning; surely beyond it the run goes on, or with `stop` ends."""

    enabled: bool = True
    touches: int = Field(default=2, ge=1, le=20)
    limit_um: PositiveFloat = 10.0
    on_excess: Literal["warn", "stop"] = "warn"


class IdentificationSettings(Strict):
    """`order` of the Legendre series: for which the measurements speak, that of the machine file, or a number."""

    formulation: Literal["centres", "distances"] = "centres"
    prior: bool = True
    weights: Literal["full", "unit"] = "full"
    order: Order = "evidence"


class TableSettings(Strict):
    """Grid and anchor of the compensation table. `anchor_mm`: where the correction is zero (axis positions)."""

    step_mm: Coordinates = (100.0, 100.0, 100.0)
    anchor_mm: Coordinates | None = None


class GateSettings(Strict):
    largest_chi2: PositiveFloat = 2.0
    smallest_freedom: PositiveInt = 30
    largest_remaining_share: float = Field(default=0.5, gt=0.0, le=1.0)
    largest_correction_um: PositiveFloat = 300.0
    largest_slope_um_per_mm: PositiveFloat = 0.5
    largest_change: PositiveFloat = 3.0
    allow_extrapolation: bool = False


class VerificationSettings(Strict):
    """Held-out positions: measured before and after at these stations, never used for the estimate."""

    positions_deg: list[Angles] = Field(default=[(30.0, 30.0), (-30.0, -30.0)], min_length=1)
    stations: list[PositiveInt] | None = None
    largest_chi2: PositiveFloat = 2.0
    largest_share: float = Field(default=0.8, gt=0.0, le=1.0)


class TimingSettings(Strict):
    """What must be known to predict the machine time; the axes' figures are the machine file's.

    Speed and acceleration are the mount's. The latencies come on top of the motion of each command; that of a turn
    includes the mount's settling. The simulated operator carries the artefact in no time.
    """

    speed_deg_per_s: PositiveFloat = 20.0
    acceleration_deg_per_s2: PositiveFloat = 40.0
    command_latency_s: float = Field(default=0.0, ge=0.0, le=60.0)
    touch_latency_s: float = Field(default=0.0, ge=0.0, le=60.0)
    turn_latency_s: float = Field(default=0.0, ge=0.0, le=600.0)
    carrying_minutes: float = Field(default=0.0, ge=0.0, le=600.0)


class NightlySettings(Strict):
    """Nights after a full calibration: what `verify` and `nightly` measure, and when a machine is another one.

    `held_out` positions of `verification.positions_deg` are measured first, and again with a new table; `looked_at`
    designed ones belong to the verification too. `drift_um`: rms field by which the machine may change a night, shaped
    like its family; `scale_drift_um_per_m`: besides, of the scale of each axis. Out of limits: normalised χ² of what
    was predicted above `largest_chi2`; one error that jumped, with at least `step_evidence` (ln of the likelihood
    ratio); VE now above `largest_growth` times that after the last accepted night.
    """

    slot_minutes: PositiveFloat = Field(default=15.0, le=1440.0)
    reserve_minutes: float = Field(default=0.5, ge=0.0, le=60.0)
    held_out: PositiveInt = 1
    looked_at: PositiveInt = 2
    grid_deg: PositiveFloat = Field(default=45.0, le=45.0)
    drift_um: float = Field(default=0.15, ge=0.0, le=100.0)
    scale_drift_um_per_m: float = Field(default=0.4, ge=0.0, le=100.0)
    largest_chi2: PositiveFloat = 2.0
    step_evidence: PositiveFloat = 8.0
    largest_growth: float = Field(default=2.0, ge=1.0)
    smallest_gain: float = Field(default=0.02, ge=0.0, lt=1.0)
    full_allowed: bool = False


class PreflightSettings(Strict):
    """The plugin that plays the machine in the dry run."""

    driver: Name = "simulated"


class Settings(Strict):
    """Everything about one machine and its procedure."""

    machine: Path
    artefact: Path
    tool: Name = "probe"
    state_directory: Path = Path("state")
    clock: ClockSettings = ClockSettings()
    devices: dict[Name, DeviceSettings]
    roles: RoleSettings
    mount: Annotated[MountGeometry, refuse_unknown(MountGeometry)] = MountGeometry()
    probe: Annotated[ProbeGeometry, refuse_unknown(ProbeGeometry)] = ProbeGeometry()
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
        """The same with every path made absolute, starting from `base`."""
        paths = {name: (base / getattr(self, name)).resolve() for name in ("machine", "artefact", "state_directory")}
        doors = {name: getattr(self, name).resolved(base) for name in ("service", "gateway", "opcua", "history")}
        return self.model_copy(update={**paths, **doors, "stations": self.stations.resolved(base)})


def parse_settings(text: str, source: str) -> Settings:
    """Settings from TOML text; FormatError names file, key and what is known there."""
    return read_toml(text, source, Settings)
