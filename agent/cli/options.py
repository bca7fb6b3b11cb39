"""Command-line options shared by several commands."""

from __future__ import annotations

import re
from pathlib import Path

import click

PATH = click.Path(path_type=Path)
"""Type of options whose value is a file or a folder."""

_DURATION = re.compile(r"(\d+(?:\.\d+)?)\s*(min|h|)")


class Duration(click.ParamType[float]):
    """Type of command-line options whose value is a duration such as `15min` or `1.5h`.

    The converted value is in minutes. A number without a unit is read as minutes.
    """

    name = "duration"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        found = _DURATION.fullmatch(str(value).strip())
        if found is None or float(found[1]) <= 0.0:
            self.fail(f"{value!r} is not a duration; write it as 15min or 1.5h", param, ctx)
        return float(found[1]) * (60.0 if found[2] == "h" else 1.0)


def config_option(command: click.decorators.FC) -> click.decorators.FC:
    """Add the option `--config`, the path of the agent's settings file, to a command."""
    option = click.option(
        "--config",
        "config",
        type=PATH,
        default=Path("volcal.toml"),
        show_default=True,
        help="Settings file of the agent.",
    )
    return option(command)


def procedure_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add to a command the options `--config`, `--position-set`, `--stations` and `--formulation` (whether the errors
    of the machine are identified from ball centres or from distances).
    """
    return measured_options(click.option("--formulation", type=click.Choice(["centres", "distances"]))(command))


def measured_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add to a command the options `--config` (settings file), `--position-set` and `--stations` (the positions and
    stations of the artefact that are measured).
    """
    for option in (
        click.option("--stations", metavar="1,2,…", callback=_station_list, help="Stations at which to measure."),
        click.option("--position-set", metavar="SET", help="S1, S2, S3, joined by +, or a position file."),
        config_option,
    ):
        command = option(command)
    return command


def _station_list(_: click.Context, __: click.Parameter, text: str | None) -> list[int] | None:
    if text is None:
        return None
    try:
        stations = [int(part) for part in text.split(",")]
    except ValueError:
        raise click.BadParameter("write station numbers separated by commas, such as 1,2") from None
    if min(stations) < 1 or len(set(stations)) < len(stations):
        raise click.BadParameter("stations count from 1 and are listed once each")
    return stations
