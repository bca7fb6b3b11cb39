"""The case that studies and design look at: a machine with an artefact before it; no device is asked."""

from __future__ import annotations

from pathlib import Path

import agent
from agent.files import load_artefact, load_machine
from agent.planning.job import Job, prepare_job
from agent.settings.load import load_settings, naming
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError
from twin.artefact.position_set import station_places
from twin.errors import DataError

SHIPPED = Path(agent.__file__).resolve().parents[1] / "config"
CASE_STUDY = SHIPPED / "case-study.toml"


def load_case(
    config: Path,
    *,
    machine: Path | None = None,
    artefact: Path | None = None,
    stations: int | None = None,
    tool: str | None = None,
) -> Job:
    """The job of a settings file, with another machine or artefact file, with `stations` places evenly along X, or with
    another of the machine's tools.

    Raises ConfigurationError naming file and key.
    """
    with naming(config):
        settings = load_settings(config)
        chosen: dict[str, object] = {}
        if machine is not None:
            chosen["machine"] = machine.resolve()
        if artefact is not None:
            chosen["artefact"] = artefact.resolve()
        if tool is not None:
            chosen["tool"] = tool
        settings = settings.model_copy(update=chosen)
        if stations is not None:
            settings = _with_stations(settings, stations)
        return prepare_job(settings, config.resolve().parent)


def _with_stations(settings: Settings, count: int) -> Settings:
    """`count` places at the depth and height of the first one of the settings, the outer ones a bar's half inside."""
    machine, artefact = load_machine(settings.machine), load_artefact(settings.artefact)
    _, y_mm, z_mm = settings.stations.places_mm[0]
    half_span_mm = artefact.half_length_mm + settings.mount.bar_overhang_mm
    try:
        places = station_places(count, machine.limits[0], half_span_mm, y_mm, z_mm)
    except DataError as error:
        raise ConfigurationError(error.message, hint=error.hint, key="stations") from error
    stations = settings.stations.model_copy(
        update={"places_mm": [(x, y, z) for x, y, z in places.tolist()], "standing_at": None}
    )
    verification = settings.verification.model_copy(update={"stations": None})
    procedure = settings.procedure.model_copy(update={"stations": None})
    return settings.model_copy(update={"stations": stations, "verification": verification, "procedure": procedure})
