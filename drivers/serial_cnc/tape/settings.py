"""Settings of the punch/read line."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class TapeSettings(BaseModel):
    """The defaults are those that the controller's manuals give: 4800 baud, eight bits with parity among them, two stop
    bits."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    port: str = Field(min_length=1)
    baud: int = Field(default=4800, ge=50, le=115200)
    stop_bits: Literal[1, 2] = 2
    operator_within_s: Seconds = Field(default=300.0, description="until READ or PUNCH is pressed at the controller")
    stopped_within_s: Seconds = Field(default=60.0, description="how long the controller may keep a DC3 standing")
    silent_within_s: Seconds = Field(default=10.0, description="within a tape, from one character to the next")
    longest_tape: int = Field(default=1_000_000, ge=100, description="characters")
