"""Command `volcal design artefact`, which chooses the artefact and its mount for a slot and a budget. It contacts no
device."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import reported
from agent.cli.invocation import will_run
from agent.cli.options import PATH, Duration, case_options

if will_run():
    from rich.console import Console
    from rich.table import Table

    from agent.cli.printing import columns_table, facts_table, results_console
    from agent.files import check_folder, translated
    from agent.planning.case_file import load_case
    from agent.planning.design.artefact_costs import SHIPPED_COSTS, load_costs
    from agent.planning.design.artefact_design import ArtefactDesign, ArtefactDesigner, DesignedVariant
    from agent.planning.design.artefact_files import with_artefact_file, write_artefact_design
    from agent.planning.design.artefact_screening import ScreenedVariant, Screening
    from agent.planning.design.artefact_search import VariantChoices, VariantSearch
    from agent.planning.design.artefact_variants import ArtefactVariant, PresentEquipment, RotationCentre, parse_centre
    from agent.planning.job import Job
    from agent.runs.kinds.calibrate import calibration_of, preflight_of
    from agent.runs.last_latencies import with_learned_latencies
    from agent.settings.load import naming
    from drivers.clock import wall_seconds
    from drivers.errors import InputError
    from twin.artefact.ball_spacing import BallSpacing, stated_places
    from twin.design.candidates import orientation_grid

_LENGTH_SHARES = (0.6, 0.8, 1.0, 1.2)
_BALLS = (5, 6, 7, 9, 11)
_STATIONS = (2, 3, 4, 5, 6)
_TILTS_DEG = (0.0, 15.0, 30.0)
_SHIFTS_MM = (-150.0, 0.0, 150.0)
_CENTRES = ("beside:120", "above:120", "middle:150")
_WORDS = {
    "length_mm": "length / mm",
    "balls": "balls",
    "spacing": "spacing",
    "tilt_deg": "tilt / °",
    "centre": "rotation centre",
    "across_mm": "across / mm",
    "height_mm": "height / mm",
    "stations": "stations",
}
_MOST_REASONS = 8


def _listed(kind: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, str | None], tuple[Any, ...]]:
    def callback(_: click.Context, parameter: click.Parameter, text: str | None) -> tuple[Any, ...]:
        try:
            return tuple(dict.fromkeys(kind(part.strip()) for part in text.split(","))) if text else ()
        except ValueError:
            raise click.BadParameter(f"write values such as {parameter.metavar}, separated by commas") from None

    return callback


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


@click.command("artefact")
@case_options
@click.option(
    "--slot",
    type=Duration(),
    required=True,
    metavar="30min",
    help="Machine time of one run, checks and proof included.",
)
@click.option("--budget", type=float, required=True, metavar="EUR", help="Largest purchase in euro.")
@click.option("--costs", type=PATH, metavar="FILE.toml", help="Costs instead of the shipped ones, which are assumed.")
@click.option("--length-mm", callback=_listed(_number), metavar="1000,1500", help="Lengths of the bar to choose from.")
@click.option("--balls", callback=_listed(int), metavar="5,7,11", help="Numbers of balls to choose from.")
@click.option(
    "--spacing",
    callback=_listed(str),
    metavar="even,graded,distinct,ends",
    help="Spacings of the balls to choose from.",
)
@click.option(
    "--ball-places",
    callback=_listed(_number),
    metavar="0,140,310,500",
    help="Places of the balls in mm from the first one; they replace the length, the number and the spacing.",
)
@click.option("--theta-deg", callback=_listed(_number), metavar="0,15,30", help="Tilts of the holders to choose from.")
@click.option(
    "--centre",
    callback=_listed(str),
    metavar="beside:120,above:120,middle:150",
    help="Rotation centres to choose from: mm beside the bar, under it, or in its middle with mm to the pedestal.",
)
@click.option(
    "--across-mm",
    callback=_listed(_number),
    metavar="850,1000",
    help="Places of the rotation centre across the stations.",
)
@click.option("--height-mm", callback=_listed(_number), metavar="600,750", help="Heights of the rotation centre.")
@click.option("--stations", callback=_listed(int), metavar="2,3,4", help="Numbers of stations to choose from.")
@click.option("--carry", type=Duration(), metavar="3min", help="Time of a change of station instead of the settings'.")
@click.option("--free-stations", is_flag=True, help="Also improve the places of the stations of the best variant.")
@click.option("--grid-deg", type=float, default=15.0, show_default=True, help="Step of the angles of the positions.")
@click.option("--screening-grid-deg", type=float, default=30.0, show_default=True, help="The same while screening.")
@click.option("--most", type=click.IntRange(min=1), default=120, show_default=True, help="Most variants to screen.")
@click.option(
    "--finalists",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Variants that are designed completely.",
)
@click.option("--out", type=PATH, default=Path("artefact-design"), show_default=True, metavar="DIR")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@reported
def design_artefact_command(
    *,
    config: Path,
    slot: float,
    budget: float,
    costs: Path | None,
    length_mm: tuple[float, ...],
    balls: tuple[int, ...],
    spacing: tuple[str, ...],
    ball_places: tuple[float, ...],
    theta_deg: tuple[float, ...],
    centre: tuple[str, ...],
    across_mm: tuple[float, ...],
    height_mm: tuple[float, ...],
    stations: tuple[int, ...],
    carry: float | None,
    free_stations: bool,
    grid_deg: float,
    screening_grid_deg: float,
    most: int,
    finalists: int,
    out: Path,
    as_json: bool,
) -> None:
    """Choose artefact and mount for a slot and a budget."""
    started = wall_seconds()
    if not (math.isfinite(budget) and budget > 0.0):
        raise InputError(f"the budget must be a finite amount above zero, not {budget:g}", key="--budget")
    if ball_places and (length_mm or balls or spacing):
        raise InputError(
            "--ball-places already states length, number and spacing of the balls",
            hint="leave out --length-mm, --balls and --spacing",
            key="--ball-places",
        )
    for option, step_deg in (("--grid-deg", grid_deg), ("--screening-grid-deg", screening_grid_deg)):
        with translated(InputError, key=option):
            orientation_grid(step_deg)
    check_folder(out)
    prices = load_costs(SHIPPED_COSTS if costs is None else costs)
    with naming(config):
        base = config.resolve().parent
        job = _carried(with_learned_latencies(load_case(config), base), carry)
        present = PresentEquipment(job, base, prices.calibration)
        present_variant = present.variant
    choices = _choices(
        VariantChoices(
            balls=balls or _BALLS,
            length_mm=length_mm or tuple(round(share * present_variant.length_mm, -1) for share in _LENGTH_SHARES),
            stations=stations or _STATIONS,
            centre=_centres(centre or _CENTRES),
            height_mm=height_mm or tuple(present_variant.height_mm + shift for shift in _SHIFTS_MM),
            across_mm=across_mm or tuple(present_variant.across_mm + shift for shift in _SHIFTS_MM),
            spacing=_spacings(spacing),
            tilt_deg=theta_deg or _TILTS_DEG,
            stated_mm=((),),
        ),
        ball_places,
    )
    if ball_places:
        with translated(InputError, key="--ball-places"):
            present.check_places(ball_places, choices.tilt_deg)
    with Console(stderr=True).status("") as status:
        screening = Screening(
            present,
            prices,
            slot,
            screening_grid_deg,
            calibration_of,
            say=lambda count: status.update(f"variant {count + 1} of at most {most} …"),
        )
        designer = ArtefactDesigner(
            VariantSearch(screening, choices, budget, most),
            grid_deg,
            finalists,
            prove=with_artefact_file(preflight_of),
            say=lambda what: status.update(f"{what} …"),
        )
        found = designer.run(free_stations=free_stations)
    files = write_artefact_design(found, slot, budget, out)
    seconds = wall_seconds() - started
    if as_json:
        click.echo(json.dumps(_document(found, slot, budget, files, seconds), allow_nan=False))
    else:
        _show(found, files, seconds)


def _carried(job: Job, minutes: float | None) -> Job:
    """Return `job` with the minutes of a change of station, if they are given."""
    if minutes is None:
        return job
    timing = job.settings.timing.model_copy(update={"relocation_minutes": minutes})
    return replace(job, settings=job.settings.model_copy(update={"timing": timing}))


def _spacings(words: tuple[str, ...]) -> tuple[BallSpacing, ...]:
    try:
        return tuple(BallSpacing(word) for word in words) or tuple(BallSpacing)
    except ValueError as error:
        known = ", ".join(BallSpacing)
        raise InputError(str(error), hint=f"spacings are: {known}", key="--spacing") from None


def _centres(words: tuple[str, ...]) -> tuple[RotationCentre, ...]:
    try:
        return tuple(parse_centre(word) for word in words)
    except ValueError:
        raise InputError(
            f"{', '.join(words)} are not rotation centres",
            hint="write beside:120, above:120 or middle:150, with a distance in mm above zero",
            key="--centre",
        ) from None


def _choices(asked: VariantChoices, ball_places: tuple[float, ...]) -> VariantChoices:
    """Return the values among which the search chooses. Raises InputError if one of them is impossible."""
    limits = {"balls": (3, 99), "stations": (1, 50), "length_mm": (1.0, 20_000.0), "tilt_deg": (0.0, 89.0)}
    for name, (low, high) in limits.items():
        wrong = [value for value in asked.of(name) if not low <= value <= high]
        if wrong:
            option = {"length_mm": "--length-mm", "tilt_deg": "--theta-deg"}.get(name, f"--{name}")
            raise InputError(f"{wrong[0]:g} is not between {low:g} and {high:g}", key=option)
    if not ball_places:
        return asked
    with translated(InputError, key="--ball-places"):
        length_mm = 2.0 * float(stated_places(ball_places)[-1])
    if len(ball_places) < 3:
        raise InputError("fewer than three balls do not determine a pose", key="--ball-places")
    return replace(
        asked, balls=(len(ball_places),), length_mm=(length_mm,), spacing=(BallSpacing.EVEN,), stated_mm=(ball_places,)
    )


def _cells(variant: ArtefactVariant) -> tuple[str, ...]:
    return (
        f"{variant.length_mm:g}",
        str(variant.balls),
        variant.spacing_text,
        f"{variant.tilt_deg:g}",
        str(variant.centre),
        f"{variant.across_mm:g}",
        f"{variant.height_mm:g}",
        str(variant.stations),
    )


def _show(found: ArtefactDesign, files: list[Path], seconds: float) -> None:
    console, best = results_console(), found.best
    console.print(f"machine {best.result.problem.job.machine.name}")
    console.print(_comparison(found))
    console.print("purchase in €: " + _purchase(found))
    console.print(_effects(found))
    places = [f"{place[best.result.problem.job.layout.station_axis]:g}" for place in _places(best)]
    axis = "XYZ"[best.result.problem.job.layout.station_axis]
    rows = [
        (
            "variants screened",
            str(len(found.screened)) + (" (the limit; --most allows more)" if found.exhausted else ""),
        ),
        ("of these not measurable", str(len(found.refused))),
        (f"stations at {axis} / mm", ", ".join(places)),
        ("machine time", best.result.minutes_by_phase.text),
        ("preflight", "passed: no collision, no limit"),
        ("took", f"{seconds:.0f} s"),
    ]
    console.print(facts_table(rows, title="artefact and mount by design"))
    for one in found.refused[:_MOST_REASONS]:
        console.print(f"refused: {', '.join(_cells(one.variant))}: {one.reason}", markup=False)
    if len(found.refused) > _MOST_REASONS:
        console.print(f"{len(found.refused) - _MOST_REASONS} more in the table of the variants", markup=False)
    console.print(
        "note: the costs are those of the cost file, and this bar has to be made and calibrated", style="yellow"
    )
    for path in files:
        console.print(str(path), markup=False)


def _comparison(found: ArtefactDesign) -> Table:
    own = found.present
    table = columns_table(
        ("", *_WORDS.values(), "positions", "min", "VCE / µm", "change / %", "purchase / €", "€ a run"),
        title="designed completely",
    )
    rivals = [one for one in found.finalists if one.variant not in (found.best.variant, own.variant)]
    for name, one in (("present", own), ("best", found.best), *(("", rival) for rival in rivals)):
        cells = (name, *_cells(one.variant))
        if one.design is None:
            table.add_row(*cells, "", "", one.reason, "", f"{one.purchase_euro:.0f}", "")
            continue
        change = "" if own.design is None else f"{100.0 * (one.vce_um / own.vce_um - 1.0):+.1f}"
        worth = (f"{one.result.minutes:.1f}", f"{one.vce_um:.2f}", change)
        euro = (f"{one.purchase_euro:.0f}", f"{one.run_euro:.1f}")
        table.add_row(*cells, str(len(one.result.positions)), *worth, *euro)
    return table


def _purchase(found: ArtefactDesign) -> str:
    return ", ".join(f"{part} {euro:.0f}" for part, euro in found.best.purchase.items())


def _effects(found: ArtefactDesign) -> Table:
    """Return the table of the changes of one property of the best variant, all screened alike."""
    table = columns_table(
        ("property", "best", "instead", "VCE / µm", "mean change of VCE, of pairs", "purchase / €"),
        title=f"one change of the best, screened (VCE {found.screened_best.vce_um:.2f} µm)",
    )
    for effect in found.effects:
        one, mean = effect.changed, effect.mean_percent
        changed = "" if mean is None else f"{mean:+.1f} % of {len(effect.ratios)}"
        error = f"{one.vce_um:.2f}" if one.measurable else one.reason
        before, after = (_value(value) for value in effect.values)
        table.add_row(_WORDS[effect.name], before, after, error, changed, f"{one.purchase_euro:.0f}")
    return table


def _value(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _places(one: DesignedVariant) -> list[list[float]]:
    locations = one.result.problem.job.layout.locations_mm
    return [locations[number].tolist() for number in sorted(locations)]


def _properties(variant: ArtefactVariant) -> dict[str, object]:
    return {**asdict(variant), "spacing": variant.spacing_text, "centre": str(variant.centre)}


def _designed(one: DesignedVariant, before_um: float) -> dict[str, object]:
    facts: dict[str, object] = {**_properties(one.variant), "purchase_euro": round(one.purchase_euro, 2)}
    if one.design is None:
        return {**facts, "expected_vce_um": None, "reason": one.reason}
    gained_um = before_um - one.vce_um
    return {
        **facts,
        "purchase_by_part": {part: round(euro, 2) for part, euro in one.purchase.items()},
        "expected_vce_um": one.vce_um,
        "machine_minutes": round(one.result.minutes, 3),
        "run_euro": round(one.run_euro, 2),
        "gain_um_per_minute": gained_um / one.result.minutes,
        "gain_um_per_100_euro": 100.0 * gained_um / one.purchase_euro,
        "positions": len(one.result.positions),
        "ball_centres": one.result.balls,
        "places_mm": _places(one),
        "reason": "",
    }


def _screened(one: ScreenedVariant) -> dict[str, object]:
    known = one.measurable
    return {
        **_properties(one.variant),
        "purchase_euro": round(one.purchase_euro, 2),
        "expected_vce_um": one.vce_um if known else None,
        "machine_minutes": round(one.minutes, 3) if known else None,
        "run_euro": round(one.run_euro, 2) if known else None,
        "reason": one.reason,
    }


def _document(
    found: ArtefactDesign, slot: float, budget: float, files: list[Path], seconds: float
) -> dict[str, object]:
    before_um = found.best.result.valuation.before.aligned_um
    return {
        "machine": found.best.result.problem.job.machine.name,
        "slot_minutes": slot,
        "budget_euro": budget,
        "expected_ve_um": before_um,
        "present": _designed(found.present, before_um),
        "best": _designed(found.best, before_um),
        "finalists": [_designed(one, before_um) for one in found.finalists],
        "screened": len(found.screened),
        "exhausted": found.exhausted,
        "screened_best_vce_um": found.screened_best.vce_um,
        "changes": [
            {**_screened(one.changed), "property": one.name, "mean_percent": one.mean_percent, "pairs": len(one.ratios)}
            for one in found.effects
        ],
        "euro_front": [_screened(one) for one in found.euro_front],
        "refused": [_screened(one) for one in found.refused],
        "files": [str(path) for path in files],
        "wall_seconds": round(seconds, 3),
    }
