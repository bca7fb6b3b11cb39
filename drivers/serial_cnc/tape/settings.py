"""Settings of the serial line for punching and reading tapes."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from drivers.options import DriverOptions

Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class TapeSettings(DriverOptions):
    """Settings of the serial line for tapes.

    The defaults are those of the FANUC manuals: 4800 baud, eight bits including parity, two stop bits.
    """

    port: str = Field(min_length=1)
    baud: int = Field(default=4800, ge=50, le=115200)
    stop_bits: Literal[1, 2] = 2
    operator_timeout_s: Seconds = Field(default=300.0, description="until READ or PUNCH is pressed at the controller")
    max_pause_s: Seconds = Field(default=60.0, description="longest pause that the controller may request by DC3")
    character_timeout_s: Seconds = Field(default=10.0, description="longest gap between two characters of a tape")
    max_tape_length: int = Field(default=1_000_000, ge=100, description="characters")
