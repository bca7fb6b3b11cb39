"""The report of a run: what was measured, identified, decided and proved, on one printable page."""

from agent.report.data import (
    EventLine,
    Header,
    ProbeFacts,
    ProbeRing,
    Quantity,
    ReportData,
    RunFacts,
    TemperatureTrace,
    Verification,
    VerifiedPosition,
    VolumetricSummary,
)
from agent.report.position_naming import name_of_positions
from agent.report.render import render_report
from agent.report.volumetric_summary import volumetric_summary

__all__ = [
    "EventLine",
    "Header",
    "ProbeFacts",
    "ProbeRing",
    "Quantity",
    "ReportData",
    "RunFacts",
    "TemperatureTrace",
    "Verification",
    "VerifiedPosition",
    "VolumetricSummary",
    "name_of_positions",
    "render_report",
    "volumetric_summary",
]
