"""Commands `volcal history thermal` and `volcal history now`: the drift between nights as temperature sensors explain
it, and the machine now.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import FIGURE, PATH, config_option

if will_run():
    from rich.table import Table

    from agent.cli.opened_history import counted_runs, opened_history
    from agent.cli.printing import columns_table, readings_text, results_console
    from agent.files import write_all_atomically
    from agent.settings.load import naming
    from drivers.clock import utc_timestamp

if TYPE_CHECKING:
    from agent.history.sensor_drift import SensorDrift
    from agent.runs.offline.machine_now import ExpectedErrors, MachineNow

_sensor = click.option(
    "--sensor",
    "sensors",
    multiple=True,
    metavar="NAME",
    help="Sensor to be tried; up to four [default: `temperature.drift_sensors`, else all but those of the artefact].",
)
_json = click.option("--json", "as_json_object", is_flag=True, help="Print one JSON object on stdout.")


def _readings(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    """Return temperatures in °C by sensor from texts such as `column=21.4`. Refuses values that no sensor of a machine
    reads, such as kelvins, and two values of one sensor."""
    from twin.monitoring.sensor_screening import HIGHEST_C, LOWEST_C  # noqa: PLC0415  imports numpy

    found: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            degrees = float(value)
        except ValueError:
            raise click.BadParameter(f"'{text}' is not NAME=DEGREES, such as column=21.4") from None
        if not LOWEST_C <= degrees <= HIGHEST_C:  # nan neither
            raise click.BadParameter(f"'{text}' is not between {LOWEST_C:g} and {HIGHEST_C:g} °C")
        if name in found:
            raise click.BadParameter(f"the temperature of the sensor {name!r} is stated twice")
        found[name] = degrees
    return found


def _moment(_context: click.Context, _option: click.Parameter, text: str | None) -> datetime | None:
    """Return a time in UTC; a text without a zone is in UTC."""
    if text is None:
        return None
    try:
        given = datetime.fromisoformat(text)
        return given.replace(tzinfo=UTC) if given.tzinfo is None else given.astimezone(UTC)
    except (ValueError, OverflowError):  # the first hours of the year 1 in a zone east of Greenwich
        raise click.BadParameter(f"'{text}' is not a time such as 2026-03-14T15:00+01:00") from None


@click.command("thermal")
@config_option
@_sensor
@click.option(
    "--figure",
    type=FIGURE,
    metavar="FILE",
    help="Draw drift, temperatures and effects into this file: .png, .svg, .pdf.",
)
@_json
@reported
def thermal_command(config: Path, sensors: tuple[str, ...], figure: Path | None, as_json_object: bool) -> None:
    """Explain the drift between nights by temperature sensors of the machine.

    Up to four sensors are tried. One that explains nothing is left out, and so may be all of them.
    """
    from agent.history.sensor_drift import sensor_drift  # noqa: PLC0415  mathematics that the list of runs needs not

    with opened_history(config) as (settings, store):
        found = sensor_drift(counted_runs(store), settings, sensors)
    if figure is not None:
        from agent.history.thermal_figure import draw_thermal  # noqa: PLC0415  drawing libraries are slow to import

        drawn = draw_thermal(found, f"machine {found.history.machine.name}")
        write_all_atomically(figure.parent, {figure.name: drawn.in_format_of(figure)})
    if as_json_object:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
    else:
        _show_drift(found)


@click.command("now")
@config_option
@_sensor
@click.option(
    "--temperature",
    "temperatures",
    multiple=True,
    metavar="NAME=°C",
    callback=_readings,
    help="Temperature of a sensor now; needed of each sensor that explains the drift [default: read from the "
    "thermometer, unless --at is given].",
)
@click.option(
    "--at",
    metavar="TIME",
    callback=_moment,
    help="Time of the temperatures (ISO 8601, UTC unless a zone is stated) [default: now].",
)
@click.option("--measured", "balls", type=PATH, metavar="BALLS.csv", help="One or two positions measured about then.")
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder of the results; created if missing.")
@_json
@reported
def now_command(
    config: Path,
    sensors: tuple[str, ...],
    temperatures: dict[str, float],
    at: datetime | None,
    balls: Path | None,
    out: Path,
    as_json_object: bool,
) -> None:
    """Estimate the machine now: last estimate, temperatures, and positions.

    Writes predicted.json, and with positions estimate.json, which are estimates like that of a run. Without
    --temperature, the thermometer is read, by the service if it runs; nothing moves, and nothing is written to the
    machine.
    """
    from agent.history.sensor_drift import sensor_drift  # noqa: PLC0415  mathematics that the list of runs needs not
    from agent.runs.offline.machine_now import NowRequest, machine_now  # noqa: PLC0415

    read_from = None
    moment = datetime.fromisoformat(utc_timestamp()) if at is None else at
    with opened_history(config) as (settings, store):
        drift = sensor_drift(counted_runs(store), settings, sensors)
    if drift.found.taken and not temperatures and at is None:
        from agent.cli.temperatures_now import temperatures_now  # noqa: PLC0415  drivers, which others need not

        with naming(config):
            temperatures, age_s = temperatures_now(settings, config.resolve().parent)
        read_from, moment = settings.roles.thermometer, moment - timedelta(seconds=age_s)
    found = machine_now(drift, settings, NowRequest(temperatures, moment, out, balls, read_from))
    if as_json_object:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
    else:
        _show_now(found)


def _show_drift(drift: SensorDrift) -> None:
    console, predicted = results_console(), drift.predicted
    console.print(
        f"machine {drift.history.machine.name}: {len(drift.found.nights)} nights from {drift.dates[0]:%Y-%m-%d} to "
        f"{drift.dates[-1]:%Y-%m-%d}",
        markup=False,
    )
    shown = columns_table(("sensor", "", "evidence (ln)", "field, µm/K", "nights out", "reason"), whole=("sensor",))
    for one in drift.sensors:
        shown.add_row(
            one.name,
            "explains" if one.taken else "left out",
            "" if one.log_evidence is None else f"{one.log_evidence:+.1f}",
            "" if one.field_um_per_k is None else f"{one.field_um_per_k:.2f}",
            str(one.nights_left_out),
            one.reason,
        )
    console.print(shown)
    if drift.found.taken:
        console.print(_effects_table(drift))
    verdict = "" if predicted.significant or not drift.found.taken else " (not significant)"
    console.print(
        f"explained by temperatures: {drift.explained_um:.2f} µm rms; not explained: {drift.walk_um:.2f} µm in a day\n"
        f"left-out nights predicted to {predicted.with_sensors:.2f} µm with sensors, {predicted.without:.2f} µm "
        f"without; gain {predicted.gain_um2:+.2f} ± {predicted.standard_error_um2:.2f} µm²{verdict}",
        markup=False,
    )
    if not drift.found.taken:
        console.print("no sensor explains the drift: none is used", markup=False)
    if drift.history.inseparable:
        console.print(
            f"note: {drift.history.inseparable} nights are left out: each was fused with the night before, and the "
            "estimate file of one of the two is gone, so that what it measured itself is not known",
            markup=False,
        )


def _effects_table(drift: SensorDrift) -> Table:
    names = [drift.found.sensors[place] for place in drift.found.fit.taken]
    shown = columns_table(("error", "unit", *(f"{name}, per K" for name in names)), whole=("error",))
    mean, sigma = drift.found.coefficients
    for place in drift.moved_errors:
        unit, factor = drift.unit(place)
        cells = [
            f"{factor * mean[place, at]:+.2f} ± {2.0 * factor * sigma[place, at]:.2f}" for at in drift.found.fit.taken
        ]
        shown.add_row(drift.history.reference.model.names[place], unit, *cells)
    return shown


def _show_now(found: MachineNow) -> None:
    console = results_console()
    sensors = ", ".join(found.sensors) or "none: nothing is moved by temperatures"
    console.print(
        f"machine {found.machine}: estimate of run {found.run_id}, {24.0 * found.age_days:.1f} h ago; "
        f"sensors: {sensors}",
        markup=False,
    )
    if found.temperatures_c:
        source = "as stated" if found.read_from is None else f"given by the device {found.read_from}"
        console.print(f"temperatures ({source}): {readings_text(found.temperatures_c)}", markup=False)
    shown = columns_table(("state", "VE, µm", "VCE, µm"), whole=("state",), numbers=("VE, µm", "VCE, µm"))
    rows: list[tuple[str, ExpectedErrors | None]] = [
        ("last estimate", found.then),
        ("moved by temperatures and time", found.predicted),
        ("with the measured positions", found.measured),
    ]
    for name, errors in rows:
        if errors is not None:
            shown.add_row(name, f"{errors.ve_um:.2f}", f"{errors.vce_um:.2f}")
    console.print(shown)
    changed = columns_table(("error", "predicted change", "unit"), whole=("error",))
    for name, change, sigma, unit in found.largest:
        changed.add_row(name, f"{change:+.2f} ± {2.0 * sigma:.2f}", unit)
    console.print(changed)
    console.print(
        f"change of the field: {found.moved_um:.2f} µm expected, {found.doubt_um:.2f} µm uncertain\n"
        f"estimate: {found.file}",
        markup=False,
    )
    for one in found.extrapolated:
        console.print(f"note: {one.text}", markup=False)
    if found.identification is not None and found.identification.material.night is not None:
        night = found.identification.material.night
        if not night.fits:
            console.print("note: the positions contradict the prediction: measure a night", markup=False)
