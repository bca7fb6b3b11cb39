"""The report of a run: what was measured, identified, decided and proved, on one printable page."""

from agent.report.data import (
    ArtefactFacts,
    Asked,
    EventLine,
    Header,
    Identified,
    NightFacts,
    ProbeFacts,
    ProbeRing,
    Provenance,
    Quantity,
    ReportData,
    ReportedEstimate,
    RunFacts,
    TableFacts,
    TemperatureTrace,
    Verification,
    VerifiedPosition,
    VolumetricSummary,
    triple,
)
from agent.report.position_naming import name_of_positions
from agent.report.volumetric_summary import volumetric_summary

__all__ = [
    "ArtefactFacts",
    "Asked",
    "EventLine",
    "Header",
    "Identified",
    "NightFacts",
    "ProbeFacts",
    "ProbeRing",
    "Provenance",
    "Quantity",
    "ReportData",
    "ReportedEstimate",
    "RunFacts",
    "TableFacts",
    "TemperatureTrace",
    "Verification",
    "VerifiedPosition",
    "VolumetricSummary",
    "name_of_positions",
    "triple",
    "volumetric_summary",
]
