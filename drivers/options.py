"""Base class for the options of a driver plugin."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class DriverOptions(BaseModel):
    """Base class for the options of a driver and for the sections of these options.

    Instances are immutable. An unknown key is an error.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
