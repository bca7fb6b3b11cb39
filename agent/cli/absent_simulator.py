"""Error of a command whose settings are those of a simulated machine that is not running."""

from __future__ import annotations

from pathlib import Path

from agent.settings.load import read_settings
from agent.settings.simulator_command import command_of_settings
from drivers.errors import ConfigurationError, VolcalError

CLOCK = "clock"
"""Key that the error of a clock without a simulator names."""


def is_absent_simulator(error: VolcalError) -> bool:
    """Return True if `error` says that the time server of a simulator did not accept the connection."""
    return error.where.get("key") == CLOCK and isinstance(error.__cause__, OSError)


def absent_simulator(config: Path) -> ConfigurationError:
    """Return the error that says how to start the simulated machine of the settings file `config`."""
    here = config.resolve().parent == Path.cwd()
    command = command_of_settings(read_settings(config), config)
    start = "`volcal simulate --clock lockstep` with its scenario" if command is None else f"`{command}`"
    return ConfigurationError(
        f"the simulated machine of {'this directory' if here else 'these settings'} is not running",
        hint=f"start it in another terminal with {start}; `volcal calibrate --simulated` starts one for its own run",
        file=str(config),
    )
