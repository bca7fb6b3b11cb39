"""Commands `volcal verify` and `volcal nightly`. Both measure a few positions and compare the machine with the last
accepted night, that is, with the last run whose result was accepted as reference.

`verify` writes nothing to the controller. `nightly` uses the rest of the machine time available to it to measure more
and to improve the compensation table.
"""

from __future__ import annotations

from pathlib import Path

import click

from agent.cli.errors import fail, reported
from agent.cli.invocation import will_run
from agent.cli.options import Duration
from agent.cli.run_commands.night_options import night_options, run_night
from agent.lasting_output import lasting_output

if will_run():
    from agent.cli.run_commands.local_run import conclude
    from agent.errors import MeasurementFault
    from agent.results.run_outcome import Decision
    from agent.runs.run_request import run_request


@click.command("verify")
@night_options
@lasting_output()
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


@click.command("nightly")
@click.option(
    "--slot", type=Duration(), metavar="15min", help="Available machine time [default: nightly.slot_minutes]."
)
@click.option(
    "--full-allowed/--no-full",
    default=None,
    help="Whether a full calibration may fill the slot if one is needed [default: nightly.full_allowed].",
)
@night_options
@lasting_output()
@reported
def nightly_command(
    config: Path,
    slot: float | None,
    full_allowed: bool | None,
    standing_at: int | None,
    nights: float | None,
    as_json: bool,
) -> None:
    """Verify the machine and, within limits, fuse the measurements of the slot with earlier nights.

    The table is written if the improvement is worth it. Out of limits, a full calibration follows if it is permitted
    and fits into the slot; otherwise the need for one is recorded and the exit code is 4.
    """
    request = run_request(
        kind="nightly",
        source="command line",
        stations=None if standing_at is None else [standing_at],
        slot_minutes=slot,
        full_allowed=full_allowed,
        consent=True,
    )
    ended = run_night(config, request, nights, as_json=as_json)
    if ended.error is not None:
        raise fail(ended.error)
    night = ended.outcome.night
    if night is None or night.decision in (Decision.WRITTEN, Decision.RESTORED, Decision.FULL_DONE):
        conclude(ended)
