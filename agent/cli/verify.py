"""`volcal verify`: whether the machine is still what the last accepted night has left; nothing is written."""

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
    """Measure a few positions with the compensation active and compare with the last accepted night.

    Exit code 0 within limits, 4 out of them.
    """
    stations = None if standing_at is None else [standing_at]
    request = run_request(kind="verify", source="command line", stations=stations, consent=True)
    ended = run_night(config, request, nights, as_json=as_json)
    if ended.error is not None:
        raise fail(ended.error)
    night = ended.outcome.night
    if night is not None and night.decision is Decision.OUT:
        raise fail(MeasurementFault(f"out of limits: {night.reason}", hint="run `volcal calibrate`"))
