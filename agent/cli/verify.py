"""`volcal verify`: check of the machine against the last accepted night; nothing is written."""

from __future__ import annotations

from pathlib import Path

import click

from agent.cli.errors import fail, reported
from agent.cli.night_options import night_options, run_night
from agent.errors import MeasurementFault
from agent.results.run_outcome import Decision
from agent.runs.run_request import run_request


@click.command("verify")
@night_options
@reported
def verify_command(config: Path, standing_at: int | None, nights: float | None, as_json: bool) -> None:
    """Measure a few positions with the active table and compare with the last accepted night.

    The exit code is 0 within limits and 4 out of limits.
    """
    stations = None if standing_at is None else [standing_at]
    request = run_request(kind="verify", source="command line", stations=stations, consent=True)
    ended = run_night(config, request, nights, as_json=as_json)
    if ended.error is not None:
        raise fail(ended.error)
    night = ended.outcome.night
    if night is not None and night.decision is Decision.OUT:
        raise fail(MeasurementFault(f"out of limits: {night.reason}", hint="run `volcal calibrate`"))
