"""Command `volcal try`, which measures one ball and writes nothing to the controller: the first run on a machine."""

from __future__ import annotations

import json
from pathlib import Path

import click

from agent.cli.errors import fail, reported
from agent.cli.invocation import will_run
from agent.cli.options import config_option, procedure_options
from agent.lasting_output import lasting_output
from twin.artefact.homing_count import FEWEST_HOMINGS, MOST_HOMINGS

if will_run():
    from rich.table import Table

    from agent.cli.printing import facts_table, results_console
    from agent.cli.run_commands.local_run import carry_out_here
    from agent.cli.run_commands.run_summary import time_rows
    from agent.results.run_outcome import Outcome
    from agent.results.trial_report import TrialReport
    from agent.runs.kinds.trial import OneBallTrial, with_checks
    from agent.runs.last_latencies import prepare_next_job
    from agent.settings.load import load_settings, naming, with_overrides


@click.command("try")
@config_option
@procedure_options
@click.option(
    "--homing",
    "homings",
    type=click.IntRange(FEWEST_HOMINGS, MOST_HOMINGS),
    metavar="N",
    help=f"Home the axes N times ({FEWEST_HOMINGS} to {MOST_HOMINGS}) and measure the ball after each homing.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@lasting_output()
@reported
def try_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    homings: int | None,
    as_json: bool,
) -> None:
    """Measure one ball, check probe and latch on it, and write nothing: the first run on a machine.

    The artefact is brought to the first position of the run. A ball is located at the feed of guarded moves and touched
    as in a calibration. Then the repeatability of the probe, the delay of its latch, the stylus and the reversal of the
    axes are measured, as far as the settings enable them.

    With --homing, the probe is then withdrawn, the controller homes all axes on its own paths, and the ball is measured
    again, N times. This gives the scatter of the homing of each axis, which later runs count in the accuracy after a
    homing.
    """
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    base = config.resolve().parent
    with naming(config):
        job = prepare_next_job(with_checks(settings), base)
        ended = carry_out_here(job, OneBallTrial(homings=homings or 0), base)
    if as_json:
        click.echo(json.dumps(ended.outcome.as_json(), allow_nan=False))
    elif ended.outcome.trial is not None:
        show_trial(ended.outcome, ended.outcome.trial)
    if ended.error is not None:
        raise fail(ended.error)


def show_trial(outcome: Outcome, trial: TrialReport) -> None:
    """Print the result of a trial as text."""
    console = results_console()
    console.print(_trial_table(outcome, trial))
    for warning in trial.warnings:
        console.print(f"warning: {warning}", markup=False)
    console.print(f"report: {outcome.report or 'none'}", markup=False)


def _trial_table(outcome: Outcome, trial: TrialReport) -> Table:
    x, y, z = trial.offset_mm
    pretravel_um = 1e3 * (trial.expected_radius_mm - trial.radius_mm)
    rows = [
        (
            "ball",
            f"{trial.ball}, station {trial.station}, azimuth {trial.azimuth_deg:g}°, "
            f"elevation {trial.elevation_deg:g}°",
        ),
        ("centre, as displayed", _point(trial.found_mm)),
        ("centre, as expected", _point(trial.expected_mm)),
        ("found beside it", f"X {x:+.3f}, Y {y:+.3f}, Z {z:+.3f} mm"),
        ("radius of ball and tip", f"{trial.radius_mm:.4f} mm, {pretravel_um:.1f} µm smaller than nominal"),
        ("form", f"{trial.form_um:.1f} µm"),
        *((name[0].lower() + name[1:], text) for name, text in trial.checks),
        *((name[0].lower() + name[1:], text) for name, text in (trial.homing.rows if trial.homing else ())),
        *time_rows(outcome),
        ("touches", str(outcome.touches)),
        ("compensation", f"bank {outcome.table_bank}, as before" if outcome.table_bank else "none, as before"),
    ]
    return facts_table(rows, title=f"{outcome.run_id}: {outcome.state.value}")


def _point(point_mm: tuple[float, float, float]) -> str:
    return ", ".join(f"{axis} {value:.3f}" for axis, value in zip("XYZ", point_mm, strict=True)) + " mm"
