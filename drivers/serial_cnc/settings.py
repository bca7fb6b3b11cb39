"""Settings of driver `serial-cnc`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from drivers.options import DriverOptions

Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]
Triple = tuple[float, float, float]


class BankSettings(DriverOptions):
    """Settings for the files that hold the compensation tables, since the controller stores no tables.

    A relative `directory` is relative to the settings file.
    """

    directory: Path = Path("banks")
    resolution_mm: float = Field(default=1e-4, ge=1e-6, le=1e-2)
    max_correction_mm: float = Field(default=1.0, gt=0.0, le=10.0)
    max_nodes: Annotated[int, Field(ge=2, le=1000)] = 200
    max_total_nodes: Annotated[int, Field(ge=8, le=1_000_000)] = 100_000


class SerialCncSettings(DriverOptions):
    """Settings of driver `serial-cnc`."""

    port: str = Field(
        min_length=1, description="for example /dev/serial/by-id/…, which does not change if others are plugged in"
    )
    baud: int = Field(default=115200, ge=1200, le=4_000_000)
    axis_zero_mm: Triple = Field(
        default=(0.0, 0.0, 0.0),
        description="machine coordinates (MPos) at which the axes of the machine file read 0",
    )
    manual_referencing: bool = Field(
        default=False, description="without homing switches: a person sets the axes to their marks and is responsible"
    )

    restarts_when_opened: bool = Field(
        default=True,
        description="false: the board does not restart when its port is opened, so it can be read between runs",
    )
    response_timeout_s: Annotated[float, Field(gt=0.0, le=30.0)] = Field(
        default=2.0, description="wall time for an answer that comes at once"
    )
    boot_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)] = Field(
        default=6.0, description="wall time for the first answer; many boards restart when the port is opened"
    )
    retries: int = Field(default=2, ge=0, le=10, description="status queries sent again after a lost or garbled one")
    receive_buffer: int = Field(
        default=128, ge=80, le=65536, description="size of the controller's receive buffer in bytes"
    )
    poll_interval_s: float = Field(default=0.4, gt=0.0, le=0.5, description="between two status queries in motion")
    touch_poll_interval_s: float = Field(default=0.2, gt=0.0, le=0.5)
    fine_poll_interval_s: float = Field(default=0.01, gt=0.0, le=0.5, description="near the end of a wait")
    motion_margin_s: Seconds = Field(default=5.0, description="on top of 1.5 times the predicted duration")
    initial_motion_timeout_s: Seconds = Field(
        default=30.0, description="for a motion still in progress when the device opens"
    )
    homing_timeout_s: Seconds = Field(default=1200.0, description="longest homing ($H) of all axes")
    max_hold_s: Seconds = Field(default=600.0, description="longest wait for the release of a feed hold")
    latch_tolerance_mm: float = Field(
        default=1.0, gt=0.0, description="largest distance of a latched position from its path"
    )
    position_tolerance_mm: float = Field(default=0.02, gt=0.0, description="largest distance of the axes from a target")
    release_distance_mm: float = Field(
        default=5.0, gt=0.0, le=50.0, description="distance within which a deflected probe must come free on withdrawal"
    )
    declared_temperatures_c: dict[str, Annotated[float, Field(ge=-50.0, le=100.0)]] = Field(
        default_factory=dict, description="entered by a person; the controller has no sensor"
    )
    banks: BankSettings = BankSettings()
