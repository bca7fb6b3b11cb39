"""Options and output shared by `volcal verify` and `volcal nightly`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.invocation import will_run
from agent.cli.options import config_option

if will_run():
    from rich.table import Table

    from agent.cli.printing import facts_table, results_console
    from agent.cli.run_commands.local_run import run_here
    from agent.cli.run_commands.run_summary import homing_rows, show_summary, time_rows
    from agent.results.night_changes import possible_text
    from agent.results.run_outcome import NightReport, Outcome
    from agent.runs.run_request import RunRequest
    from agent.runs.session import RunResult
    from agent.settings.load import load_settings, naming


def night_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add the options shared by `volcal verify` and `volcal nightly` to a command."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end."),
        click.option(
            "--nights",
            type=click.FloatRange(min=0.0),
            help="Nights since the last accepted night [default: by the calendar].",
        ),
        click.option(
            "--standing-at",
            type=click.IntRange(min=1),
            metavar="STATION",
            help="Station of the artefact [default: stations.standing_at].",
        ),
        config_option,
    ):
        command = option(command)
    return command


def run_night(config: Path, request: RunRequest, nights: float | None, *, as_json: bool) -> RunResult:
    """Carry out the verify or nightly run that `request` asks for, in this process. Print its outcome and return its
    result.

    `nights` is the number of nights since the last run whose result was accepted as reference; if it is None, the
    number is computed from the calendar.
    """
    settings = load_settings(config)
    with naming(config):
        ended = run_here(request, settings, config.resolve().parent, nights=nights)
    if as_json:
        click.echo(json.dumps(ended.outcome.as_json(), allow_nan=False))
    else:
        if ended.outcome.night is not None:
            results_console().print(night_table(ended.outcome, ended.outcome.night))
        if ended.outcome.estimation is not None:
            show_summary(ended.outcome)
    return ended


def night_table(outcome: Outcome, night: NightReport) -> Table:
    """Return a printable table with the outcome of a verify or nightly run."""
    errors = (night.ve_before_um, night.ve_now_um, night.ve_after_um)
    rows = [
        ("last accepted night", f"{night.since}, {night.nights:.1f} nights ago"),
        ("measured", f"{night.positions} positions at station {night.station}"),
        *time_rows(outcome),
        ("VE then, now, with a new table", " → ".join(_um(ve) for ve in errors)),
        ("held-out positions", f"{_um(night.held_out_um)}, expected {_um(night.held_out_predicted_um)}"),
        ("against the prediction", "?" if night.chi2_normalised is None else f"χ² {night.chi2_normalised:.2f}"),
        *([("finds with 95 % a squareness step of", night.finds.text)] if night.finds is not None else []),
        ("changed at once", "; ".join(one.text for one in night.jumped) or "nothing"),
        *([("if one error changed", possible_text(night.alternatives))] if night.alternatives else []),
        *([("drift in one direction", night.drift.text)] if night.drift is not None else []),
        *([("warning", night.warning)] if night.warning else []),
        *homing_rows(outcome),
        ("reason", night.reason or "none"),
    ]
    return facts_table(rows, title=f"{outcome.run_id}: {night.decision.value}")


def _um(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f} µm"
