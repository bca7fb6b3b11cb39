"""Settings of a CANopen rotary mount. Unknown keys are errors."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from drivers.canopen_mount.scale import INT32_MAX, AxisScale
from drivers.options import DriverOptions


class HomingSettings(DriverOptions):
    """Settings of the CiA 402 homing mode, for an encoder that loses its position when the power is switched off."""

    method: int = Field(ge=1, le=127, description="object 0x6098, for example 37: present position is zero")
    search_speed_deg_per_s: float = Field(default=5.0, gt=0.0, le=360.0, description="0x6099:01")
    latch_speed_deg_per_s: float = Field(default=1.0, gt=0.0, le=360.0, description="0x6099:02")
    acceleration_deg_per_s2: float = Field(default=20.0, gt=0.0, le=10_000.0, description="0x609A")
    timeout_s: float = Field(default=120.0, gt=0.0, le=3600.0)


ComparedFactor = Literal["encoder", "gear", "feed", "polarity"]


class UnitSettings(DriverOptions):
    """Position unit of a drive, and the factors in the drive that must agree with this unit (CiA 402-2)."""

    position: Literal["increments", "feed"] = Field(
        default="increments", description="encoder increments, or the feed units per turn of the mount by 0x6092"
    )
    feed_per_revolution: int | None = Field(
        default=None, gt=0, description="position units per turn of the mount, 0x6092:01 / 0x6092:02"
    )
    compare: tuple[ComparedFactor, ...] | None = Field(
        default=None,
        description="factors to compare; default: encoder and polarity, with feed units also gear and feed",
    )
    polarity: int = Field(default=0, ge=0, le=255, description="expected 0x607E; bit 7 reverses positions")
    unit_code: int | None = Field(default=None, ge=0, lt=2**32, description="expected 0x60A8, if the drive has it")
    velocity_unit_code: int | None = Field(
        default=None, ge=0, lt=2**32, description="expected 0x60A9; speeds are sent in position units per second"
    )
    write: bool = Field(default=False, description="write differing values when the mount opens, instead of refusing")

    @property
    def compared(self) -> tuple[ComparedFactor, ...]:
        if self.compare is not None:
            return self.compare
        return ("encoder", "polarity") if self.position == "increments" else ("encoder", "gear", "feed", "polarity")

    @model_validator(mode="after")
    def _feed_belongs_to_its_unit(self) -> Self:
        if (self.position == "feed") is not (self.feed_per_revolution is not None):
            raise ValueError('set feed_per_revolution together with position = "feed", and only then')
        if "feed" in self.compared and self.feed_per_revolution is None:
            raise ValueError('"feed" can be compared only if feed_per_revolution is set')
        return self


class AxisSettings(DriverOptions):
    """Settings of one axis: its drive, and the gear between the motor and the mount."""

    node_id: int = Field(ge=1, le=127)
    encoder_counts_per_revolution: int = Field(gt=0, description="increments per turn of the motor")
    gear_motor_revolutions: int = Field(default=1, gt=0, description="motor turns, as in 0x6091:01 ...")
    gear_shaft_revolutions: int = Field(
        default=1, gt=0, description="... per this number of turns of the mount, 0x6091:02"
    )
    direction: Literal[1, -1] = Field(default=1, description="-1 if counts increase as the angle decreases")
    offset_deg: float = Field(default=0.0, ge=-360.0, le=360.0, description="mount angle at zero counts")
    lower_deg: float = Field(ge=-3600.0, le=3600.0)
    upper_deg: float = Field(ge=-3600.0, le=3600.0)
    speed_deg_per_s: float = Field(gt=0.0, le=360.0)
    acceleration_deg_per_s2: float = Field(gt=0.0, le=10_000.0)
    in_position_deg: float = Field(default=0.005, gt=0.0, le=1.0, description="largest distance from target, settled")
    homing: HomingSettings | None = Field(default=None, description="none: the encoder is absolute")
    eds: Path | None = Field(default=None, description="EDS file of the drive; its identity and objects are checked")
    vendor_id: int | None = Field(default=None, ge=0, description="expected 0x1018:01")
    product_code: int | None = Field(default=None, ge=0, description="expected 0x1018:02")
    serial_number: int | None = Field(
        default=None, ge=0, description="expected 0x1018:04, to distinguish two identical drives"
    )
    units: UnitSettings = Field(default_factory=UnitSettings, description="required factors in the drive")

    @property
    def scale(self) -> AxisScale:
        feed = self.units.feed_per_revolution
        if feed is not None:
            return AxisScale(Fraction(feed, 360), self.direction, self.offset_deg)
        return AxisScale.of(
            counts_per_revolution=self.encoder_counts_per_revolution,
            motor_revolutions=self.gear_motor_revolutions,
            shaft_revolutions=self.gear_shaft_revolutions,
            direction=self.direction,
            offset_deg=self.offset_deg,
        )

    @model_validator(mode="after")
    def _limits_fit(self) -> Self:
        if not self.lower_deg < self.upper_deg:
            raise ValueError(f"lower_deg {self.lower_deg} is not below upper_deg {self.upper_deg}")
        furthest = max(abs(self.scale.counts(angle)) for angle in (self.lower_deg, self.upper_deg))
        if furthest > INT32_MAX:
            raise ValueError(f"the limits need {furthest} counts, but object 0x607A holds at most {INT32_MAX}")
        return self


class CanopenMountSettings(DriverOptions):
    """Settings of the driver: bus, drives and time-outs."""

    interface: str = Field(min_length=1, description="python-can interface: socketcan, slcan, socketcand, ...")
    channel: str = Field(min_length=1, description="can0, a serial port, a multicast group, ...")
    options: dict[str, str | int | float | bool] = Field(
        default_factory=dict, description="further python-can options: bitrate, host, port, ..."
    )
    azimuth: AxisSettings
    elevation: AxisSettings
    settle_s: float = Field(default=0.5, ge=0.0, le=60.0, description="rest after both axes are in position")
    in_position_timeout_s: float = Field(
        default=3.0, gt=0.0, le=60.0, description="time limit to come to rest in the window"
    )
    turn_margin_s: float = Field(
        default=5.0, gt=0.0, le=600.0, description="on top of 1.5 times the predicted duration"
    )
    sdo_timeout_s: float = Field(default=0.3, ge=0.01, le=5.0, description="wall time for one SDO answer")
    heartbeat_ms: int = Field(default=500, ge=0, le=32_000, description="0x1017 of the drives; 0: not monitored")
    heartbeat_timeout_s: float = Field(default=2.0, gt=0.0, le=120.0)
    tolerated_emergencies: tuple[Annotated[int, Field(ge=1, le=0xFFFF)], ...] = Field(
        default=(), description="EMCY error codes that are logged and do not stop the mount"
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.azimuth.node_id == self.elevation.node_id:
            raise ValueError(f"azimuth and elevation both have node id {self.azimuth.node_id}")
        if self.interface == "slcan" and not {"bitrate", "btr"} & set(self.options):
            raise ValueError("slcan needs a bit rate to open its channel: set options.bitrate")
        if self.heartbeat_ms and self.heartbeat_timeout_s < 2e-3 * self.heartbeat_ms:
            raise ValueError(
                f"heartbeat_timeout_s {self.heartbeat_timeout_s} is less than two periods of {self.heartbeat_ms} ms"
            )
        return self
