"""Command `volcal design`, which chooses the positions of the artefact to be measured. No device is contacted. Its
command `artefact` chooses artefact and mount too."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click

from agent.cli.errors import VolcalGroup, reported
from agent.cli.invocation import will_run
from agent.cli.offline_commands.design_artefact import design_artefact_command
from agent.cli.options import PATH, instruments_option, no_settings_file, optional_case_options

if will_run():
    from rich.console import Console
    from rich.table import Table

    from agent.cli.printing import columns_table, facts_table, results_console
    from agent.figures.heading import subject
    from agent.files import translated
    from agent.model_files import load_instruments
    from agent.planning.case_file import load_case
    from agent.planning.design.design_files import check_target, write_design
    from agent.planning.design.design_result import (
        DesignResult,
        VariantDesign,
        compare_variants,
        refuse_fixed_stations,
        with_free_stations,
    )
    from agent.planning.design.pareto_figure import ReferenceSet
    from agent.planning.design.set_valuation import valuation_of
    from agent.planning.design.variants import BALL_SHARES, variants_of
    from agent.planning.job import Job
    from agent.planning.run_minutes import run_minutes
    from agent.runs.kinds.calibrate import calibration_of, preflight_of
    from agent.runs.last_latencies import with_learned_latencies
    from agent.settings.load import naming
    from drivers.clock import wall_seconds
    from drivers.errors import InputError, UserError
    from twin.arrays import Array
    from twin.artefact.position_set import Position
    from twin.design.candidates import orientation_grid
    from twin.design.goals import Goal, PositionCountGoal, TargetErrorGoal, TimeSlotGoal

_SLOT = re.compile(r"\s*(\d+(?:\.\d+)?)\s*(min|h)?\s*")
_MIN_PER = {None: 1.0, "min": 1.0, "h": 60.0}
GOALS = "--slot, --positions or --target-vce"


def _listed(kind: Callable[[str], Any]) -> Callable[[click.Context, click.Parameter, str | None], list[Any]]:
    def callback(_: click.Context, __: click.Parameter, text: str | None) -> list[Any]:
        try:
            return [kind(part) for part in text.split(",")] if text else []
        except ValueError:
            raise click.BadParameter("write numbers separated by commas") from None

    return callback


def _minutes(_: click.Context, __: click.Parameter, text: str | None) -> float | None:
    if text is None:
        return None
    match = _SLOT.fullmatch(text)
    if match is None:
        raise click.BadParameter("write a time such as 20min or 1.5h")
    return float(match.group(1)) * _MIN_PER[match.group(2)]


@click.group("design", cls=VolcalGroup, invoke_without_command=True)
@optional_case_options
@click.option("--machine", type=PATH, metavar="FILE", help="Machine file instead of the one in the settings.")
@click.option("--artefact", type=PATH, metavar="FILE", help="Artefact file instead of the one in the settings.")
@click.option("--stations", type=click.IntRange(min=1), metavar="N", help="N stations, evenly spaced along their axis.")
@click.option(
    "--slot", callback=_minutes, metavar="20min", help="Smallest VCE of a run within this time, proof included."
)
@click.option("--positions", type=int, metavar="N", help="Smallest VCE with N positions.")
@click.option("--target-vce", type=float, metavar="µm", help="Shortest machine time with this expected VCE (aligned).")
@click.option("--grid-deg", type=float, default=15.0, show_default=True, help="Step of azimuth and elevation.")
@click.option(
    "--tool", "tools", multiple=True, metavar="NAME", help="Tools to choose from; the table is made for the first."
)
@click.option("--touches", callback=_listed(int), metavar="5,9", help="Numbers of touches per ball to choose from.")
@click.option("--balls", callback=_listed(int), metavar="5,7,11", help="Numbers of balls to choose from.")
@click.option("--theta-deg", callback=_listed(float), metavar="0,15,30", help="Tilts of the holders to choose from.")
@click.option(
    "--choose-balls", is_flag=True, help="Also choose the share of the balls that is measured in each position."
)
@click.option(
    "--free-stations",
    is_flag=True,
    help="Also choose the places of the stations along their axis; the mount is carried.",
)
@instruments_option(
    "Planned readings of an instrument that `volcal identify` will join. Their values do not matter; their time is not "
    "counted."
)
@click.option("--verify-set", is_flag=True, help="Also choose held-out positions for the verification.")
@click.option("--out", type=PATH, default=Path("design.csv"), show_default=True, metavar="FILE.csv")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout at the end.")
@click.pass_context
@reported
def design_command(
    ctx: click.Context,
    *,
    config: Path | None,
    machine: Path | None,
    artefact: Path | None,
    stations: int | None,
    slot: float | None,
    positions: int | None,
    target_vce: float | None,
    grid_deg: float,
    tools: tuple[str, ...],
    touches: list[int],
    balls: list[int],
    theta_deg: list[float],
    choose_balls: bool,
    free_stations: bool,
    instruments: tuple[Path, ...],
    verify_set: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Choose the positions that leave the smallest volumetric compensated error and write them as a position set."""
    if ctx.invoked_subcommand is not None:
        return
    if config is None:
        raise no_settings_file()
    started = wall_seconds()
    goal = _goal(slot, positions, target_vce)
    with translated(InputError, key="--grid-deg"):
        orientation_grid(grid_deg)
    check_target(out)
    stated = load_case(config, machine=machine, artefact=artefact, stations=stations)
    with naming(config):
        job = with_learned_latencies(stated, config.resolve().parent)
        if free_stations:
            refuse_fixed_stations(job)
        variants = variants_of(
            job,
            config.resolve().parent,
            tools=tools,
            touches=touches,
            balls=balls,
            thetas_deg=theta_deg,
            ball_shares=BALL_SHARES if choose_balls else (1.0,),
        )
        planned = load_instruments(instruments, job.machine, job.machine.model)
        console = Console(stderr=True)
        with console.status("") as status:
            choices = compare_variants(
                variants,
                goal,
                grid_deg,
                calibration_of,
                verify=verify_set,
                prove=preflight_of,
                say=lambda what: status.update(f"{what} …"),
                instruments=planned,
            )
            best = next(choice for choice in choices if choice.best)
            places: Mapping[int, Array] = {}
            if free_stations:
                best, places = with_free_stations(
                    best,
                    goal,
                    verify=verify_set,
                    prove=preflight_of,
                    say=lambda what: status.update(f"{what} …"),
                )
                choices = [best if choice.best else choice for choice in choices]
    rivals = _rivals(job)
    files = write_design(best.result, rivals, out)
    seconds = wall_seconds() - started
    if as_json:
        click.echo(json.dumps(_document(choices, best, places, rivals, files, seconds), allow_nan=False))
    else:
        _show(choices, best, places, rivals, files, seconds)


design_command.add_command(design_artefact_command)


def _goal(slot: float | None, positions: int | None, target_vce: float | None) -> Goal:
    given = [value for value in (slot, positions, target_vce) if value is not None]
    if len(given) != 1:
        said = "no goal is given" if not given else f"{len(given)} goals are given"
        raise InputError(said, hint=f"give exactly one of {GOALS}")
    if not (math.isfinite(given[0]) and given[0] > 0.0):
        raise InputError(f"the goal must be above zero, not {given[0]:g}", key=GOALS)
    if slot is not None:
        return TimeSlotGoal(slot)
    with translated(InputError):
        return PositionCountGoal(positions) if positions is not None else TargetErrorGoal(1e-3 * given[0])


def _rivals(job: Job) -> list[ReferenceSet]:
    """Return a list that contains the position set of the settings, for comparison with the design. It is empty if the
    set cannot be measured.
    """
    name = job.settings.procedure.position_set
    try:
        vce_um = valuation_of(job, job.positions).after.aligned_um
    except UserError:
        return []
    return [ReferenceSet(f"{Path(name).name} of the settings", run_minutes(job, calibration_of).total, vce_um)]


def _as_json(position: Position) -> dict[str, object]:
    return {
        "station": position.station,
        "azimuth_deg": position.azimuth_deg,
        "elevation_deg": position.elevation_deg,
        "tool": position.tool,
        "balls": None if position.balls is None else list(position.balls),
    }


def _worth(found: DesignResult) -> dict[str, object]:
    return {
        "machine_minutes": round(found.minutes, 3),
        "balls": found.balls,
        "touches": found.touches,
        "expected_ve_um": found.valuation.before.aligned_um,
        "expected_vce_um": found.valuation.after.aligned_um,
        "expected_vce_raw_um": found.valuation.after.raw_um,
        "valuation": found.valuation.percent,
    }


def _document(
    choices: list[VariantDesign],
    best: VariantDesign,
    places: Mapping[int, Array],
    rivals: list[ReferenceSet],
    files: list[Path],
    seconds: float,
) -> dict[str, object]:
    found = best.result
    phases = found.minutes_by_phase.as_json()
    return {
        "machine": found.problem.job.machine.name,
        "artefact": found.problem.job.artefact.name,
        "positions": [_as_json(position) for position in found.positions],
        "places_mm": [places[number].tolist() for number in sorted(places)] or None,
        **_worth(found),
        "minutes_by_phase": phases,
        "latencies_from_run": found.problem.job.latencies_from or None,
        "held_out": [_as_json(position) for position in found.held_out],
        "candidates": found.problem.candidates.count,
        "rehearsed": found.preflight_passed,
        "instruments": [one.name for one in found.problem.instruments],
        "front": [vars(point) for point in found.front],
        "settings_sets": [vars(rival) for rival in rivals],
        "variants": [_variant(choice) for choice in choices],
        "files": [str(path) for path in files],
        "wall_seconds": round(seconds, 3),
    }


def _variant(choice: VariantDesign) -> dict[str, object]:
    worth = _worth(choice.design) if choice.design else dict.fromkeys(("machine_minutes", "expected_vce_um"))
    return {
        "touches_per_ball": choice.variant.touches,
        "artefact_balls": choice.variant.balls,
        "ball_share": choice.variant.ball_share,
        "theta_deg": choice.variant.theta_deg,
        "best": choice.best,
        "reason": choice.reason,
        **worth,
    }


def _show(
    choices: list[VariantDesign],
    best: VariantDesign,
    places: Mapping[int, Array],
    rivals: list[ReferenceSet],
    files: list[Path],
    seconds: float,
) -> None:
    found, console = best.result, results_console()
    console.print(subject(found.problem.job.machine.name, found.problem.job.artefact.name), markup=False)
    if len(choices) > 1:
        console.print(_comparison(choices))
    volumetric = found.valuation
    rows = [
        (
            "positions",
            f"{len(found.positions)} of {found.problem.candidates.count} within reach, {found.balls} balls",
        ),
        ("machine time", f"{found.minutes:.1f} min for the whole run"),
        ("of which", found.minutes_by_phase.text),
        ("with the latencies", found.problem.job.latencies_text),
        ("VE expected", f"{volumetric.before.aligned_um:.2f} µm aligned"),
        ("VCE expected", f"{volumetric.after.aligned_um:.2f} µm aligned"),
        ("benefit", f"{volumetric.percent:.1f} % of the volumetric error removed"),
        ("preflight", "passed: no collision, no limit" if found.preflight_passed else "vetted, not run"),
        *((one.name, f"{one.size} readings, joined; their time is not counted") for one in found.problem.instruments),
        *((rival.name, f"{rival.vce_um:.2f} µm in {rival.minutes:.1f} min") for rival in rivals),
        ("took", f"{seconds:.1f} s"),
    ]
    console.print(facts_table(rows, title="position set by design"))
    if places:
        console.print(_stations(places), markup=False)
    if found.held_out:
        console.print(_verification(found), markup=False)
    if best.variant.made_up:
        console.print(
            "note: this artefact is not the one in the settings; have it made and calibrated first", style="yellow"
        )
    for path in files:
        console.print(str(path), markup=False)


def _stations(places: Mapping[int, Array]) -> str:
    """Return the text of the section `[stations]` to be copied into the settings file."""
    listed = ", ".join("[" + ", ".join(str(float(one)) for one in places[number]) + "]" for number in sorted(places))
    return f"for the settings:\n[stations]\nplaces_mm = [{listed}]"


def _verification(found: DesignResult) -> str:
    """Return the text of the section `[verification]` to be copied into the settings file."""
    orientations = list(dict.fromkeys((p.azimuth_deg, p.elevation_deg) for p in found.held_out))
    stations = sorted({p.station for p in found.held_out})
    listed = ", ".join(f"[{azimuth:g}, {elevation:g}]" for azimuth, elevation in orientations)
    return f"for the settings:\n[verification]\npositions_deg = [{listed}]\nstations = {stations}"


def _comparison(choices: list[VariantDesign]) -> Table:
    table = columns_table(
        ("touches", "balls", "of them measured", "θ / °", "positions", "min", "VCE / µm", "benefit / %", "")
    )
    for choice in choices:
        variant, found = choice.variant, choice.design
        theta = "as it is" if variant.theta_deg is None else f"{variant.theta_deg:g}"
        head = (str(variant.touches), str(variant.balls), f"{100.0 * variant.ball_share:.0f} %", theta)
        if found is None:
            table.add_row(*head, "", "", "", "", choice.reason)
            continue
        worth = (f"{found.minutes:.1f}", f"{found.valuation.after.aligned_um:.2f}", f"{found.valuation.percent:.1f}")
        table.add_row(*head, str(len(found.positions)), *worth, "written" if choice.best else "")
    return table
