"""Settings of the compensation in LinuxCNC: its method, and the directory of its tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from drivers.options import DriverOptions


class CompensationSettings(DriverOptions):
    """Compensation method and options for the tables.

    The INI and HAL files of the machine must be set up for the same method.
    """

    method: Literal["external-offsets", "kinematics", "comp-files"] = Field(
        description="method whose HAL and INI fragments the machine loads"
    )
    directory: Path = Field(description="[VOLCAL]DIRECTORY of the INI file; a local directory shared with LinuxCNC")
    resolution_um: Annotated[float, Field(ge=0.001, le=10.0)] = Field(default=0.1, description="one count of a table")
    max_correction_mm: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0
    accepted_loss_um: Annotated[float, Field(ge=0.0, le=1000.0)] = Field(
        default=0.0,
        description="comp-files: largest part of a correction that may be lost at any node",
    )
    timeout_s: Annotated[float, Field(gt=0.0, le=600.0)] = Field(
        default=10.0, description="for one step: a table loaded, a bank active and settled"
    )
