"""The store that the settings ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from drivers.clock import Clock
from drivers.linuxcnc.compensation.banks import Banks
from drivers.linuxcnc.compensation.comp_files import CompFileStore
from drivers.linuxcnc.compensation.live import LiveStore
from drivers.linuxcnc.compensation.settings import CompensationSettings
from drivers.linuxcnc.pins import Pins
from drivers.roles import Activation, CompensationStore, DiagnosticFinding


class LinuxCncStore(CompensationStore, Protocol):
    """A store that can be diagnosed."""

    def diagnose(self) -> list[DiagnosticFinding]:
        """Reads only."""
        ...


def create_store(
    settings: CompensationSettings, pins: Pins, clock: Clock, *, base_path: Path, device: str
) -> LinuxCncStore:
    """`base_path`: where a relative directory starts; `device`: its name in errors. Reads and writes nothing yet."""
    directory = base_path / settings.directory
    if settings.way == "comp-files":
        banks = Banks(settings, directory, Activation.POWER_CYCLE, device)
        return CompFileStore(pins, banks, settings.accepted_loss_um * 1e-3)
    banks = Banks(settings, directory, Activation.IMMEDIATE, device)
    return LiveStore(pins, banks, clock, settings.within_s)
