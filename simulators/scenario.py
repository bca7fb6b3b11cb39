"""Scenario of a simulation, given as a TOML file or as the same keys in the settings. Unknown keys are refused.

If a value has a unit, the name of its key ends with this unit. If a section (`[truth]`, `[mount]`, …) is missing, its
defaults apply. `ideal = true` removes every error, as for a preflight.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, model_validator

from drivers.errors import ConfigurationError
from simulators.temperatures import Coordinates, ThermalSettings
from twin.artefact.artefact import Artefact
from twin.artefact.mount_geometry import MountGeometry, without_mount
from twin.collision.probe_frame import ProbeFrame
from twin.collision.probe_geometry import ProbeGeometry, ProbeSection
from twin.errors import TwinError
from twin.formats.artefact_file import parse_artefact
from twin.formats.machine_file import parse_machine
from twin.formats.toml_reading import StrictModel, forbid_unknown_keys, read_toml
from twin.immutable import Immutable
from twin.machine.machine_description import MachineDescription

Value = TypeVar("Value")


class TruthSettings(StrictModel):
    """Settings for the true errors of the simulated machine, which are drawn from the machine family.

    `scale` multiplies the error amplitudes of the family.
    """

    seed: int = Field(default=21, ge=0)
    legendre_order: int = Field(default=7, ge=0, le=20)
    scale: NonNegativeFloat = 1.0
    deflection: bool = True


class ArtefactTruthSettings(StrictModel):
    """Deviation of the true artefact from its calibration certificate.

    `certificate_error` is in units of the certificate's standard uncertainties, and `cte_error` is in units of the
    standard uncertainty of the coefficient of thermal expansion (CTE).
    """

    seed: int = Field(default=4, ge=0)
    certificate_error: NonNegativeFloat = 1.0
    cte_error: NonNegativeFloat = 1.0


class TriggerSettings(StrictModel):
    """Trip behaviour of the probe.

    `lobing_um` is the amplitude in µm of a pretravel variation with three lobes around the stylus. `latch_delay_ms` is
    the time in ms between the trip and the storing (latching) of the axis positions.
    """

    pretravel_um: NonNegativeFloat = 8.0
    lobing_um: NonNegativeFloat = 0.5
    touch_sigma_um: NonNegativeFloat = 1.0
    overtravel_mm: PositiveFloat = 6.0
    latch_delay_ms: NonNegativeFloat = 0.0


class AxisBehaviour(StrictModel):
    """Errors of the axis positions after a motion: repeatability of every axis, and backlash; and of their zero.

    Half of the backlash acts against the direction of the last motion. `backlash_um` is one value for all axes, or one
    value each for X, Y and Z, and applies at axis position 0. `backlash_growth_um_per_m` is the increase of the
    backlash per metre of each axis' own travel. `homing_um` is the standard deviation of the displayed zero from homing
    to homing, one value for all axes or one each for X, Y and Z.
    """

    repeatability_um: NonNegativeFloat = 0.2
    backlash_um: NonNegativeFloat | tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat] = 0.2
    backlash_growth_um_per_m: Coordinates = (0.0, 0.0, 0.0)
    homing_um: NonNegativeFloat | tuple[NonNegativeFloat, NonNegativeFloat, NonNegativeFloat] = 0.0

    @property
    def homing_of_axes_um(self) -> Coordinates:
        """Standard deviation of the displayed zero of X, Y, Z from homing to homing, in µm."""
        return self.homing_um if isinstance(self.homing_um, tuple) else (self.homing_um,) * 3

    @property
    def backlash_of_axes_um(self) -> Coordinates:
        """Backlash of X, Y, Z at axis position 0, in µm."""
        return self.backlash_um if isinstance(self.backlash_um, tuple) else (self.backlash_um,) * 3


class MountBehaviour(StrictModel):
    """Errors of the rotary mount and of its placement by hand. They displace the artefact as a rigid body."""

    index_error_deg: NonNegativeFloat = 0.01
    wobble_um: NonNegativeFloat = 20.0
    place_error_mm: NonNegativeFloat = 0.3
    place_error_deg: NonNegativeFloat = 0.03
    speed_deg_per_s: PositiveFloat = 20.0
    acceleration_deg_per_s2: PositiveFloat = 40.0


class Misplacement(StrictModel):
    """Gross error of the person who places the artefact: at the placement number `placement`, counted from 1, it stands
    displaced by `off_mm` and turned about the vertical by `off_deg`.
    """

    placement: PositiveInt
    off_mm: Coordinates = (0.0, 0.0, 0.0)
    off_deg: float = Field(default=0.0, ge=-180.0, le=180.0)


class HandPlacementBehaviour(StrictModel):
    """Errors of a person who places the artefact by hand in every position.

    Each placement is displaced along X and Y by up to `error_mm`, along Z by up to a tenth of it, because the artefact
    is on the table, and turned about the vertical by up to `error_deg`. The placements in `misplaced` are grossly wrong
    in addition.
    """

    error_mm: NonNegativeFloat = 3.0
    error_deg: NonNegativeFloat = 0.5
    misplaced: list[Misplacement] = Field(default_factory=list)


class StoreSettings(StrictModel):
    """Capacity of the controller's compensation banks, and when and with which signs a table is applied."""

    banks: list[PositiveInt] = Field(default=[1, 2], min_length=1)
    max_nodes: tuple[PositiveInt, PositiveInt, PositiveInt] = (64, 64, 64)
    max_total_nodes: PositiveInt = 20000
    resolution_um: PositiveFloat = 0.1
    max_correction_um: PositiveFloat = 1000.0
    activation: Literal["immediate", "reset", "power_cycle", "reference"] = "immediate"
    signs: Literal["as_written", "reversed"] = "as_written"


class AgeingSettings(StrictModel):
    """Change of the machine from night to night.

    `night` is the number of the night to simulate. On night 0, the machine has the errors drawn for it. The scale
    errors of X, Y and Z change as sines with the amplitudes `seasonal_um_per_m`, the phases `phases_deg` and the period
    `season_nights`. All errors also change in a random walk. `walk_um` is the rms over the working volume of the
    deviation that one night of this walk adds. On night `collision_night`, errors jump by the values of `collision`, in
    µm or µrad. Each key of `collision` is the ISO name of an error, such as EXX, and may add the Legendre order of the
    coefficient that jumps, as in EXX[1]. Without an order, the coefficient of the lowest order jumps. They jump before
    the night begins or, if `collision_minute` is given, at this minute of the machine time of the night.
    """

    night: int = Field(default=0, ge=0)
    seed: int = Field(default=7, ge=0)
    seasonal_um_per_m: Coordinates = (0.0, 0.0, 0.0)
    season_nights: PositiveFloat = 90.0
    phases_deg: Coordinates = (0.0, 0.0, 0.0)
    walk_um: NonNegativeFloat = 0.0
    collision_night: PositiveInt | None = None
    collision_minute: PositiveFloat | None = None
    collision: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _check_minute(self) -> Self:
        if self.collision_minute is not None and self.collision_night is None:
            raise ValueError("collision_minute needs collision_night, the night to which it belongs")
        return self


class ScenarioDocument(StrictModel):
    """Keys of a scenario.

    `start_mm` gives the axis positions at the start; by default these are the lower ends of travel, with the stylus
    withdrawn to the end of travel from which it points away. `mounts_deg` gives azimuth and elevation of each mount at
    the start, by default zero.

    If `own_mounts` is False, one mount is moved together with the artefact. If `own_mounts` is True, every station has
    its own mount. In this case `artefacts` may give one artefact for each station; otherwise one artefact is moved from
    mount to mount.

    If `placed_by_hand` is given, there is no mount: a person places the artefact in every position. Until the first
    placement it is not on the machine.

    If `noise_by_step` is True, noise depends on the step tag (a number that identifies the step) that an agent sends
    with a motion, and a repeated step has the same noise. Otherwise, noise depends on the number of the motion.
    """

    machine: Path
    artefact: Path
    tool: str = "probe"
    seed: int = Field(default=1, ge=0)
    noise_by_step: bool = False
    ideal: bool = False
    stations_mm: list[Coordinates] = Field(min_length=1)
    standing_at: PositiveInt = 1
    own_mounts: bool = False
    artefacts: list[Path] = Field(default_factory=list)
    placed_by_hand: HandPlacementBehaviour | None = None
    mounts_deg: list[tuple[float, float]] = Field(default_factory=list)
    start_mm: Coordinates | None = None
    mount: Annotated[MountGeometry, forbid_unknown_keys(MountGeometry)] = MountGeometry()
    probe: Annotated[ProbeSection, forbid_unknown_keys(ProbeSection)] = ProbeSection()
    truth: TruthSettings = TruthSettings()
    artefact_truth: ArtefactTruthSettings = ArtefactTruthSettings()
    trigger: TriggerSettings = TriggerSettings()
    axes: AxisBehaviour = AxisBehaviour()
    mount_behaviour: MountBehaviour = MountBehaviour()
    temperatures: ThermalSettings = ThermalSettings()
    store: StoreSettings = StoreSettings()
    ageing: AgeingSettings = AgeingSettings()

    @model_validator(mode="before")
    @classmethod
    def _without_mount(cls, document: Any) -> Any:
        """Remove the parts of the mount from the geometry if the artefact is placed by hand."""
        if not isinstance(document, dict) or document.get("placed_by_hand") is None:
            return document
        section = document.get("mount", {})
        return {**document, "mount": without_mount(section)} if isinstance(section, dict) else document


@dataclass(frozen=True)
class Scenario(Immutable):
    """Scenario with the contents of the files that it names.

    `artefacts` holds one artefact for each station if each station has its own, and is empty otherwise.
    """

    settings: ScenarioDocument
    machine: MachineDescription
    artefact: Artefact
    artefacts: tuple[Artefact, ...] = ()

    def __post_init__(self) -> None:
        settings = self.settings
        self._refuse_mounts_that_do_not_fit()
        if settings.standing_at > len(settings.stations_mm):
            raise ConfigurationError(
                f"the artefact stands at station {settings.standing_at} of {len(settings.stations_mm)}",
                key="standing_at",
            )
        for axis, value, (low, high) in zip("XYZ", settings.start_mm or (), self.machine.limits, strict=False):
            if not low <= value <= high:
                raise ConfigurationError(f"{axis} {value:g} mm is outside {low:g} to {high:g}", key="start_mm")
        offset = _read(settings.machine, lambda: self.machine.tool(settings.tool))
        frame = _read(settings.machine, lambda: ProbeFrame.of(offset))
        reach_mm = _read(settings.machine, lambda: self.probe).reach_mm
        if frame.sign * offset[frame.axis] < reach_mm:
            raise ConfigurationError(
                f"tool '{settings.tool}' {offset.tolist()} must be at least as long as the probe",
                hint=f"probe.reach_mm is {reach_mm}",
                key="tool",
            )

    @property
    def frame(self) -> ProbeFrame:
        """Probe frame, which gives the direction in which the stylus points."""
        return ProbeFrame.of(self.machine.tool(self.settings.tool))

    @property
    def probe(self) -> ProbeGeometry:
        """Dimensions of the probe; those that the scenario does not state follow from the tool."""
        return self.settings.probe.geometry(float(self.machine.tool(self.settings.tool) @ self.frame.stylus_axis))

    @property
    def start_mm(self) -> Coordinates:
        """Axis positions in mm at the start."""
        return self.settings.start_mm or self.frame.withdrawn_corner(self.machine.limits)

    @property
    def mount_count(self) -> int:
        """Number of rotary mounts of the simulated machine; 0 if the artefact is placed by hand."""
        if self.settings.placed_by_hand is not None:
            return 0
        return len(self.settings.stations_mm) if self.settings.own_mounts else 1

    def _refuse_mounts_that_do_not_fit(self) -> None:
        settings, stations = self.settings, len(self.settings.stations_mm)
        if settings.placed_by_hand is not None and settings.own_mounts:
            raise ConfigurationError("an artefact that is placed by hand has no mount", key="own_mounts")
        if self.artefacts and not settings.own_mounts:
            raise ConfigurationError("artefacts at the stations need own_mounts = true", key="artefacts")
        if self.artefacts and len(self.artefacts) != stations:
            raise ConfigurationError(f"{len(self.artefacts)} artefacts for {stations} stations", key="artefacts")
        if len({artefact.ball_diameter_mm for artefact in (self.artefact, *self.artefacts)}) > 1:
            raise ConfigurationError("the balls of all artefacts must have one diameter", key="artefacts")
        if settings.mounts_deg and len(settings.mounts_deg) != self.mount_count:
            raise ConfigurationError(
                f"{len(settings.mounts_deg)} angles for {self.mount_count} mounts", key="mounts_deg"
            )

    def without_errors(self) -> Scenario:
        """Return the scenario without any error, as used for a preflight."""
        return dataclasses.replace(self, settings=ideal_document(self.settings))


def read_scenario(path: Path) -> Scenario:
    """Return the scenario in a TOML file. Paths in the file are relative to the directory of the file.

    Raises ConfigurationError if a file is invalid.
    """
    document = _read(path, lambda: read_toml(_text(path), str(path), ScenarioDocument))
    return build_scenario(document, path.parent)


def build_scenario(document: ScenarioDocument, base: Path) -> Scenario:
    """Return the scenario that `document` describes, with the contents of the files that it names.

    Relative paths in `document` are relative to the directory `base`.
    """
    machine = base / document.machine
    return Scenario(
        ideal_document(document) if document.ideal else document,
        _read(machine, lambda: parse_machine(_text(machine), str(machine), _beside(machine))),
        _artefact(base / document.artefact),
        tuple(_artefact(base / name) for name in document.artefacts),
    )


def ideal_document(document: ScenarioDocument) -> ScenarioDocument:
    """Return a copy of `document` without any error of machine, probe, mount or artefact, and with constant
    temperatures.
    """
    return document.model_copy(
        update={
            "ideal": True,
            "artefact_truth": ArtefactTruthSettings(certificate_error=0.0, cte_error=0.0),
            "trigger": document.trigger.model_copy(
                update={"pretravel_um": 0.0, "lobing_um": 0.0, "touch_sigma_um": 0.0}
            ),
            "axes": AxisBehaviour(repeatability_um=0.0, backlash_um=0.0),
            "mount_behaviour": document.mount_behaviour.model_copy(
                update=dict.fromkeys(("index_error_deg", "wobble_um", "place_error_mm", "place_error_deg"), 0.0)
            ),
            "placed_by_hand": None
            if document.placed_by_hand is None
            else HandPlacementBehaviour(error_mm=0.0, error_deg=0.0),
            "temperatures": ThermalSettings(),
        }
    )


def _artefact(path: Path) -> Artefact:
    return _read(path, lambda: parse_artefact(_text(path), str(path), _beside(path)))


def _read(path: Path, reading: Callable[[], Value]) -> Value:
    try:
        return reading()
    except TwinError as error:
        raise ConfigurationError(error.message, hint=error.hint, **{"file": str(path), **error.where}) from None


def _beside(path: Path) -> Callable[[str], str]:
    return lambda name: _text(path.parent / name)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigurationError(f"cannot be read: {error}", file=str(path)) from None
