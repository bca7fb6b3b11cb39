"""Commands of the group `volcal history`, which list, export, update and compact the runs of this machine and show how
their results change over time.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import closing, nullcontext
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from agent.cli.errors import VolcalGroup, fail, reported
from agent.cli.invocation import will_run
from agent.cli.options import FIGURE, PATH, config_option
from agent.cli.thermal_history import now_command, thermal_command
from agent.language.sentences import LANGUAGES, Language

if will_run():
    from rich.table import Table

    from agent.cli.comparison_tables import comparison_tables
    from agent.cli.opened_history import opened_history
    from agent.cli.printing import columns_table, results_console
    from agent.errors import MeasurementFault
    from agent.execution.journal_compaction import journal_bytes, release_space
    from agent.execution.run_lock import ownership
    from agent.files import write_all_atomically, write_atomically
    from agent.history.database_url import database_address
    from agent.history.dated_ahead import by_date
    from agent.history.export import as_csv, as_json, run_document
    from agent.history.retention import Compaction, compact, due_runs
    from agent.history.schema import StoredRun
    from agent.history.store import HistoryStore
    from agent.history.sync import sync
    from agent.settings.load import naming, read_settings
    from drivers.clock import utc_timestamp
    from drivers.errors import InputError

if TYPE_CHECKING:
    from agent.history.trends import Trend

MB = 1e6
RUN_COLUMNS = ("run", "kind", "verdict", "min", "VE", "VCE", "held out before", "after", "started by")
PLANT_COLUMNS = ("machine", "days ago", "last run", "verdict", "VE", "VCE", "held out", "VE drift, µm/night (95 %)")
_machine = click.option("--machine", metavar="NAME", help="Another machine in the same database.")
_json = click.option("--json", "as_json_object", is_flag=True, help="Print one JSON object on stdout.")


@click.group("history", cls=VolcalGroup)
def history_group() -> None:
    """List every run of this machine and its trends."""


@history_group.command("list")
@config_option
@_machine
@click.option("--last", type=click.IntRange(min=1), default=20, show_default=True, help="Number of runs.")
@_json
@reported
def list_command(config: Path, machine: str | None, last: int, as_json_object: bool) -> None:
    """List the runs, the newest last."""
    with opened_history(config) as (_, store):
        runs = store.runs(machine or store.address.machine, last, whole=False)
    if as_json_object:
        click.echo(json.dumps({"runs": [run_document(run, whole=False) for run in runs]}, allow_nan=False))
        return
    table = columns_table(RUN_COLUMNS, whole=("run",))
    for run in runs:
        table.add_row(*_cells(run))
    results_console().print(table)


@history_group.command("trend")
@config_option
@_machine
@click.option("--of", "names", multiple=True, metavar="NAME", help="Series, error or parameter; may be repeated.")
@click.option("--figure", type=FIGURE, metavar="FILE", help="Draw the trends into this file: .png, .svg, .pdf.")
@_json
@reported
def trend_command(
    config: Path, machine: str | None, names: tuple[str, ...], figure: Path | None, as_json_object: bool
) -> None:
    """Show drift per night, control limits, and the date at which a tolerance is reached.

    The exit code is 4 if a tolerance has been reached or will be soon.
    """
    # The mathematics of trends is slow to import, and the list of runs does not need it.
    from agent.history.helpful_actions import alarms_json, helpful_actions, hint_of  # noqa: PLC0415
    from agent.history.overview import alarms_of, most_relevant, select_trends, trends_of  # noqa: PLC0415

    with opened_history(config) as (settings, store):
        runs = by_date(store.runs(machine or store.address.machine), datetime.fromisoformat(utc_timestamp()))
        trends = trends_of(runs.counted, settings.history)
    if not trends:
        raise InputError("no run has produced a value yet", hint="`volcal history list` shows all runs")
    shown = select_trends(trends, names) if names else most_relevant(trends, 12)
    if figure is not None:
        from agent.history.figure import draw_trends  # noqa: PLC0415  drawing libraries are slow to import

        write_all_atomically(figure.parent, {figure.name: draw_trends(shown).in_format_of(figure)})
    alarms = alarms_of(trends, runs.ahead)
    actions = helpful_actions(trends, runs.counted, settings.state_directory, settings.machine)
    if as_json_object:
        helps = {name: action.as_json() for name, action in actions.items()}
        document = {
            "trends": [{**trend.as_json(), "action": helps.get(trend.series.name)} for trend in shown],
            "alarms": alarms_json(alarms, actions),
        }
        click.echo(json.dumps(document, allow_nan=False))
    else:
        results_console().print(_trend_table(shown))
    grave = [alarm for alarm in alarms if alarm.kind.of_tolerance]
    for alarm in alarms:
        click.echo(f"{alarm.kind.value}: {alarm.text}", err=True)
    if grave:
        hints = dict.fromkeys(hint_of(alarm, actions) for alarm in grave)  # each of them once
        raise fail(MeasurementFault("; ".join(alarm.text for alarm in grave), hint="; ".join(hints)))


history_group.add_command(thermal_command)
history_group.add_command(now_command)


@history_group.command("compare")
@click.argument("one", metavar="RUN")
@click.argument("other", metavar="RUN")
@config_option
@_json
@reported
def compare_command(one: str, other: str, config: Path, as_json_object: bool) -> None:
    """Compare two runs: the second RUN minus the first.

    Figures, geometric errors, error field and the tables written.
    """
    # The mathematics of the error field is slow to import, and the list of runs does not need it.
    from agent.reports.run_comparison import compare_runs  # noqa: PLC0415

    with naming(config):
        found = compare_runs(read_settings(config).state_directory, one, other)
    if as_json_object:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
        return
    for table in comparison_tables(found.as_json()):
        results_console().print(table)


@history_group.command("plant")
@config_option
@click.option("--html", type=PATH, metavar="FILE", help="Write a page with all machines into this file.")
@click.option("--language", type=click.Choice(LANGUAGES), help="Language of the page [default: `report.language`].")
@_json
@reported
def plant_command(config: Path, html: Path | None, language: Language | None, as_json_object: bool) -> None:
    """List all machines of the database: last run, verdict, VE, drift."""
    # The mathematics of trends is slow to import, and the list of runs does not need it.
    from agent.history.plant import RECENT_RUNS, plant_summaries  # noqa: PLC0415
    from agent.reports.plant_page import drift_text, plant_html  # noqa: PLC0415

    now = datetime.fromisoformat(utc_timestamp())
    with opened_history(config) as (settings, store):
        machines = plant_summaries(store.recent_runs(RECENT_RUNS, now), now)
    for one in machines:
        if one.ahead:
            click.echo(f"note: {one.machine}: {one.ahead_text}", err=True)
    if html is not None:
        write_atomically(html, plant_html(machines, store.address.text, now, language or settings.report.language))
    if as_json_object:
        document = {"database": store.address.text, "machines": [one.as_json() for one in machines]}
        click.echo(json.dumps(document, allow_nan=False))
    elif html is not None:
        click.echo(f"{len(machines)} machines: {html}", err=True)
    else:
        table = columns_table(PLANT_COLUMNS, whole=("machine",))
        for one in machines:
            verdict = f"{one.verdict.sign} {one.verdict.word['en']}"
            figures = ("-" if value is None else f"{value:.2f}" for value in (one.ve_um, one.vce_um, one.held_out_um))
            table.add_row(one.machine, f"{one.days:.1f}", one.last.kind, verdict, *figures, drift_text(one))
        results_console().print(table)


@history_group.command("export")
@config_option
@_machine
@click.option("--format", "form", type=click.Choice(["csv", "json"]), default="csv", show_default=True)
@click.option("--out", type=PATH, required=True, metavar="FILE", help="File to write.")
@reported
def export_command(config: Path, machine: str | None, form: str, out: Path) -> None:
    """Export all runs into one file: CSV with one line per run, or JSON with everything that is stored."""
    with opened_history(config) as (_, store):
        runs = store.runs(machine or store.address.machine)
    write_atomically(out, as_csv(runs) if form == "csv" else as_json(runs))
    click.echo(f"{len(runs)} runs: {out}", err=True)


@history_group.command("sync")
@config_option
@_json
@reported
def sync_command(config: Path, as_json_object: bool) -> None:
    """Copy runs that are missing or have changed from the journal into the history."""
    with naming(config):
        settings = read_settings(config)
        address = database_address(settings)
        with closing(HistoryStore(address)) as store:
            written = sync(settings.state_directory, store)
    if as_json_object:
        click.echo(json.dumps({"database": address.text, "machine": address.machine, "written": list(written)}))
    else:
        click.echo(f"{len(written)} runs written to {address.text}")


@history_group.command("compact")
@config_option
@click.option("--dry-run", is_flag=True, help="Only say what would be saved; nothing is written.")
@_json
@reported
def compact_command(config: Path, dry_run: bool, as_json_object: bool) -> None:
    """Compact old finished runs; they read as before.

    The settings `history.whole_runs` and `history.whole_days` say which runs are left as they are.
    """
    with naming(config):
        settings = read_settings(config)
    directory = settings.state_directory
    with nullcontext() if dry_run else ownership(directory, "a compaction of old runs"):
        before = journal_bytes(directory)
        due = due_runs(directory, settings.history, datetime.fromisoformat(utc_timestamp()))
        found = [compact(directory, row, write=not dry_run) for row in due]
        if not dry_run and before:  # the service may have compacted runs before, and left the free space in the file
            release_space(directory)
        after = journal_bytes(directory)
    done = [one for one in found if one is not None]
    if as_json_object:
        runs = [vars(one) for one in done]
        document = {"dry_run": dry_run, "runs": runs, "journal_before_bytes": before, "journal_after_bytes": after}
        click.echo(json.dumps({**document, "left": len(found) - len(done)}))
        return
    if done:
        results_console().print(_compaction_table(done))
    left = f"; {len(found) - len(done)} cannot be compacted" if len(found) > len(done) else ""
    what = "would be compacted" if dry_run else f"compacted; journal {before / MB:.1f} MB, now {after / MB:.1f} MB"
    click.echo(f"{len(done)} runs {what}{left}", err=True)


def _cells(run: StoredRun) -> list[str]:
    figures = (run.ve_before_um, run.acting_um, run.held_out_before_um, run.held_out_after_um)
    verdict = run.verdict
    return [
        run.run_id,
        run.kind,
        f"{verdict.sign} {verdict.word['en']}",
        f"{run.machine_minutes:.1f}",
        *("-" if value is None else f"{value:.2f}" for value in figures),
        run.started_by,
    ]


def _compaction_table(compactions: Sequence[Compaction]) -> Table:
    table = columns_table(("run", "kind", "MB", "compacted"), whole=("run",), numbers=("MB", "compacted"))
    for one in compactions:
        table.add_row(one.run_id, one.kind, f"{one.before_bytes / MB:.2f}", f"{one.after_bytes / MB:.2f}")
    before, after = (
        sum(sizes) / MB for sizes in zip(*((c.before_bytes, c.after_bytes) for c in compactions), strict=True)
    )
    table.add_row("all", "", f"{before:.2f}", f"{after:.2f}")
    return table


def _trend_table(trends: tuple[Trend, ...]) -> Table:
    soon = f"within {trends[0].warn_nights:g} nights"
    table = columns_table(("series", "now", "a night (95 %)", "steps", "tolerance", "reached (5 to 95 %)", soon))
    for trend in trends:
        series, drift = trend.series, trend.drift
        table.add_row(
            series.title,
            f"{series.values[-1]:.2f} {series.unit}",
            "-" if drift is None else f"{drift.slope:+.3f} ± {drift.factor * drift.slope_sigma:.3f}",
            "" if drift is None else ", ".join(f"{size:+.1f} at {at:.0f}" for at, size, _ in drift.steps),
            "" if series.tolerance is None else f"{series.tolerance:g}",
            _dates_text(trend),
            _share_text(trend),
        )
    return table


def _share_text(trend: Trend) -> str:
    """Return the probability of reaching the tolerance, with the number of nights if the forecast ends before those of
    a warning."""
    if trend.forecast is None:
        return ""
    share = f"{100.0 * trend.forecast.within(trend.nights_stated):.0f} %"
    return share if trend.nights_stated == trend.warn_nights else f"{share} ({trend.nights_stated:.3g} nights)"


def _dates_text(trend: Trend) -> str:
    """Return the date at which the tolerance is reached, with its range; the nights left if there is no forecast."""
    forecast, reach = trend.forecast, trend.crossing
    if forecast is None:
        return "" if reach is None else f"in {reach.expected:.0f} (≥ {reach.earliest:.0f}) nights"
    low, middle, high = trend.days_reached
    return middle if low == "later" else f"{middle} ({low} to {high})"
