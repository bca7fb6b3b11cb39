"""Jobs for simulation studies and for the design of position sets, and the cases that are shipped with volcal.

A job is a calibration prepared from a settings file; no device is contacted. A shipped case is a machine with its
settings file and the scenario of its simulator.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from agent.files import translated
from agent.model_files import load_artefact, load_machine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.settings.load import load_settings, naming
from agent.settings.schema import Settings
from drivers.errors import ConfigurationError, InputError
from twin.artefact.position_set import station_locations
from twin.collision.measuring_layout import station_axis_of
from twin.collision.probe_frame import ProbeFrame
from twin.errors import DataError

# A directory on disk, not an archive member: settings name their machine and artefact files relative to themselves, and
# the simulator reads them in a process of its own. Resolved, because volcal/config is a link in a checkout.
SHIPPED_CONFIGURATION = Path(str(files("volcal") / "config")).resolve()
"""Directory of the shipped configuration: package data of `volcal`."""
CASE_STUDY = SHIPPED_CONFIGURATION / "case-study.toml"


@dataclass(frozen=True)
class ShippedCase:
    """Machine that is shipped with volcal, ready to run: its settings file, which names its machine file and its
    artefact file, and the scenario of its simulator.
    """

    name: str
    settings: Path
    scenario: Path


def shipped_cases() -> dict[str, ShippedCase]:
    """Return the shipped cases by name.

    A case called NAME consists of the settings file `NAME.toml` and the scenario `simulators/NAME.toml` in
    `SHIPPED_CONFIGURATION`. A new case is added by adding these files and the files that they name.
    """
    scenarios = sorted((SHIPPED_CONFIGURATION / "simulators").glob("*.toml"))
    cases = (ShippedCase(path.stem, SHIPPED_CONFIGURATION / path.name, path) for path in scenarios)
    return {case.name: case for case in cases if case.settings.is_file()}


def shipped_case(name: str) -> ShippedCase:
    """Return the shipped case called `name`. Raises InputError, which lists the shipped cases, if there is none."""
    cases = shipped_cases()
    if name not in cases:
        raise InputError(f"no case '{name}' is shipped", hint=f"shipped cases: {', '.join(cases)}", key="--case")
    return cases[name]


def load_case(
    config: Path,
    *,
    machine: Path | None = None,
    artefact: Path | None = None,
    stations: int | None = None,
    tool: str | None = None,
) -> Job:
    """Return the job that the settings file `config` describes.

    If `machine`, `artefact` or `tool` is given, it replaces the machine file, the artefact file or the tool of the
    settings. If `stations` is given, the stations of the settings are replaced by this number of stations, spaced
    evenly along the axis on which the stations stand.

    Raises ConfigurationError, which names the file and the key, if the settings cannot be used.
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
    """Return the settings with `count` stations spaced along the station axis (the horizontal axis across the stylus
    along which stations stand). The other coordinates are those of the first station in `settings`. The distance of the
    outer stations from the ends of the travel is half of the artefact's length, with the overhang of a bar."""
    machine, artefact = load_machine(settings.machine), load_artefact(settings.artefact)
    with translated(ConfigurationError, key="tool"):
        frame = ProbeFrame.nearest(machine.tool(settings.tool))
    travel, stated = np.array(machine.limits), settings.stations.places_mm
    along = station_axis_of(frame, stated, np.ptp(travel, axis=1))
    first, second = np.delete(stated[0], along).tolist()
    try:
        places = station_locations(count, machine.limits[along], artefact.half_span_mm, first, second, along)
    except DataError as error:
        raise ConfigurationError(error.message, hint=error.hint, key="stations") from error
    stations = settings.stations.model_copy(
        update={"places_mm": [(x, y, z) for x, y, z in places.tolist()], "standing_at": None}
    )
    verification = settings.verification.model_copy(update={"stations": None})
    procedure = settings.procedure.model_copy(update={"stations": None})
    return settings.model_copy(update={"stations": stations, "verification": verification, "procedure": procedure})
