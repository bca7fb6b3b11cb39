"""`volcal plan`: preflight of a whole run on the simulated machine; no device is touched."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from agent.cli.errors import reported
from agent.cli.options import procedure_options
from agent.errors import PlanRefused
from agent.files import check_folder
from agent.planning.cycle_time import PARTS, as_listed, minutes_by_part, walked
from agent.planning.design.set_valuation import valuation_of
from agent.planning.job import Job, prepare_job
from agent.planning.preflight import PreflightResult, run_preflight, whole_procedure
from agent.probing.run_plan import position_key
from agent.results.predicted_accuracy import Expectation, expect
from agent.settings.load import load_settings, naming, with_overrides
from twin.design.valuation import Valuation
from twin.units import S_PER_MIN


@click.command("plan")
@procedure_options
@click.option("--steps", is_flag=True, help="List every step with its machine time.")
@click.option(
    "--preview",
    type=click.Path(path_type=Path),
    is_flag=False,
    flag_value=Path("preview"),
    metavar="[DIR]",
    help="Draw the plan into DIR [preview]: plan.png, and plan.html that turns; also one that is refused.",
)
@click.option("--json", "as_json", is_flag=True, help="End with one JSON object on stdout.")
@reported
def plan_command(
    config: Path,
    position_set: str | None,
    stations: list[int] | None,
    formulation: str | None,
    steps: bool,
    preview: Path | None,
    as_json: bool,
) -> None:
    """Run the preflight of the whole procedure: limits, collisions, minutes and the expected VCE."""
    settings = with_overrides(
        load_settings(config), position_set=position_set, stations=stations, formulation=formulation
    )
    with naming(config):
        job = prepare_job(settings, config.resolve().parent)
    draw = _drawing(job, preview) if preview else None
    try:
        preflight = run_preflight(job)
    except PlanRefused as refused:
        for path in draw(refused) if draw else ():
            click.echo(f"preview: {path}", err=True)
        raise
    listed = as_listed(job)
    before_minutes = sum(timed.seconds for timed in walked(listed, whole_procedure(listed))[1]) / S_PER_MIN
    expectation = expect(job, preflight.measured)
    valuation = valuation_of(job, job.positions)
    files = draw(None) if draw else []
    if as_json:
        click.echo(
            json.dumps(_document(job, preflight, before_minutes, expectation, valuation, files), allow_nan=False)
        )
        return
    console = Console()
    if steps:
        for key, seconds in preflight.timeline.items():
            click.echo(f"{seconds:10.2f} s  {key}")
    console.print(_table(job, preflight, before_minutes, expectation, valuation))
    console.print(_minutes_table(minutes_by_part(preflight.steps)))
    for path in files:
        click.echo(str(path))


def _drawing(job: Job, folder: Path) -> Callable[[PlanRefused | None], list[Path]]:
    """Draws the plan, refused or not, and says which files it wrote. Raises InputError where it never could."""
    from agent.planning.preview.preview_files import write_preview  # noqa: PLC0415  plotting is slow to import

    check_folder(folder)
    return partial(write_preview, job, folder)


def _document(
    job: Job,
    preflight: PreflightResult,
    before_minutes: float,
    expectation: Expectation,
    valuation: Valuation,
    files: list[Path],
) -> dict[str, object]:
    balls = sum(len(p.balls) for p in preflight.measured.positions)
    return {
        "position_set": job.settings.procedure.position_set,
        "formulation": job.settings.identification.formulation,
        "positions": [position_key(p) for p in job.positions],
        "held_out": [position_key(p) for p in job.held_out],
        "order": [position_key(p) for p in job.measuring.positions],
        "left_out": list(preflight.measured.left_out),
        "unreachable_balls": preflight.measured.unreachable_balls,
        "balls": balls,
        "touches": preflight.measured.touches + preflight.verified.touches,
        "machine_minutes": round(preflight.machine_minutes, 3),
        "machine_minutes_as_listed": round(before_minutes, 3),
        "minutes_by_station": {
            str(station): {part: round(minutes, 3) for part, minutes in parts.items()}
            for station, parts in minutes_by_part(preflight.steps).items()
        },
        "steps": preflight.commands,
        "rank": expectation.rank,
        "parameters": expectation.parameters,
        "predicted_vce_um": expectation.vce.aligned_um,
        "predicted_vce_raw_um": expectation.vce.raw_um,
        "valuation_percent": round(valuation.percent, 2),
        "wall_seconds": round(preflight.wall_seconds, 3),
        "files": [str(path) for path in files],
    }


def _table(
    job: Job, preflight: PreflightResult, before_minutes: float, expectation: Expectation, valuation: Valuation
) -> Table:
    table = Table(title="preflight passed: no collision, no limit", show_header=False)
    measured = preflight.measured
    rows = [
        ("machine", job.machine.name),
        ("artefact", job.artefact.name),
        ("position set", f"{job.settings.procedure.position_set} at stations {_listed(job.stations)}"),
        ("positions", f"{len(job.positions)}, and {len(job.held_out)} held out for the proof"),
        ("left out", ", ".join(measured.left_out) or "none"),
        ("balls out of reach", str(measured.unreachable_balls)),
        ("touches", str(measured.touches + preflight.verified.touches)),
        ("machine time", f"{preflight.machine_minutes:.1f} min ({before_minutes:.1f} as listed, by plain ways)"),
        ("rank", f"{expectation.rank} of {expectation.parameters} parameters"),
        ("VCE to expect", f"{expectation.vce.aligned_um:.2f} µm aligned ({expectation.vce.raw_um:.2f} as defined)"),
        ("valuation", f"{valuation.percent:.1f} % of the family's error is expected to go"),
        ("preflight took", f"{preflight.wall_seconds:.2f} s for {preflight.commands} steps"),
    ]
    for row in rows:
        table.add_row(*row)
    return table


def _minutes_table(minutes: Mapping[int, Mapping[str, float]]) -> Table:
    """A row for each station, and one for all of them."""
    table = Table("station", title="machine minutes")
    for part in (*PARTS, "all"):
        table.add_column(part, justify="right")
    everywhere = {part: sum(parts[part] for parts in minutes.values()) for part in PARTS}
    for name, parts in [*((str(station), parts) for station, parts in minutes.items()), ("all", everywhere)]:
        table.add_row(name, *(f"{parts[part]:.2f}" for part in PARTS), f"{sum(parts.values()):.2f}")
    return table


def _listed(numbers: tuple[int, ...]) -> str:
    return ", ".join(str(number) for number in numbers)
