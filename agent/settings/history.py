"""Where history is kept, and from when on a trend is worth an alarm."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, PositiveFloat, PositiveInt

from twin.formats.toml_reading import Strict

Error = Annotated[str, Field(pattern=r"^[A-Z0-9_]{2,8}(\[[a-z0-9]+\])?$")]


class HistorySettings(Strict):
    """`url`: of the database for all machines of a plant (SQLAlchemy's form, no password in it); a SQLite file in the
    state directory where none is named. `credentials_file`: its password, one line. `machine`: the name in history; the
    settings' machine file where none is given.

    Tolerances in µm, of parameters (a whole error as EXX, a coefficient as EXX[1]) in µm or µrad; an alarm is raised
    where a trend will leave its tolerance within `warn_nights`.
    """

    url: str | None = None
    credentials_file: Path | None = None
    machine: str | None = Field(default=None, min_length=1, max_length=100)
    timeout_s: PositiveFloat = Field(default=5.0, le=60.0)
    warn_nights: PositiveInt = Field(default=14, le=365)
    ve_tolerance_um: PositiveFloat | None = None
    held_out_tolerance_um: PositiveFloat | None = None
    parameter_tolerances: dict[Error, PositiveFloat] = Field(default={})

    def resolved(self, base: Path) -> Self:
        """The same with its path made absolute, starting from `base`."""
        if self.credentials_file is None:
            return self
        return self.model_copy(update={"credentials_file": (base / self.credentials_file).resolve()})
