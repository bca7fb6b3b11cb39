"""Job and kind of a run, made from the request for the run."""

from __future__ import annotations

from pathlib import Path

from agent.planning.job import Job
from agent.runs.consent import Consent
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.kinds.nightly import Night
from agent.runs.kinds.verify import Verification
from agent.runs.last_latencies import prepare_next_job
from agent.runs.planned_run import Kind
from agent.runs.run_request import RunRequest
from agent.settings.load import with_overrides
from agent.settings.schema import Settings


def job_of(request: RunRequest, settings: Settings, base: Path) -> Job:
    """Return the job for a request. Raises UserError if the request does not fit the machine.

    `base` is the directory to which relative paths refer. A request for a calibration may name stations; the artefact
    is then measured only at these stations. A request for a night may name the station of the artefact. If that night
    makes a full calibration, it uses all stations.
    """
    stations = request.stations if request.kind == "calibrate" else None
    overridden = with_overrides(settings, position_set=request.position_set, stations=stations)
    return prepare_next_job(overridden, base)


def kind_of(request: RunRequest, *, slot_minutes: float | None = None, nights: float | None = None) -> Kind:
    """Return the kind of run for a request.

    `slot_minutes` is the machine time available for the night; if it is None, the time is taken from the settings.
    `nights` is the number of nights since the last accepted night; if it is None, the number is computed from the date.
    Raises UserError if the request names several stations for a kind of run that measures at one station.
    """
    match request.kind:
        case "calibrate":
            return FullCalibration(nights, Consent.ASK if request.consent else Consent.REFUSED)
        case "verify":
            return Verification(request.single_station, nights)
        case "nightly":
            return Night(slot_minutes, request.full_allowed, request.single_station, nights)
