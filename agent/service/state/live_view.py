"""Data for the live view of the web page: the machine, the artefact in every position, and the path of the stylus tip.

During a run the path comes from the preflight of that run. Between runs it comes from the plan that is made from the
settings; this plan is computed once and cached.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from agent.execution.steps import AskOperator, MoveTo, OrientTo, TouchTowards
from agent.planning.cycle_time import TimedStep
from agent.planning.job import Job
from agent.planning.preflight import PreflightResult
from agent.planning.preview.blob import document
from agent.planning.preview.builder import preview_of
from agent.planning.preview.tip_path import Waypoint, standing_after
from agent.runs.kinds.calibrate import calibration_of
from agent.runs.last_latencies import prepare_next_job
from agent.settings.schema import Settings
from twin.artefact.position_set import Position
from twin.collision.geometry import point, translate_point

Document = dict[str, Any]


class LiveView:
    """Cache of the document of the live view. The document is computed once per plan. The cache is safe to use from any
    thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._current: tuple[str, Job, PreflightResult] | None = None
        self._cached: tuple[tuple[object, ...], Document] | None = None

    def preflight_passed(self, run_id: str, job: Job, preflight: PreflightResult) -> None:
        """Show the plan of the run `run_id`, which has passed its preflight."""
        self._current = (run_id, job, preflight)

    def end_run(self) -> None:
        """Show the plan that is made from the settings again, because the run has ended."""
        self._current = None

    def plan(self, settings: Settings, base: Path) -> Document:
        """Return the plan of the run in progress. If no run is in progress, return the plan of the next run; the field
        `run_id` is then null."""
        current = self._current
        run_id = None if current is None else current[0]
        key = (run_id, None if run_id else settings.model_dump_json())
        with self._lock:
            if self._cached is None or self._cached[0] != key:
                self._cached = (key, _document_of_run(*current[1:]) if current else _document_of_next(settings, base))
            return {"run_id": run_id, **self._cached[1]}


def machine_facts(job: Job) -> Document:
    """Return the axis limits, the tool, the stations and the position set as a document for drawings and for the start
    dialog."""
    machine, settings = job.machine, job.settings
    return {
        "machine": machine.name,
        "limits_mm": [list(pair) for pair in machine.limits],
        "tool": settings.tool,
        "tool_offset_mm": job.tool_offset_mm.tolist(),
        "stations_mm": [list(place) for place in settings.stations.places_mm],
        "standing_at": settings.stations.standing_at,
        "stations": list(job.stations),
        "position_set": settings.procedure.position_set,
        "positions": len(job.positions),
        "held_out": len(job.held_out),
        "artefact": job.artefact.name,
        "balls_mm": job.artefact.balls.tolist(),
        "ball_radius_mm": job.artefact.ball_radius_mm,
        "slot_minutes": settings.nightly.slot_minutes,
        "full_allowed": settings.nightly.full_allowed,
    }


def _document_of_next(settings: Settings, base: Path) -> Document:
    return document(preview_of(prepare_next_job(settings, base), calibration_of))


def _document_of_run(job: Job, preflight: PreflightResult) -> Document:
    waypoints = tuple(_waypoints(job, preflight.steps, preflight.timeline))
    return document(preview_of(job, waypoints))


def _waypoints(job: Job, steps: Sequence[TimedStep], timeline: Mapping[str, float]) -> Iterator[Waypoint]:
    offset = point(job.tool_offset_mm)
    tip = translate_point(job.start_mm, offset)
    standing = Position(job.settings.stations.standing_at or 1, 0.0, 0.0)
    for timed in steps:
        match timed.step:
            case MoveTo(target_mm=target) | TouchTowards(target_mm=target):
                tip = translate_point(target, offset)
            case OrientTo() as turn:
                standing = Position(turn.station, turn.azimuth_deg, turn.elevation_deg)
            case AskOperator(request=request):
                standing = standing_after(request, standing)
        yield Waypoint(timed.step, tip, timeline[timed.step.key], standing)
