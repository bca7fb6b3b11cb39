"""Command line that starts the simulated machine of a settings file, for comments and for errors."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from agent.settings.schema import Settings

SCENARIO_FILE = "simulator.toml"
"""Scenario of a machine in a directory of its own; that of a shipped case is in the folder `SHIPPED_SCENARIOS`."""
SHIPPED_SCENARIOS = "simulators"
MODBUS, GRBL = "modbus-cnc", "serial-cnc"


def simulate_command(
    scenario: str,
    *,
    time: str,
    modbus: str | None = None,
    modbus_rtu: str | None = None,
    serial: str | None = None,
    can: str | None = None,
    control: str | None = None,
) -> str:
    """Return the command that simulates `scenario` in lockstep at these addresses, each as its option is written."""
    links = {
        "--modbus": modbus,
        "--modbus-rtu": modbus_rtu,
        "--serial": serial,
        "--can": can,
        "--control": control,
    }
    named = " ".join(f"{option} {address}" for option, address in links.items() if address is not None)
    return f"volcal simulate --config {scenario} {named} --clock lockstep --time {time}".replace("  ", " ")


def command_of_settings(settings: Settings, config: Path) -> str | None:
    """Return the command that starts the simulated machine to which the settings in the file `config` refer. It is None
    if its scenario is not found."""
    shipped = config.parent / SHIPPED_SCENARIOS / config.name
    scenario = next((path for path in (config.parent / SCENARIO_FILE, shipped) if path.is_file()), None)
    if scenario is None:
        return None
    devices = settings.devices.values()
    modbus = [device.options for device in devices if device.driver == MODBUS]
    serial = [str(device.options["port"]) for device in devices if device.driver == GRBL]
    mounts = [device.options for device in devices if device.driver == "canopen-mount"]
    operators = [device.options for device in devices if device.driver == "simulated-operator"]
    return simulate_command(
        str(scenario),
        time=f"{settings.clock.host}:{settings.clock.port}",
        modbus=_first(_address(options) for options in modbus if "serial" not in options),
        modbus_rtu=_first(options["serial"].get("port") for options in modbus if "serial" in options),
        serial=_first(serial),
        can=_first(_can_channel(options) for options in mounts),
        control=_first(_address(options) for options in operators),
    )


def _first(addresses: Iterable[str | None]) -> str | None:
    return next(iter(addresses), None)


def _address(options: Mapping[str, Any]) -> str:
    return f"{options['host']}:{options['port']}"


def _can_channel(options: Mapping[str, Any]) -> str:
    """Return the channel of a mount as `volcal simulate --can` takes it."""
    interface, bus = options["interface"], options.get("options", {})
    if {"host", "port"} <= set(bus):
        return f"{interface}:{_address(bus)}"
    return f"{interface}:{options['channel']}"
