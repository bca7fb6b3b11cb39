"""Settings of a LinuxCNC machine. Limits, units and periods are read from LinuxCNC itself."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.linuxcnc.compensation.settings import CompensationSettings
from drivers.options import DriverOptions
from drivers.roles import Permission

PinName = Annotated[str, Field(min_length=1, max_length=47, pattern=r"^[A-Za-z0-9_.:-]+$")]
"""Name of a HAL pin, signal or parameter; at most 47 characters."""
Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class PermissionPins(DriverOptions):
    """HAL pins of type bit that are true while the machine may be moved.

    A permission without a configured pin follows from the state of LinuxCNC. If LinuxCNC does not report this state,
    the permission counts as granted.
    """

    automatic: PinName | None = Field(default=None, description="if unset: the machine is on")
    doors_closed: PinName | None = Field(default=None, description="if unset: taken as granted")
    spindle_stopped: PinName | None = Field(default=None, description="if unset: no spindle of LinuxCNC is on")
    consent: PinName | None = Field(default=None, description="if unset: taken as granted")

    def named(self) -> dict[Permission, str]:
        """Return the names of the configured HAL pins, keyed by permission."""
        return {Permission[name.upper()]: pin for name, pin in self if pin is not None}


class LinuxCncSettings(DriverOptions):
    """Settings of the driver `linuxcnc`."""

    bridge_command: tuple[str, ...] = Field(
        default=("/usr/bin/python3",),
        min_length=1,
        description="Python interpreter with the modules linuxcnc and hal, preceded by a wrapper command if needed",
    )
    machine_name: str | None = Field(default=None, description="expected [EMC]MACHINE; any other is refused")
    response_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)] = 3.0
    watchdog_timeout_s: float = Field(
        default=2.0, ge=0.0, le=60.0, description="silence after which the bridge stops a motion"
    )
    heartbeat_timeout_s: float = Field(
        default=0.8, ge=0.1, le=60.0, description="without a heartbeat, LinuxCNC's task or motion counts as stopped"
    )
    poll_interval_s: float = Field(
        default=0.02, gt=0.0, le=0.5, description="between two status queries during a motion"
    )
    motion_margin_s: Seconds = Field(default=5.0, description="on top of 1.5 times the predicted duration")
    position_tolerance_mm: float = Field(
        default=0.05,
        gt=0.0,
        le=10.0,
        description="largest distance of each axis from its target at the end of a motion",
    )
    max_hold_s: Seconds = Field(default=600.0, description="longest wait for the release of a hold")
    homing: Literal["refuse", "absolute-encoders"] = Field(
        default="refuse", description="absolute-encoders: home on opening if that moves nothing"
    )
    homing_timeout_s: Seconds = 120.0

    permissions: PermissionPins = PermissionPins()
    probe_tool: int | None = Field(default=None, ge=0, description="number of the probe in the tool table")
    probe_healthy: PinName | None = Field(default=None, description="HAL bit: battery and link of the probe")
    latch_cycles: float = Field(
        default=0.5, ge=0.0, le=10.0, description="servo cycles from the trip to the latched position, on average"
    )
    probe_delay_s: float = Field(
        default=0.0, ge=0.0, le=0.1, description="delay of the probe's signal, for example by a debounce"
    )
    latch_tolerance_mm: float = Field(
        default=1.0, gt=0.0, description="largest distance of a latched position from the path"
    )
    compensation: CompensationSettings | None = Field(default=None, description="none: the device is not a store")
    temperatures: dict[str, PinName] = Field(default_factory=dict, description="name → HAL float in °C")

    def pins(self) -> tuple[str, ...]:
        """Return the names of the HAL pins that are read with every snapshot of the state of LinuxCNC."""
        healthy = () if self.probe_healthy is None else (self.probe_healthy,)
        return (*self.permissions.named().values(), *healthy)
