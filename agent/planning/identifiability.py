"""Identifiability of the errors of a machine by a measuring procedure: which errors the measurements determine, and how
well.

The identifiability is computed before any measurement, from settings files and the names of position sets.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from agent.files import translated
from agent.model_files import load_positions
from agent.planning.case_file import load_case
from agent.planning.job import Job
from agent.planning.planning_options import planning_options
from agent.probing.run_plan import position_key
from agent.settings.load import POSITION_FILES
from drivers.errors import ConfigurationError, InputError
from twin.arrays import Array
from twin.artefact.position_set import Position, parse_position_set
from twin.design.certificate_value import ROUGH_MM, CertificateValue, certificate_value
from twin.design.identifiability import Identifiability, assess_identifiability
from twin.design.measurement_setup import SetUp, layout_for
from twin.design.procedure import PlannedMeasurement, Procedure
from twin.design.setup_advice import describe_gain, describe_trial
from twin.design.setup_trials import TrialGain, evaluated_tools, trial_gains
from twin.identification import predicted_vce
from twin.identification.options import Formulation
from twin.machine.volumetric import VolumetricRms, evaluation_grid
from twin.units import UM_PER_MM


@dataclass(frozen=True)
class RankRequest:
    """Files and choices for the function `rank`, which determines the errors that a measuring procedure can identify.

    `position_set` contains the names of sets joined by +, or the path of a position file. `tools` contains names of
    tools in the machine file. `stations` is a number of evenly spaced stations. `formulation` is the
    formulation of the identification (ball centres or distances). If a choice is None or `tools` is empty, the value of
    the settings is used.
    """

    config: Path
    machine: Path | None = None
    artefact: Path | None = None
    position_set: str | None = None
    stations: int | None = None
    tools: tuple[str, ...] = ()
    formulation: Formulation | None = None
    grid_shape: tuple[int, int, int] = (60, 20, 20)


@dataclass(frozen=True, eq=False)
class RankResult:
    """Result of the function `rank`, which determines the errors that a measuring procedure can identify.

    `seen` says which parameters of the error model the measurements determine. `vce` contains the expected volumetric
    error after compensation (VCE) of each error field in `seen.fields`; there is one error field for each tool.
    `advice` contains proposed additions to the measuring procedure, the best addition first. `certificate` says what
    the certificate of the artefact is worth.
    """

    job: Job
    position_set: str
    set_up: SetUp
    planned: PlannedMeasurement
    seen: Identifiability
    vce: tuple[VolumetricRms, ...]
    advice: tuple[TrialGain, ...]
    certificate: CertificateValue

    def as_json(self) -> dict[str, Any]:
        seen, planned = self.seen, self.planned
        return {
            "machine": self.job.machine.name,
            "artefact": self.set_up.procedure.artefact.name,
            "position_set": self.position_set,
            "formulation": self.set_up.options.formulation,
            "tools": list(self.set_up.procedure.layouts),
            "positions": len(planned.positions),
            "left_out": [position_key(position) for position in planned.left_out],
            "unreachable_balls": planned.unreachable_balls,
            "balls": planned.observations.size,
            "rank": seen.rank,
            "parameters": seen.model.size,
            "conditioning": seen.conditioning,
            "null_summary": list(seen.null_summary),
            "null_directions": [
                {"text": d.text, "changes_field": d.changes_field, "loadings": dict(d.loadings)}
                for d in seen.null_directions
            ],
            "sigma": _sigma_json(seen),
            "fields": [
                {**field, "predicted_vce_um": vce.aligned_um}
                for field, vce in zip(_fields_json(seen), self.vce, strict=True)
            ],
            "certificate": _certificate_json(self.certificate),
            "advice": [_advice_json(gain) for gain in self.advice],
        }


def rank(question: RankRequest) -> RankResult:
    """Determine which errors of the machine the measuring procedure that `question` describes can identify.

    Raises UserError, which names the file, the key and the valid values, if the input is unusable or empty.
    """
    job = load_case(
        question.config,
        machine=question.machine,
        artefact=question.artefact,
        stations=question.stations,
        tool=question.tools[0] if question.tools else None,
    )
    with translated(ConfigurationError, key="grid"):
        grid = evaluation_grid(job.machine.model.ranges_mm, question.grid_shape)
    name = question.position_set or job.settings.procedure.position_set
    with translated(InputError, set=name):
        set_up = _set_up(job, question, name)
        return _ranked(job, name, set_up, grid)


def _ranked(job: Job, name: str, set_up: SetUp, grid: Array) -> RankResult:
    estimate, views = set_up.estimate(), evaluated_tools(set_up, grid)
    seen = assess_identifiability(estimate, views)
    return RankResult(
        job=job,
        position_set=name,
        set_up=set_up,
        planned=set_up.plan(),
        seen=seen,
        vce=tuple(predicted_vce(estimate, grid, view.form.tool_offset) for view in views),
        advice=trial_gains(set_up, seen, views),
        certificate=certificate_value(set_up, grid),
    )


def _set_up(job: Job, question: RankRequest, name: str) -> SetUp:
    """Return the set-up: every position with every requested tool, unless a position file names the tool."""
    positions = _positions(job, question, name)
    asked = tuple(dict.fromkeys(question.tools)) or (job.settings.tool,)
    named = [position.tool for position in positions if position.tool]
    bare = SetUp(job.machine.model, job.machine.family, job.procedure, ())
    used = dict.fromkeys((*asked, *named))
    with translated(ConfigurationError, file=str(job.settings.machine)):
        layouts = {tool: layout_for(job.layout, job.machine.tool(tool), bare.tool_axis) for tool in used}
    chosen = question.formulation or job.settings.identification.formulation
    return replace(
        bare,
        procedure=Procedure(layouts, job.procedure.covariance_mm2),
        positions=_with_tools(positions, asked),
        options=replace(planning_options(job.settings.temperature), formulation=chosen),
    )


def _positions(job: Job, question: RankRequest, name: str) -> tuple[Position, ...]:
    if question.position_set is None:
        return job.positions
    if name.endswith(POSITION_FILES):
        return load_positions(Path(name))
    everywhere = parse_position_set(name, len(job.layout.locations_mm), job.layout.frame.facing_deg)
    stations = job.settings.procedure.stations or sorted(job.layout.locations_mm)
    return tuple(position for position in everywhere if position.station in stations)


def _with_tools(positions: Sequence[Position], tools: Sequence[str]) -> tuple[Position, ...]:
    """Return the positions grouped by tool, because tools are changed by hand. A position that names a tool is measured
    only with that tool."""
    free = [position for position in positions if position.tool is None]
    bound = [position for position in positions if position.tool is not None]
    return (*(replace(position, tool=tool) for tool in tools for position in free), *bound)


def _fields_json(seen: Identifiability) -> list[dict[str, Any]]:
    return [
        {
            "tool": at.tool,
            "tool_offset_mm": at.tool_offset.tolist(),
            "measured": at.measured,
            "prior_um": UM_PER_MM * at.prior_mm,
            "unseen_um": UM_PER_MM * at.unseen_mm,
            "blind_um": UM_PER_MM * at.blind_mm,
        }
        for at in seen.fields
    ]


def _sigma_json(seen: Identifiability) -> dict[str, dict[str, Any]]:
    return {
        parameter.name: {"unit": parameter.unit, "prior": float(prior), "posterior": float(posterior)}
        for parameter, prior, posterior in zip(
            seen.model.parameters, seen.prior_sigma, seen.posterior_sigma, strict=True
        )
    }


def _certificate_json(value: CertificateValue) -> dict[str, Any]:
    return {
        "present": value.present,
        "certificate": {
            "standard_uncertainty_um": UM_PER_MM * value.certificate_mm,
            "predicted_vce_um": value.certificate.aligned_um,
        },
        "one_length": {
            "balls": list(value.length.balls),
            "length_mm": value.length.length_mm,
            "standard_uncertainty_um": UM_PER_MM * value.length.standard_uncertainty_mm,
            "balls_known_to_um": UM_PER_MM * ROUGH_MM,
            "predicted_vce_um": value.one_length.aligned_um,
            "cost_percent": value.cost_percent(value.one_length),
        },
        "nothing": {
            "balls_known_to_um": UM_PER_MM * ROUGH_MM,
            "predicted_vce_um": value.nothing.aligned_um,
            "cost_percent": value.cost_percent(value.nothing),
        },
    }


def _advice_json(gain: TrialGain) -> dict[str, Any]:
    tool = gain.trial.tool
    return {
        "proposal": describe_trial(gain.trial),
        "effect": describe_gain(gain),
        "tool_offset_mm": None if tool is None else tool.offset.tolist(),
        "added_set": gain.trial.added or None,
        "positions": gain.positions,
        "rank_gained": gain.rank,
        "unseen_removed_um": UM_PER_MM * gain.unseen_removed_mm,
        "fields": _fields_json(gain.after),
    }
