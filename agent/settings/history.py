"""Section `[history]` of the settings file: database of the run history, and tolerances of trend alarms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PositiveFloat, PositiveInt

from twin.formats.toml_reading import StrictModel

Error = Annotated[str, Field(pattern=r"^[A-Z0-9_]{2,8}(\[[a-z0-9]+\])?$")]


class HistorySettings(StrictModel):
    """Settings of the run history.

    - `url` is the database URL without password (SQLAlchemy form), shared by all machines of a plant; by default the
      database is a SQLite file in the state directory.
    - `credentials_file` is a file that contains the password on one line.
    - `machine` is the name of this machine in the history; by default it is the name of the machine file without its
      extension.
    - `ve_bare_tolerance_um` is the tolerance of the VE without a table, in µm: mechanical work on the machine
      is due when it is reached.
    - `ve_tolerance_um` is the tolerance of the volumetric error (VE) with the active compensation table, in µm.
    - `held_out_tolerance_um` is the tolerance of the rms error of held-out balls, in µm.
    - `parameter_tolerances` maps a geometric error (such as EXX) or a coefficient of its Legendre series (such as
      EXX[1]) to its tolerance in µm or µrad.

    - `compact`: finished runs are compacted, except the latest `whole_runs` runs and those that ended less than
      `whole_days` ago. The others can still be read.

    A trend alarm is given if a value will leave its tolerance within `warn_nights` nights with a probability of
    at least `warn_probability`.
    """

    url: str | None = None
    credentials_file: Path | None = None
    machine: str | None = Field(default=None, min_length=1, max_length=100)
    timeout_s: PositiveFloat = Field(default=5.0, le=60.0)
    warn_nights: PositiveInt = Field(default=14, le=365)
    warn_probability: float = Field(default=0.5, ge=0.1, le=0.99)
    ve_bare_tolerance_um: PositiveFloat | None = None
    ve_tolerance_um: PositiveFloat | None = None
    held_out_tolerance_um: PositiveFloat | None = None
    parameter_tolerances: dict[Error, PositiveFloat] = Field(default={})
    compact: bool = True
    whole_runs: int = Field(default=30, ge=1, le=1_000_000)
    whole_days: float = Field(default=30.0, ge=0.0, le=36_500.0)

    def resolved(self, base: Path) -> Self:
        """Return these settings with relative paths resolved against the directory `base`."""
        if self.credentials_file is None:
            return self
        return self.model_copy(update={"credentials_file": (base / self.credentials_file).resolve()})
