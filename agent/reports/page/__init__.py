"""Report of a run on one printable page: measurements, identified errors, decisions and verification."""

from agent.reports.page.data import (
    EventLine,
    Header,
    IdentificationData,
    NightFacts,
    Provenance,
    QuestionFacts,
    ReportData,
    RunFacts,
    TemperatureTrace,
    VerificationFacts,
    VerifiedPosition,
    name_of_positions,
)

__all__ = [
    "EventLine",
    "Header",
    "IdentificationData",
    "NightFacts",
    "Provenance",
    "QuestionFacts",
    "ReportData",
    "RunFacts",
    "TemperatureTrace",
    "VerificationFacts",
    "VerifiedPosition",
    "name_of_positions",
]
