"""Documents of the set-up page: what was read, what is proposed, and the review of the files."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from agent.planning.setup_files.new_setup import NewSetup
from agent.planning.setup_proposal.artefact_setup import Calibration
from agent.planning.setup_proposal.spindle import spindle_name
from agent.runs.new_machine.new_files import NewFiles
from drivers.roles import AxisLimits
from twin.units import S_PER_MIN

Document = dict[str, Any]


def reading_document(limits: AxisLimits | None) -> Document | None:
    """Return what a controller reports; null where it does not report a value."""
    if limits is None:
        return None
    return {
        "lower_mm": _finite(limits.lower_mm),
        "upper_mm": _finite(limits.upper_mm),
        "rapid_mm_per_min": _finite(S_PER_MIN * value for value in limits.rapid_mm_per_s),
        "acceleration_mm_per_s2": _finite(limits.acceleration_mm_per_s2),
    }


def proposal_texts(setup: NewSetup) -> dict[str, str]:
    """Return the values of a set-up as texts by name of the field, as a person would state them."""
    machine, artefact, stations = setup.machine, setup.artefact, setup.stations
    return {
        "name": machine.name,
        "machine_class": machine.kind.name,
        "controller": setup.controller.kind,
        "travel": " ".join(f"{low:g}:{high:g}" for low, high in machine.limits_mm),
        "spindle": spindle_name(machine.spindle),
        "chain": machine.chain,
        "stylus": f"{machine.stylus_mm:g}",
        "tip_diameter": f"{2.0 * machine.probe['tip_radius_mm']:g}",
        "stem": f"{machine.probe['stem_length_mm']:g}",
        "probe_diameter": f"{2.0 * machine.probe['body_radius_mm']:g}",
        "rapid": _triple(machine.rapid_mm_per_min),
        "feed": _triple(machine.feed_mm_per_min),
        "acceleration": _triple(machine.acceleration_mm_per_s2),
        "size": f"{artefact.size_mm:g}",
        "balls": str(artefact.balls),
        "tilt": f"{artefact.tilt_deg:g}",
        "holder": f"{artefact.holder_mm:g}",
        "ball_diameter": f"{artefact.diameter_mm:g}",
        "calibration": artefact.calibration.kind,
        **({"shape": artefact.shape} if artefact.shape else {}),
        **_length_texts(artefact.calibration),
        "mount_at": _triple(stations.places_mm[0]),
        "shaft": f"{stations.shaft_mm:g}",
        "table_z": f"{stations.table_z_mm:g}",
        "stations": str(len(stations.places_mm)),
    }


def _length_texts(calibration: Calibration) -> dict[str, str]:
    """Return the certified length and its uncertainty, if there is one."""
    if calibration.length_mm is None:
        return {}
    return {
        "certified_length": f"{calibration.length_mm:.4f}",
        "length_uncertainty": f"{calibration.length_uncertainty_um:g}",
    }


def review_document(files: NewFiles, directory: Path, pictures: Sequence[Path]) -> Document:
    """Return the files with their texts, the plan with its pictures, and the forecast of the gates."""
    setup, job = files.setup, files.chosen.job
    procedure = job.settings.procedure
    return {
        **files.document(directory),
        "texts": dict(files.texts),
        "refused": None if files.refused is None else str(files.refused),
        "preview": [path.name for path in pictures],
        "preview_directory": str(pictures[0].parent),
        "summary": {
            "machine": setup.machine.name,
            "class": setup.machine.kind.name,
            "travel_mm": list(setup.machine.travel_mm),
            "chain": setup.machine.chain,
            "spindle": spindle_name(setup.machine.spindle),
            "artefact": job.artefact.name,
            "balls_of_artefact": job.artefact.count,
            "stations": len(setup.stations.places_mm),
            "position_set": procedure.position_set,
            "touches_per_ball": procedure.touches_per_ball,
        },
    }


def _finite(values: Iterable[float]) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]


def _triple(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)
