"""Driver plugins, which are found by their entry points.

A third party adds a driver by installing a package with an entry point in the group ``volcal.drivers``. The entry point
refers to a `DriverPlugin`. volcal's own code need not change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ValidationError

from drivers.clock import Clock
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    from drivers.roles import Device

ENTRY_POINT_GROUP = "volcal.drivers"


@dataclass(frozen=True)
class DeviceContext:
    """Inputs to a driver in addition to its settings.

    They are the configured name of the device, the clock, and the base directory of relative paths.
    """

    name: str
    clock: Clock
    base_path: Path


@dataclass(frozen=True)
class DriverPlugin:
    """Name, settings model and device factory of a driver.

    `create(settings, context)` returns a device that is not yet open. The device has every role whose Protocol in
    `drivers.roles` it implements. `claims(settings)` returns the resources that no other device of the same machine may
    use. Each resource is a readable text and is mapped to the option that claims it. `several_mounts` is True if the
    device serves a mount at each of several stations, the places of a mount along the machine's long axis
    (`drivers.roles.MultiStationMount`).
    """

    name: str
    settings: type[BaseModel]
    create: Callable[[Any, DeviceContext], Device]
    claims: Callable[[Any], Mapping[str, str]] = lambda _: {}
    several_mounts: bool = False


def installed_plugins() -> list[str]:
    """Return the names of the installed plugins in alphabetical order, without loading the plugins."""
    return sorted(entry.name for entry in _entries())


def create_device(driver: str, options: Mapping[str, object], context: DeviceContext) -> Device:
    """Create a device with the plugin `driver` from `options`, and return the device before it is opened."""
    plugin = _plugin(driver, context.name)
    return plugin.create(_validated(plugin, options, context.name), context)


def check_options(driver: str, options: Mapping[str, object], name: str) -> Mapping[str, str]:
    """Check the options of a device, and return the resources that only this device may use.

    Each resource is mapped to the option that claims it. Raises ConfigurationError if the driver is unknown or an
    option is invalid.
    """
    plugin = _plugin(driver, name)
    return plugin.claims(_validated(plugin, options, name))


def has_several_mounts(driver: str, name: str) -> bool:
    """Return True if a single device of plugin `driver` serves one mount at each of several stations."""
    return _plugin(driver, name).several_mounts


def _plugin(driver: str, name: str) -> DriverPlugin:
    """Load and return the plugin `driver`; others are not loaded, since they may be broken or slow to import."""
    named = [entry for entry in _entries() if entry.name == driver]
    if not named:
        raise ConfigurationError(
            f"unknown driver {driver!r}",
            key=f"devices.{name}.driver",
            hint=f"choose one of the installed drivers: {', '.join(installed_plugins())}",
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
    """Return the entry points of all installed plugins, looked up once per process."""
    return tuple(entry_points(group=ENTRY_POINT_GROUP))


def _validated(plugin: DriverPlugin, options: Mapping[str, object], name: str) -> BaseModel:
    try:
        return plugin.settings.model_validate(dict(options))
    except ValidationError as error:
        problems = error.errors(include_url=False)
        first = min(problems, key=lambda problem: problem["type"] != "extra_forbidden")  # it explains a missing one
        key = ".".join(["devices", name, "options", *(str(part) for part in first["loc"])])
        known = ", ".join(sorted(plugin.settings.model_fields))
        raise ConfigurationError(first["msg"], key=key, hint=f"options of driver {plugin.name}: {known}") from error
