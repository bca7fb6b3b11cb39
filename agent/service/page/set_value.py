"""Expected benefit of measuring the position set as a whole, and the loss of accuracy if one of its positions were left
out."""

from __future__ import annotations

from threading import Lock
from typing import Any

from agent.files import translated
from agent.planning.cycle_time import machine_minutes
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from drivers.errors import ConfigurationError
from twin.artefact.position_set import Position
from twin.design.candidates import CandidatePositions, build_candidates
from twin.design.valuation import Valuation
from twin.machine.volumetric import evaluation_grid

Document = dict[str, Any]


class SetValueCache:
    """Cache of the document that `set_value_document` computed last. It is safe to use from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._cached: tuple[str, Document] | None = None

    def document(self, job: Job) -> Document:
        """Return the document of `set_value_document` for `job`. Raise ConfigurationError if no position of the set is
        reachable."""
        key = job.settings.model_dump_json()
        with self._lock:
            if self._cached is None or self._cached[0] != key:
                self._cached = (key, set_value_document(job))
            return self._cached[1]


def set_value_document(job: Job) -> Document:
    """Return a document with the expected benefit of measuring the position set of `job`.

    `before_um` and `after_um` are the volumetric errors expected for the machine family (the population from which the
    machine comes) before and after the set has been measured. They are in µm, after the best-fitting rigid motion is
    removed. `lost_um` of a position is the amount, in µm, by which `after_um` would be larger without this position.
    """
    with translated(ConfigurationError, key="procedure.position_set"):
        candidates = build_candidates(
            job.procedure,
            job.positions,
            job.machine.family,
            planning_options(job.settings.temperature),
            evaluation_grid(job.machine.model.ranges_mm),
            job.tool_offset_mm,
        )
    everything = range(candidates.count)
    worth = Valuation(candidates.vce([]), candidates.vce(everything))
    after_um = worth.after.aligned_um
    return {
        "position_set": job.settings.procedure.position_set.rpartition("/")[2],
        "minutes": machine_minutes(job, candidates.positions).total,
        "balls": int(candidates.balls.sum()),
        "before_um": worth.before.aligned_um,
        "after_um": after_um,
        "percent": worth.percent,
        "positions": [_position(candidates, index, after_um) for index in everything],
        "held_out": [_position_fields(position) for position in job.held_out],
        "out_of_reach": [_position_fields(p) for p in dict.fromkeys(job.positions) if p not in candidates.positions],
    }


def _position(candidates: CandidatePositions, index: int, after_um: float) -> Document:
    others = [other for other in range(candidates.count) if other != index]
    return {
        **_position_fields(candidates.positions[index]),
        "balls": int(candidates.balls[index]),
        "lost_um": candidates.vce(others).aligned_um - after_um,
    }


def _position_fields(position: Position) -> Document:
    return {
        "station": position.station,
        "azimuth_deg": position.azimuth_deg,
        "elevation_deg": position.elevation_deg,
        "tool": position.tool,
    }
