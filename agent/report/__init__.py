"""The report of a run: what was measured, identified, decided and proved, on one printable page."""

from agent.report.data import (
    EventLine,
    Header,
    Quantity,
    ReportData,
    RunFacts,
    TemperatureTrace,
    Verification,
    VerifiedPosition,
)
from agent.report.render import render_report

__all__ = [
    "EventLine",
    "Header",
    "Quantity",
    "ReportData",
    "RunFacts",
    "TemperatureTrace",
    "Verification",
    "VerifiedPosition",
    "render_report",
]
