"""Request for a run. The HTTP body, the panel gateway, OPC UA and the command line all use this type, which is
validated when it is created."""

from __future__ import annotations

from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt

from agent.files import translated
from agent.runs.run_kinds import KindName
from drivers.errors import InputError, UserError
from twin.formats.toml_reading import validate_document

Source = Literal["timer", "page", "panel", "opc ua", "command line"]
"""Source of a request; journaled with the run."""
SOURCES: tuple[Source, ...] = get_args(Source)


class RunRequest(BaseModel):
    """Request for a run. If a field is None, its value is taken from the settings.

    `position_set` is a name, never a path, so that an endpoint cannot choose which file the agent opens. `consent` is
    True if a person stands at the machine and has confirmed that the machine may move. A timer never has consent; the
    agent then decides from permissions, permitted hours and warm-up alone. `full_allowed` is True if a nightly run may
    become a full calibration.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: KindName
    source: Source
    position_set: str | None = Field(default=None, max_length=100, pattern=r"^[A-Za-z0-9_+][A-Za-z0-9_+. -]*$")
    stations: list[PositiveInt] | None = Field(default=None, min_length=1, max_length=100)
    slot_minutes: PositiveFloat | None = Field(default=None, le=1440.0)
    full_allowed: bool | None = None
    consent: bool = False

    @property
    def single_station(self) -> int | None:
        """Requested station of a run that measures at one station, or None. Raises UserError if the request names
        several stations."""
        stations = self.stations or []
        if len(stations) > 1:
            raise UserError(
                f"{self.kind} measures at one station, {len(stations)} were named",
                hint="name the station at which the artefact stands",
            )
        return stations[0] if stations else None


def run_request(**fields: object) -> RunRequest:
    """Return the request with the given fields. Raise InputError, which names the field, if a value is not
    permitted."""
    with translated(InputError):
        return validate_document(fields, "request", RunRequest)
