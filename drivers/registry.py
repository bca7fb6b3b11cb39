"""Plugins by entry point: a name, a settings model, a factory.

A third party ships a package with an entry point of the group ``volcal.drivers`` that points at a
`DriverPlugin`; nothing here changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from drivers.clock import Clock
from drivers.errors import ConfigurationError
from drivers.roles import Device

ENTRY_POINT_GROUP = "volcal.drivers"


@dataclass(frozen=True)
class DeviceContext:
    """What a driver is given: its name in the configuration, its clock, and where relative paths start."""

    name: str
    clock: Clock
    base_path: Path


@dataclass(frozen=True)
class DriverPlugin:
    """`create(settings, context)` builds a device that is not yet open.

    The device plays every role whose Protocol in `drivers.roles` it implements. `claims(settings)`: what no other
    device of the same machine may use as well, as text for people, with the option that says so. `several_mounts`:
    whether it stands for a mount at each station (`drivers.roles.MultiStationMount`).
    """

    name: str
    settings: type[BaseModel]
    create: Callable[[Any, DeviceContext], Device]
    claims: Callable[[Any], Mapping[str, str]] = lambda _: {}
    several_mounts: bool = False


def installed_plugins() -> list[str]:
    """Names of the plugins that are installed, in alphabetical order; none of them is loaded."""
    return sorted(entry.name for entry in _entries())


def create_device(driver: str, options: Mapping[str, object], context: DeviceContext) -> Device:
    """The device that plugin `driver` builds from `options`; not open yet."""
    plugin = _plugin(driver, context.name)
    return plugin.create(_validated(plugin, options, context.name), context)


def check_options(driver: str, options: Mapping[str, object], name: str) -> Mapping[str, str]:
    """What the device claims for itself. ConfigurationError for an unknown driver or options that it refuses."""
    plugin = _plugin(driver, name)
    return plugin.claims(_validated(plugin, options, name))


def has_several_mounts(driver: str, name: str) -> bool:
    """Whether one device of `driver` stands for a mount at each station."""
    return _plugin(driver, name).several_mounts


def _plugin(driver: str, name: str) -> DriverPlugin:
    """Only the one that is asked for is loaded: another that is broken, or heavy, is no concern of this machine."""
    named = [entry for entry in _entries() if entry.name == driver]
    if not named:
        raise ConfigurationError(
            f"unknown driver {driver!r}",
            key=f"devices.{name}.driver",
            hint=f"installed drivers: {', '.join(installed_plugins())}",
        )
    try:
        plugin = named[0].load()
    except (ImportError, AttributeError) as error:
        raise ConfigurationError(
            f"driver plugin {driver!r} cannot be imported: {error}",
            hint=f"reinstall the package that provides it ({named[0].value})",
        ) from error
    if not isinstance(plugin, DriverPlugin):
        raise ConfigurationError(f"entry point {driver!r} is not a DriverPlugin", hint=f"it points at {named[0].value}")
    return plugin


@lru_cache(maxsize=1)
def _entries() -> tuple[EntryPoint, ...]:
    """What was installed when this process first asked."""
    return tuple(entry_points(group=ENTRY_POINT_GROUP))


def _validated(plugin: DriverPlugin, options: Mapping[str, object], name: str) -> BaseModel:
    try:
        return plugin.settings.model_validate(dict(options))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = ".".join(["devices", name, "options", *(str(part) for part in first["loc"])])
        known = ", ".join(sorted(plugin.settings.model_fields))
        raise ConfigurationError(first["msg"], key=key, hint=f"options of driver {plugin.name}: {known}") from error
