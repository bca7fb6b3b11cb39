"""Files and options of an identification from files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from agent.settings.schema import GateSettings, Order, TableSettings, VerificationSettings
from twin.identification import Options

DEFAULT_GATES = GateSettings()
"""Limits if no settings file states any."""

DEFAULT_MIN_GAIN = VerificationSettings().min_gain
"""Smallest relative decrease of the VE by a table if no settings file states it."""

DEFAULT_TABLE = TableSettings()
"""Grid and anchor of the table if no settings file states them."""


@dataclass(frozen=True)
class IdentificationRequest:
    """Files and options of an identification of a machine's errors from files.

    `tool` is the tool for which the compensation table is made; if it is None, the tool with which most balls were
    measured is used. `carried_over` is the file of an earlier estimate that serves as prior. `process_noise_um` is the
    possible change of the machine's error field since that estimate. It is an rms over the workspace in µm, after
    removal of the best-fitting rigid motion. `gates` contains the limits (gates) that the estimate and the table
    must meet, and `min_gain` the smallest relative decrease of the VE that is expected with the table; or no table is
    written. `table` sets the grid and the anchor of the table. If `even_so` is True, the
    table is written in any case; it then carries a mark. `temperature_uncertainty_k` is the standard uncertainty of the
    artefact's temperature in K, common to all rows; it is None if it is not stated. In this case
    `thermometer_uncertainty_k`, the uncertainty of the thermometer according to the settings, is used for a ball file
    that contains temperatures. `instruments` are files with readings of other instruments; those that contradict are
    used only if `join_contradicting` is True. If `with_report` is False, no report is drawn, which takes as long as the
    identification. `provenance` is added to that of the estimate.
    """

    balls: Path
    machine: Path
    artefact: Path
    out: Path
    options: Options
    tool: str | None = None
    order: Order = "evidence"
    carried_over: Path | None = None
    process_noise_um: float = 0.0
    gates: GateSettings = DEFAULT_GATES
    min_gain: float = DEFAULT_MIN_GAIN
    table: TableSettings = DEFAULT_TABLE
    even_so: bool = False
    temperature_uncertainty_k: float | None = None
    thermometer_uncertainty_k: float | None = None
    instruments: tuple[Path, ...] = ()
    join_contradicting: bool = False
    with_report: bool = True
    provenance: Mapping[str, str] = field(default_factory=dict)
