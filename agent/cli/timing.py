"""Command `volcal timing`, which compares the times of the steps of a finished run with the predicted times.

The command also suggests values of the latencies in the settings that fit the observed times.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run

if will_run():
    from rich.table import Table

    from agent.cli.printing import results_console
    from agent.execution.run_record import RunSteps, read_steps
    from agent.model_files import load_machine
    from agent.planning.latency_fit import (
        ObservedStep,
        StepKindTiming,
        observed_steps,
        refit,
        step_kind_timings,
        suggested_settings,
    )
    from agent.planning.time_model import TimeModel, time_model
    from agent.settings.load import stored_settings
    from drivers.errors import InputError
    from twin.units import S_PER_MIN


@click.command("timing")
@click.argument("run", type=click.Path(path_type=Path), metavar="RUN_DIR")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout instead of a table.")
@reported
def timing_command(run: Path, as_json: bool) -> None:
    """Compare a run's step times with the prediction and suggest latencies for the settings.

    RUN_DIR is the folder of a run below its state directory, which also contains the journal.
    """
    run = run.resolve()
    model, observed = _observed(read_steps(run.parent, run.name), run.name)
    if not observed:
        raise InputError(
            "the run has no step from which latencies can be derived",
            run=run.name,
            hint="choose a run that measured something",
        )
    kinds, suggested = step_kind_timings(model, observed), suggested_settings(refit(model, observed))
    if as_json:
        click.echo(json.dumps({"steps": [asdict(kind) for kind in kinds], "timing": suggested}, allow_nan=False))
        return
    results_console().print(_table(kinds))
    click.echo("[timing]")
    for name, value in suggested.items():
        click.echo(f"{name} = {value}")


def _observed(recorded: RunSteps, run_id: str) -> tuple[TimeModel, list[ObservedStep]]:
    """Return the time model that predicted the step times of the run, and the observed steps of the run."""
    settings = stored_settings(recorded.settings, run_id)
    model = time_model(load_machine(settings.machine), settings.timing)
    return model, observed_steps(recorded.steps, model)


def _table(kinds: Sequence[StepKindTiming]) -> Table:
    """Return the table with one row per kind of step. Total times are in min; latencies are in ms per step."""
    table = Table(title="machine time of the run")
    table.add_column("step", no_wrap=True)
    for heading in ("count", "predicted\nmin", "observed\nmin", "set\nms", "suggested\nms", "rest (rms)\nms"):
        table.add_column(heading, justify="right")
    for kind in kinds:
        minutes = (kind.predicted_s / S_PER_MIN, kind.observed_s / S_PER_MIN)
        each_ms = (kind.latency_s * 1e3, kind.suggested_latency_s * 1e3, kind.rest_s * 1e3)
        cells = [*(f"{value:.2f}" for value in minutes), *(f"{value:.1f}" for value in each_ms)]
        table.add_row(kind.kind, str(kind.count), *cells)
    return table
