"""Compensation store for LinuxCNC with two banks of tables.

LinuxCNC applies the tables by one of three methods: external offsets, volcal's own kinematics module, or
screw-compensation files.
"""

from pathlib import Path
from typing import Protocol

from drivers.clock import Clock
from drivers.linuxcnc.compensation.banks import Banks
from drivers.linuxcnc.compensation.comp_files import CompFileStore
from drivers.linuxcnc.compensation.live import LiveStore
from drivers.linuxcnc.compensation.settings import CompensationSettings
from drivers.linuxcnc.pins import Pins
from drivers.roles import Activation, CompensationStore, DiagnosticFinding

__all__ = ["CompensationSettings", "LinuxCncStore", "create_store"]


class LinuxCncStore(CompensationStore, Protocol):
    """Compensation store of LinuxCNC that can also diagnose itself."""

    def diagnose(self) -> list[DiagnosticFinding]:
        """Diagnose the store by reading only, and return the findings."""
        ...


def create_store(
    settings: CompensationSettings, pins: Pins, clock: Clock, *, base_path: Path, device: str
) -> LinuxCncStore:
    """Create the compensation store that the settings select; no file or pin is read or written yet.

    A relative directory in the settings is relative to `base_path`. `device` is the name of the device in error
    messages.
    """
    directory = base_path / settings.directory
    if settings.method == "comp-files":
        banks = Banks(settings, directory, Activation.POWER_CYCLE, device)
        return CompFileStore(pins, banks, settings.accepted_loss_um * 1e-3)
    banks = Banks(settings, directory, Activation.IMMEDIATE, device)
    return LiveStore(pins, banks, clock, settings.timeout_s)
