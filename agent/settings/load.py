"""Functions that load the settings from their file and apply the overrides of the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from agent.files import read_text, translated
from agent.settings.schema import Settings, parse_settings
from drivers.errors import ConfigurationError, InputError, UserError
from drivers.registry import check_options
from twin.errors import FormatError
from twin.formats.toml_reading import validate_document

POSITION_FILES = (".csv", ".toml")


def read_settings(path: Path) -> Settings:
    """Read settings from a file and make the paths in them absolute. Raises ConfigurationError if the settings are
    invalid.

    The options of the devices are not validated, so no driver is loaded. This function suffices for commands that only
    communicate with the service or read its stored results.
    """
    text = read_text(path, error=ConfigurationError)
    with translated(ConfigurationError, file=str(path)):
        return parse_settings(text, str(path)).resolved(path.resolve().parent)


def load_settings(path: Path) -> Settings:
    """Read settings from a file like `read_settings`, and also validate the options of every device. Raises
    ConfigurationError if anything is invalid."""
    settings = read_settings(path)
    try:
        _check_devices(settings)
    except ConfigurationError as error:
        raise error.at(file=str(path)) from error.__cause__
    return settings


@contextmanager
def naming(config: Path) -> Iterator[None]:
    """Add the path of the settings file to every UserError raised in the `with` block, unless the error already names a
    file, or an option of the command line."""
    try:
        yield
    except UserError as error:
        named = error if "option" in error.where else error.at(file=str(config))
        raise named from error.__cause__


def with_overrides(
    settings: Settings,
    *,
    position_set: str | None = None,
    stations: Sequence[int] | None = None,
    formulation: str | None = None,
) -> Settings:
    """Return the settings with the overrides of the command line. The result is validated again."""
    document = settings.model_dump()
    if position_set is not None:
        is_file = position_set.endswith(POSITION_FILES)
        document["procedure"]["position_set"] = str(Path(position_set).resolve()) if is_file else position_set
    if stations:
        document["procedure"]["stations"] = list(stations)
        document["verification"]["stations"] = [
            s for s in settings.verification.stations or stations if s in stations
        ] or list(stations)
    if formulation is not None:
        document["identification"]["formulation"] = formulation
    with translated(ConfigurationError):
        return validate_document(document, "command line", Settings)


def stored_settings(document: Mapping[str, Any], run_id: str) -> Settings:
    """Return the settings that the journal stores with a run. Raises InputError if this version cannot read them."""
    try:
        return validate_document(dict(document), "settings in the journal", Settings)
    except FormatError as error:
        raise InputError(
            f"another version of volcal stored the settings of this run: {error.message}",
            hint="Start a new run; the version that wrote this one can read it",
            run=run_id,
            key=error.where["key"],
        ) from error


def _check_devices(settings: Settings) -> None:
    """Raise ConfigurationError if a driver is missing, refuses its options, or shares a resource with another device,
    or if a role names an unknown device. Nothing is opened."""
    claimed: dict[str, str] = {}
    for name, device in settings.devices.items():
        for claim, option in check_options(device.driver, device.options, name).items():
            first = claimed.setdefault(claim, name)
            if first != name:
                raise ConfigurationError(
                    f"{claim} is already used by device {first!r}", key=f"devices.{name}.options.{option}"
                )
    for role, named in settings.roles:
        for name in [named] if isinstance(named, str) else (named or {}).values():
            if name not in settings.devices:
                raise ConfigurationError(
                    f"no device {name!r}",
                    key=f"roles.{role}",
                    hint=f"devices are: {', '.join(sorted(settings.devices))}",
                )
