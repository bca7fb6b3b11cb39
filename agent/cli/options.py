"""Command-line options shared by several commands."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from agent.figures import FIGURE_ENDINGS
from drivers.errors import ConfigurationError

SETTINGS_FILE = Path("volcal.toml")
"""Settings file of a command that names none: that of the current directory."""

_CASE = "volcal.case"
"""Key in the context of a command under which the option `--case` stores its settings file for `--config`."""

PATH = click.Path(path_type=Path)
"""Type of options whose value is a file or a folder."""


class FigureFile(click.Path):
    """Type of options whose value is a file with a figure, in the format that its ending says."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        path = Path(str(super().convert(value, param, ctx)))
        if path.suffix.lower() not in FIGURE_ENDINGS:
            self.fail(f"'{path.name}' must end with one of {', '.join(FIGURE_ENDINGS)}", param, ctx)
        return path


FIGURE = FigureFile(path_type=Path)

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
    """Add the option `--config`, the path of the agent's settings file, to a command. Without the option the settings
    file of the current directory is used; a ConfigurationError says what to do if there is none.
    """
    return _config_option(_settings_file)(command)


def case_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add the options `--config` and `--case` to a command that answers for one machine without contacting it.

    The command receives the settings file as its parameter `config`: that of the option `--config`, that of the
    shipped case which `--case` names, or that of the current directory. A ConfigurationError says what to do if there
    is none.
    """
    return _config_option(_settings_file)(_case_option(command))


def optional_case_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add the options `--config` and `--case` to a command that can do without a settings file. The parameter `config`
    of the command is chosen as by `case_options`; it is None if no file is named and the current directory has none.
    """
    return _config_option(_settings_file_or_none)(_case_option(command))


def instruments_option(meaning: str) -> Callable[[click.decorators.FC], click.decorators.FC]:
    """Return a decorator that adds the option `--instrument`, files with readings of other instruments, to a command.
    `meaning` says in the help of the option what the command does with them."""
    return click.option(
        "--instrument",
        "instruments",
        type=PATH,
        multiple=True,
        metavar="FILE.csv",
        help=f"{meaning} May be given several times.",
    )


def no_settings_file() -> ConfigurationError:
    """Return the error of a command that needs a settings file if none is named and the current directory has none."""
    context = click.get_current_context()
    has_case = any(parameter.name == "case" for parameter in context.command.params)
    return ConfigurationError(
        f"this directory has no {SETTINGS_FILE}",
        hint="name the settings of your machine with --config, write them with `volcal init`"
        + (", or choose a shipped machine with --case case-study" if has_case else ""),
    )


def _config_option(
    callback: Callable[[click.Context, click.Parameter, Path], Path | None],
) -> Callable[[click.decorators.FC], click.decorators.FC]:
    return click.option(
        "--config",
        "config",
        type=PATH,
        default=SETTINGS_FILE,
        show_default=True,
        callback=callback,
        help="Settings file of the agent.",
    )


def _case_option(command: click.decorators.FC) -> click.decorators.FC:
    option = click.option(
        "--case",
        metavar="NAME",
        is_eager=True,  # before --config, whose callback reads it
        expose_value=False,
        callback=_store_case,
        help="Shipped machine instead of a settings file, such as case-study.",
    )
    return option(command)


def _store_case(context: click.Context, _: click.Parameter, name: str | None) -> None:
    if name is not None:
        from agent.planning.case_file import shipped_case  # noqa: PLC0415  imports the mathematics; rarely needed

        context.meta[_CASE] = shipped_case(name).settings


def _settings_file(context: click.Context, parameter: click.Parameter, path: Path) -> Path:
    chosen = _settings_file_or_none(context, parameter, path)
    if chosen is None:
        raise no_settings_file()
    return chosen


def _settings_file_or_none(context: click.Context, _: click.Parameter, path: Path) -> Path | None:
    """Return the settings file of `--case`, else `path`. Return None if `path` is the default and does not exist."""
    given = context.get_parameter_source("config") is not ParameterSource.DEFAULT
    case: Path | None = context.meta.get(_CASE)
    if case is not None:
        if given:
            raise click.UsageError("--config and --case both name the machine: give one of the two")
        return case
    return path if given or path.exists() else None


def procedure_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add to a command the options `--position-set`, `--stations` and `--formulation` (whether the errors of the
    machine are identified from ball centres or from distances).
    """
    return measured_options(click.option("--formulation", type=click.Choice(["centres", "distances"]))(command))


def measured_options(command: click.decorators.FC) -> click.decorators.FC:
    """Add to a command the options `--position-set` and `--stations` (the positions and stations of the artefact that
    are measured)."""
    for option in (
        click.option("--stations", metavar="1,2,…", callback=_station_list, help="Stations at which to measure."),
        click.option("--position-set", metavar="SET", help="S1, S2, S3, joined by +, or a position file."),
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
