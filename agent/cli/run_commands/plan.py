"""Command `volcal plan`, which carries out the preflight of a run, that is, executes the whole run on a simulation of
the machine.

The command contacts no device.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import case_options, procedure_options
from agent.cli.step_lists import steps_option

if will_run():
    from rich.table import Table

    from agent.cli.printing import columns_table, facts_table, gates_table, results_console
    from agent.cli.run_commands.verification_table import power_notes, power_table, power_text
    from agent.cli.step_lists import write_branch_steps
    from agent.errors import PlanRefused
    from agent.files import check_folder
    from agent.planning.cycle_time import PARTS, minutes_by_part, without_optimisation
    from agent.planning.design.set_valuation import valuation_of
    from agent.planning.job import Job
    from agent.planning.preflight import PreflightResult
    from agent.planning.run_minutes import minutes_by_phase, run_minutes
    from agent.probing.run_plan import position_key
    from agent.results.facts import Quantity, unchecked_text
    from agent.results.gates.gate_forecast import GateForecast, forecast_gates, require_forecast
    from agent.results.homing_scatter import after_homing_text
    from agent.results.predicted_accuracy import PredictedAccuracy, predict_accuracy
    from agent.runs.kinds.calibrate import calibration_of, preflight_of
    from agent.runs.kinds.night_plan import station_of
    from agent.runs.kinds.verification_power import VerificationPower, verification_power
    from agent.runs.last_homing import after_homing
    from agent.runs.last_latencies import prepare_next_job
    from agent.settings.load import load_settings, naming, with_overrides
    from twin.design.valuation import Valuation
    from twin.identification.hidden_step import HiddenStep


@click.command("plan")
@case_options
@procedure_options
@steps_option
@click.option(
    "--preview",
    type=click.Path(path_type=Path),
    is_flag=False,
    flag_value=Path("preview"),
    metavar="[DIR]",
    help="Draw the plan into DIR [preview]: plan.png and the interactive plan.html; also for a refused plan.",
)
@click.option(
    "--verification",
    "verified_at",
    type=click.IntRange(min=1),
    metavar="STATION",
    help="Also state what `volcal verify` finds, and in which time, with the artefact at STATION.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def plan_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    steps: Path | None,
    preview: Path | None,
    verified_at: int | None,
    as_json: bool,
) -> None:
    """Run the preflight of the whole procedure: limits, collisions, minutes and the expected VCE."""
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    with naming(config):
        base = config.resolve().parent
        job = prepare_next_job(settings, base)
        if verified_at is not None:
            station_of(job, verified_at)
        gates = forecast_gates(job)
    draw = _drawing(job, preview) if preview else None
    try:
        preflight = preflight_of(job, every_branch=True)
    except PlanRefused as refused:
        for path in draw(refused) if draw else ():
            click.echo(f"preview: {path}", err=True)
        raise
    listed = without_optimisation(job)
    before_minutes = run_minutes(listed, calibration_of).total
    expectation = predict_accuracy(job, preflight.measured)
    valuation = valuation_of(job, job.positions)
    with naming(config):
        verified = None if verified_at is None else verification_power(job, verified_at)
    files = draw(None) if draw else []
    if steps:
        write_branch_steps(preflight.branches, steps)
    if as_json:
        click.echo(
            json.dumps(
                _document(job, preflight, before_minutes, expectation, valuation, gates, verified, files),
                allow_nan=False,
            )
        )
        require_forecast(gates)
        return
    console = results_console()
    console.print(_table(job, preflight, before_minutes, expectation, valuation, verified))
    console.print(_branches_table(preflight))
    console.print(_minutes_table(minutes_by_part(preflight.steps)))
    if verified is not None:
        console.print(power_table(verified))
        console.print(power_notes(verified))
    console.print(gates_table(gates))
    for path in files:
        click.echo(str(path))
    require_forecast(gates)


def _drawing(job: Job, folder: Path) -> Callable[[PlanRefused | None], list[Path]]:
    """Return a function that draws the plan and returns the paths of the files. The argument of the function is the
    error with which the plan was refused, or None.

    Raise InputError before anything is drawn if `folder` cannot be written.
    """
    from agent.planning.preview.preview_files import write_preview  # noqa: PLC0415  plotting is slow to import

    check_folder(folder)
    return partial(write_preview, job, calibration_of, folder)


def _document(
    job: Job,
    preflight: PreflightResult,
    before_minutes: float,
    expectation: PredictedAccuracy,
    valuation: Valuation,
    gates: tuple[GateForecast, ...],
    verified: VerificationPower | None,
    files: list[Path],
) -> dict[str, object]:
    balls = sum(len(p.balls) for p in preflight.measured.positions)
    return {
        "machine": job.machine.name,
        "artefact": job.artefact.name,
        "position_set": job.settings.procedure.position_set,
        "formulation": job.settings.identification.formulation,
        "positions": [position_key(p) for p in job.positions],
        "held_out": [position_key(p) for p in job.held_out],
        "held_out_choice": "least-known" if job.settings.verification.positions_deg is None else "listed",
        "held_out_predicted_um": {position_key(p): value for p, value in expectation.held_out_um.items()},
        "order": [position_key(p) for p in job.measuring_order.positions],
        "left_out": list(preflight.measured.left_out),
        "unreachable_balls": preflight.measured.unreachable_balls,
        "unchecked_positions": _unchecked_positions(job, preflight),
        "balls": balls,
        "touches": preflight.measured.touches + preflight.verified.touches,
        "machine_minutes": round(preflight.machine_minutes, 3),
        "machine_minutes_as_listed": round(before_minutes, 3),
        "latencies_from_run": job.latencies_from or None,
        "minutes_by_phase": minutes_by_phase(preflight.steps, job.held_out).as_json(),
        "minutes_by_station": {
            str(station): {part: round(minutes, 3) for part, minutes in parts.items()}
            for station, parts in minutes_by_part(preflight.steps).items()
        },
        "branches": [
            {"ways": list(branch.ways), "machine_minutes": round(branch.machine_minutes, 3)}
            for branch in preflight.ends
        ],
        "withdrawals": len(preflight.branches) - len(preflight.ends),
        "steps": preflight.commands,
        "rank": expectation.rank,
        "parameters": expectation.parameters,
        "predicted_vce_um": expectation.vce.aligned_um,
        "predicted_vce_raw_um": expectation.vce.raw_um,
        "after_homing": _after_homing(job, expectation),
        "valuation_percent": round(valuation.percent, 2),
        "hidden_step": _hidden_document(job),
        "verification": None if verified is None else verified.as_json(),
        "gates": [forecast.as_json() for forecast in gates],
        "wall_seconds": round(preflight.wall_seconds, 3),
        "files": [str(path) for path in files],
    }


def _table(
    job: Job,
    preflight: PreflightResult,
    before_minutes: float,
    expectation: PredictedAccuracy,
    valuation: Valuation,
    verified: VerificationPower | None,
) -> Table:
    measured = preflight.measured
    rows = [
        ("machine", job.machine.name),
        ("artefact", job.artefact.name),
        ("position set", f"{job.settings.procedure.position_set} at stations {_listed(job.stations)}"),
        ("positions", f"{len(job.positions)}, and {len(job.held_out)} held out for verification"),
        ("held out, expected rms", _held_out(job, expectation)),
        ("left out", ", ".join(measured.left_out) or "none"),
        ("balls out of reach", str(measured.unreachable_balls)),
        ("touches", str(measured.touches + preflight.verified.touches)),
        *_unchecked_rows(job, preflight),
        ("machine time", f"{preflight.machine_minutes:.1f} min ({before_minutes:.1f} as listed, by plain paths)"),
        ("of which", minutes_by_phase(preflight.steps, job.held_out).text),
        ("with the latencies", job.latencies_text),
        ("rank", f"{expectation.rank} of {expectation.parameters} parameters"),
        ("expected VCE", f"{expectation.vce.aligned_um:.2f} µm aligned"),
        ("after a homing", after_homing_text(_after_homing(job, expectation))),
        ("benefit", f"{valuation.percent:.1f} % of the volumetric error is expected to be removed"),
        ("change while measuring", _hidden(job)),
        *([] if verified is None else [("found by a verification", power_text(verified))]),
        ("preflight took", f"{preflight.wall_seconds:.2f} s for {preflight.commands} steps"),
    ]
    return facts_table(rows, title="preflight passed: no collision, no limit")


def _unchecked_positions(job: Job, preflight: PreflightResult) -> int | None:
    """Return the number of positions in which a wrong touch cannot be told because they have too few balls; None if the
    touches of each ball are checked by themselves."""
    return None if job.rules.consistency is None else preflight.measured.uncheckable


def _unchecked_rows(job: Job, preflight: PreflightResult) -> list[tuple[str, str]]:
    count = _unchecked_positions(job, preflight)
    if not count:
        return []
    positions = len(preflight.measured.positions)
    return [("not checked", unchecked_text(count, positions, job.settings.procedure.touches_per_ball))]


def _after_homing(job: Job, expectation: PredictedAccuracy) -> dict[str, object] | None:
    after = after_homing(job)
    return None if after is None else after.as_json(Quantity(expectation.vce.aligned_um))


def _hidden_document(job: Job) -> dict[str, object] | None:
    hidden = job.hidden_step
    return None if hidden is None else {**asdict(hidden), "between": _between(job, hidden)}


def _between(job: Job, hidden: HiddenStep) -> list[str]:
    measured = (*job.measuring_order.positions, *job.closing_positions)
    return [position_key(measured[number]) for number in hidden.between or ()]


def _hidden(job: Job) -> str:
    hidden = job.hidden_step
    if hidden is None:
        return "cannot be found: fewer than two positions"
    earlier, later = _between(job, hidden)
    return f"{hidden.text} between {earlier} and {later} is just found; unnoticed, it leaves {hidden.vce_um:.1f} µm"


def _held_out(job: Job, expectation: PredictedAccuracy) -> str:
    """Return a text with one line for each held-out position: its key and the expected rms residual of its balls. The
    first line states how the positions were chosen."""
    listed = job.settings.verification.positions_deg is not None
    how = "as listed in the settings" if listed else "where the table is least known"
    lines = [f"{position_key(p)}: {value:.2f} µm" for p, value in expectation.held_out_um.items()]
    return "\n".join([f"{how}:", *lines])


def _minutes_table(minutes: Mapping[int, Mapping[str, float]]) -> Table:
    """Return a table of machine time in min. It has one row for each station and one row for all stations together."""
    parts_and_all = (*PARTS, "all")
    table = columns_table(("station", *parts_and_all), title="machine minutes", numbers=parts_and_all)
    everywhere = {part: sum(parts[part] for parts in minutes.values()) for part in PARTS}
    for name, parts in [*((str(station), parts) for station, parts in minutes.items()), ("all", everywhere)]:
        table.add_row(name, *(f"{parts[part]:.2f}" for part in PARTS), f"{sum(parts.values()):.2f}")
    return table


def _branches_table(preflight: PreflightResult) -> Table:
    """Return a table of the machine time of each branch of the run. All of them were walked."""
    table = columns_table(("branch of the run", "min"), title="branches", numbers=("min",))
    for branch in preflight.ends:
        table.add_row(branch.name, f"{branch.machine_minutes:.1f}")
    withdrawn = len(preflight.branches) - len(preflight.ends)
    table.add_row(f"stopped at the first touch of a position and withdrawn ({withdrawn} places)", "")
    return table


def _listed(numbers: tuple[int, ...]) -> str:
    return ", ".join(str(number) for number in numbers)
