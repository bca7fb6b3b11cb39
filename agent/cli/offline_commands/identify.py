"""Command `volcal identify`, which computes an estimate of the machine's errors, a compensation table and a report from
a file with measured ball centres.

The command contacts no device.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, instruments_option, no_settings_file, optional_case_options

if will_run():
    from pydantic import ValidationError
    from rich.table import Table

    from agent.cli.printing import results_console, travel_rows
    from agent.figures.heading import subject
    from agent.results.estimation import instrument_warnings, order_text
    from agent.results.gates import reasons
    from agent.runs.offline.identification import (
        DEFAULT_GATES,
        DEFAULT_MIN_GAIN,
        DEFAULT_TABLE,
        IdentificationRequest,
        IdentificationResult,
        identify_files,
    )
    from agent.settings.load import read_settings
    from agent.settings.schema import IdentificationSettings, Order
    from drivers.clock import utc_timestamp, wall_seconds
    from twin.identification import Options


def _order(_context: click.Context, _option: click.Parameter, text: str | None) -> Order | None:
    """Parse the polynomial order, which is `evidence`, `file` or a number, as in the settings. Return None without a
    text."""
    if text is None:
        return None
    try:
        return IdentificationSettings.model_validate({"order": int(text) if text.isdecimal() else text}).order
    except ValidationError:
        raise click.BadParameter(f"'{text}' is neither evidence nor file nor a number from 1 to 15") from None


@click.command()
@click.argument("balls", type=PATH, metavar="BALLS.csv")
@optional_case_options
@click.option("--machine", type=PATH, help="Machine file (TOML) instead of the one in the settings.")
@click.option("--artefact", type=PATH, help="Artefact file (TOML) instead of the one in the settings.")
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder of the results; created if missing.")
@click.option(
    "--formulation",
    type=click.Choice(["centres", "distances"]),
    help="Ball centres with free poses, or pairwise distances [default: settings; centres]. The published studies' own "
    "method, which truncates singular values, is only for `volcal study`.",
)
@click.option(
    "--prior",
    type=click.Choice(["on", "off"]),
    help="Whether the prior population of the machine determines what was not measured [default: settings; on].",
)
@click.option(
    "--weights",
    type=click.Choice(["full", "unit"]),
    help="Covariances of the balls and the certificate, or equal weights [default: settings; full].",
)
@click.option(
    "--order",
    metavar="evidence|file|N",
    callback=_order,
    help="Legendre order: the one supported by the measurements, the one in the machine file, or a number "
    "[default: settings; evidence].",
)
@click.option(
    "--carried-over",
    type=PATH,
    metavar="ESTIMATE.json",
    help="Earlier estimate as prior instead of the prior population; its order is retained.",
)
@click.option(
    "--process-noise-um",
    type=click.FloatRange(min=0.0),
    help="With --carried-over: rms over the workspace by which the machine may have changed since [default: 0].",
)
@click.option(
    "--temperature-uncertainty",
    type=click.FloatRange(min=0.0, max=20.0),
    metavar="K",
    help="Standard uncertainty of the artefact's temperature, common to all rows [default: settings; without "
    "settings 1 K, or 3 K if the file contains no temperature].",
)
@instruments_option(
    "Readings of a laser, straightness optics, ballbar or level, or an earlier report, evaluated with the ball centres."
)
@click.option(
    "--join-contradicting",
    is_flag=True,
    help="With --instrument: use an instrument even if it contradicts the ball centres or the other instruments.",
)
@click.option("--tool", metavar="NAME", help="Tool for which the table is made [default: the one used most].")
@click.option("--even-so", is_flag=True, help="Write the table, with a mark, although a gate did not pass.")
@click.option("--no-report", is_flag=True, help="Draw no report, which takes about as long as the identification.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object on stdout instead of a table.")
@reported
def identify(
    *,
    balls: Path,
    config: Path | None,
    machine: Path | None,
    artefact: Path | None,
    out: Path,
    formulation: Literal["centres", "distances"] | None,
    prior: Literal["on", "off"] | None,
    weights: Literal["full", "unit"] | None,
    order: Order | None,
    carried_over: Path | None,
    process_noise_um: float | None,
    temperature_uncertainty: float | None,
    instruments: tuple[Path, ...],
    join_contradicting: bool,
    tool: str | None,
    even_so: bool,
    no_report: bool,
    as_json: bool,
) -> None:
    """Identify a machine from measured ball centres.

    Writes estimate.json, table.csv, table.json and report.html into DIR, or nothing when the input is wrong (exit
    code 2). If a gate does not pass, no table is written (exit code 4); estimate and report say why. A table
    in DIR is then deleted, as are other results of an earlier identification that this one does not write.
    """
    started = wall_seconds()
    if process_noise_um is not None and carried_over is None:
        raise click.UsageError("--process-noise-um says how an estimate has aged: give it with --carried-over")
    if join_contradicting and not instruments:
        raise click.UsageError("--join-contradicting says what to do with instruments: give it with --instrument")
    settings = None if config is None else read_settings(config)
    if settings is not None:
        machine, artefact = machine or settings.machine, artefact or settings.artefact
    if machine is None or artefact is None:
        raise no_settings_file()
    stated = IdentificationSettings() if settings is None else settings.identification
    options = Options(
        formulation=formulation or stated.formulation,
        use_prior=stated.prior if prior is None else prior == "on",
        weights=weights or stated.weights,
    )
    request = IdentificationRequest(
        balls=balls,
        machine=machine,
        artefact=artefact,
        out=out,
        options=options,
        tool=tool,
        order=stated.order if order is None else order,
        carried_over=carried_over,
        process_noise_um=process_noise_um or 0.0,
        gates=DEFAULT_GATES if settings is None else settings.gates,
        min_gain=DEFAULT_MIN_GAIN if settings is None else settings.verification.min_gain,
        table=DEFAULT_TABLE if settings is None else settings.table,
        even_so=even_so,
        temperature_uncertainty_k=temperature_uncertainty,
        thermometer_uncertainty_k=None if settings is None else settings.temperature.standard_uncertainty_k,
        instruments=instruments,
        join_contradicting=join_contradicting,
        with_report=not no_report,
    )
    result = identify_files(request, utc_timestamp())
    if as_json:
        document = {**result.as_json(wall_seconds() - started), "settings": None if config is None else str(config)}
        click.echo(json.dumps(document))
    else:
        _show(result, config, wall_seconds() - started)
    result.require_table()


def _show(result: IdentificationResult, config: Path | None, seconds: float) -> None:
    estimate, estimation = result.estimation.estimate, result.estimation
    table = Table(title=result.position_set, title_justify="left")
    table.add_column("")
    table.add_column("aligned", justify="right")
    table.add_column("95 % limits", justify="right")
    before, after = estimation.volumetric.before_aligned, estimation.volumetric.after_aligned
    for name, value in (("volumetric error, estimated", before), ("predicted after compensation", after)):
        lower, upper = value.limits_um or (float("nan"), float("nan"))
        table.add_row(name, f"{value.value_um:.2f} µm", f"{lower:.2f} to {upper:.2f} µm")
    console = results_console()
    used = "defaults; no settings file" if config is None else f"those of {config}"
    heading = subject(result.material.machine.name, result.material.artefact.name)
    console.print(f"{heading}\ntable, gates and identification: {used}", markup=False)
    console.print(table)
    balls = result.material.balls.observations.size
    console.print(
        f"{balls} balls, {len(estimate.rejected)} rejected; normalised χ² {estimate.chi2_normalised:.2f}; "
        f"rank {estimate.rank} of {estimate.model.size}; {seconds:.1f} s"
    )
    for name, text in travel_rows(estimation.travel):
        console.print(f"{name}: {text}")
    console.print(f"Legendre order {order_text(estimate)}")
    if estimate.step is not None and estimate.step.hidden is not None:
        console.print(f"change during the measurement: {estimate.step.hidden.note}", markup=False)
    for check in estimate.instruments:
        used = "joined" if check.joined else "not used"
        console.print(
            f"{check.name}: {used}; χ² {check.chi2:.1f} with {check.degrees_of_freedom} degrees of freedom against the "
            f"rest; largest: {check.largest.text}",
            markup=False,
        )
    for warning in instrument_warnings(estimate):
        console.print(f"note: {warning}", style="yellow", markup=False)
    console.print(estimation.thermometer.text, markup=False)
    if estimation.thermometer.warning is not None:
        console.print(f"note: {estimation.thermometer.warning}", style="yellow", markup=False)
    if result.failed and result.has_table:
        console.print(f"note: the table was written although {reasons(result.gates)}", style="yellow")
    console.print(f"report: {result.report or 'none'}", markup=False)
