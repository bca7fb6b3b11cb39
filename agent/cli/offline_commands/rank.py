"""Command `volcal rank`, which shows which errors of the machine a measuring set-up (machine, artefact, stations and
positions) can determine and which it cannot.

The command also shows changes of the set-up that would allow it to determine more errors.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Literal

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, case_options

if will_run():
    from rich.console import Console
    from rich.table import Table

    from agent.cli.printing import results_console
    from agent.figures.heading import subject
    from agent.planning.identifiability import RankRequest, RankResult, rank
    from agent.reports.page.number_format import number, plural, point
    from twin.design.certificate_value import ROUGH_MM, CertificateValue
    from twin.design.identifiability import Identifiability
    from twin.design.setup_advice import describe_gain, describe_trial
    from twin.design.setup_trials import TrialGain
    from twin.units import UM_PER_MM

MILLIONTHS = 1e3, 1e6
"""Factors that convert to millionths, that is to µm per mm and µrad per rad."""


def _shape(_: click.Context, __: click.Parameter, text: str) -> tuple[int, int, int]:
    try:
        x, y, z = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise click.BadParameter("write points along X, Y and Z, such as 60x20x20") from None
    return x, y, z


@click.command("rank")
@case_options
@click.option("--machine", type=PATH, help="Machine file (TOML) instead of the one in the settings.")
@click.option("--artefact", type=PATH, help="Artefact file (TOML) instead of the one in the settings.")
@click.option("--set", "position_set", metavar="SET", help="S1, S2, S3, joined by +, or a position file.")
@click.option(
    "--stations",
    type=click.IntRange(min=1),
    help="Number of stations, evenly spaced along their axis, instead of those in the settings.",
)
@click.option("--tool", "tools", multiple=True, metavar="NAME", help="Measuring tool; repeat the option for several.")
@click.option("--formulation", type=click.Choice(["centres", "distances"]))
@click.option(
    "--grid",
    "grid_shape",
    default="60x20x20",
    show_default=True,
    callback=_shape,
    help="Grid points over the workspace.",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def rank_command(
    *,
    config: Path,
    machine: Path | None,
    artefact: Path | None,
    position_set: str | None,
    stations: int | None,
    tools: tuple[str, ...],
    formulation: Literal["centres", "distances"] | None,
    grid_shape: tuple[int, int, int],
    as_json: bool,
) -> None:
    """Show which errors a set-up can determine and which changes would determine more, without any device."""
    found = rank(RankRequest(config, machine, artefact, position_set, stations, tools, formulation, grid_shape))
    if as_json:
        click.echo(json.dumps(found.as_json(), allow_nan=False))
        return
    _show(found, results_console())


def _show(found: RankResult, console: Console) -> None:
    console.print(_headline(found), markup=False)
    console.print(_fields_table(found))
    console.print(
        "Unseen: what the estimate will not follow of a machine of the family. Blind: the part of it\n"
        "that no repetition of these positions shows. VCE: with a table made for that tool.\n"
    )
    seen = found.seen
    console.print(f"Seen: {seen.rank} of {seen.model.size} parameters, conditioning {number(seen.conditioning)}.")
    for line in seen.null_summary:
        console.print(f"  {line}", markup=False)
    console.print(_sigma_table(seen))
    console.print(_certificate_text(found.certificate), markup=False)
    console.print("What would show more, the most first:")
    for place, gain in enumerate(_first_of_each_kind(found.advice), start=1):
        console.print(f"{place:3d}. {describe_trial(gain.trial)}:\n     {describe_gain(gain)}", markup=False)


def _certificate_text(value: CertificateValue) -> str:
    """Return lines on the expected error with a certificate, with one certified length and with nothing certified."""
    length, rough_um = value.length, UM_PER_MM * ROUGH_MM
    states = {
        "certificate": ("with a certificate", f"{UM_PER_MM * value.certificate_mm:.2g} µm per coordinate (k = 1)"),
        "one length": (
            "with one certified length",
            f"{length.length_mm:.0f} mm to {UM_PER_MM * length.standard_uncertainty_mm:.2g} µm, "
            f"balls known to {rough_um:g} µm",
        ),
        "nothing": ("with nothing certified", f"balls known to {rough_um:g} µm"),
    }
    errors = {"certificate": value.certificate, "one length": value.one_length, "nothing": value.nothing}
    lines = ["Certificate of the artefact, VCE to expect:"]
    for state, (name, detail) in states.items():
        cost = "" if state == "certificate" else f" ({value.cost_percent(errors[state]):+.0f} %)"
        here = "; that is the artefact file" if state == value.present else ""
        lines.append(f"  {errors[state].aligned_um:.2f} µm{cost} {name}: {detail}{here}")
    return "\n".join(lines)


def _first_of_each_kind(advice: Sequence[TrialGain]) -> list[TrialGain]:
    """Return the best trial of each kind, such as a length or a stylus along one axis. `advice` must be sorted, the
    best trial first.
    """
    best: dict[str, TrialGain] = {}
    for gain in advice:
        best.setdefault(gain.trial.kind, gain)
    return list(best.values())


def _headline(found: RankResult) -> str:
    planned, procedure = found.planned, found.set_up.procedure
    tools = ", ".join(f"{name} {point(layout.tool_offset_mm)}" for name, layout in procedure.layouts.items())
    left = f"; {plural(len(planned.left_out), 'position')} out of reach" if planned.left_out else ""
    return (
        f"{subject(found.job.machine.name, procedure.artefact.name)}\n"
        f"{found.position_set} at {plural(len(procedure.stations), 'station')}, {tools}\n"
        f"{plural(len(planned.positions), 'position')}, {plural(planned.observations.size, 'ball')}{left}"
    )


def _fields_table(found: RankResult) -> Table:
    table = Table(title="rms over the workspace in µm, best rigid motion taken out", title_justify="left")
    table.add_column("tool")
    table.add_column("measured")
    for head in ("no table", "unseen", "blind", "VCE to expect"):
        table.add_column(head, justify="right")
    for at, vce in zip(found.seen.fields, found.vce, strict=True):
        values = (UM_PER_MM * at.prior_mm, UM_PER_MM * at.unseen_mm, UM_PER_MM * at.blind_mm, vce.aligned_um)
        table.add_row(at.tool, "yes" if at.measured else "no", *(f"{value:.2f}" for value in values))
    return table


def _sigma_table(seen: Identifiability) -> Table:
    """Return the table of standard deviations by error and polynomial order, before and after the measurement."""
    rows = [(error, list(cells)) for error, cells in _sigma_rows(seen)]
    table = Table(title="standard deviation, before → after, in µm and µrad", title_justify="left")
    table.add_column("error")
    for order in range(1, max(max((o for o, _ in cells), default=1) for _, cells in rows) + 1):
        table.add_column(f"order {order}", justify="right")
    for error, cells in rows:
        by_order = dict(cells)
        table.add_row(error, *(by_order.get(order, "") for order in range(1, len(table.columns))))
    return table


def _sigma_rows(seen: Identifiability) -> Iterator[tuple[str, Iterator[tuple[int, str]]]]:
    """Yield the name of each error or single term, together with its table cells as (order, text). A term without an
    order is shown in the column of order 1.
    """
    parts = zip(seen.model.parameters, seen.prior_sigma.tolist(), seen.posterior_sigma.tolist(), strict=True)
    named = ((p.error if p.order else p.name, max(p.order, 1), _change(p.unit, a, b)) for p, a, b in parts)
    for error, cells in groupby(named, key=lambda cell: cell[0]):
        yield error, ((order, text) for _, order, text in cells)


def _change(unit: Literal["mm", "rad"], before: float, after: float) -> str:
    factor = MILLIONTHS[unit == "rad"]
    return f"{factor * before:.2g} → {factor * after:.2g}"
