"""Creation of the configured compensation store."""

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
    """Compensation store with a self-diagnosis."""

    def diagnose(self) -> list[DiagnosticFinding]:
        """Return findings; reads only."""
        ...


def create_store(
    settings: CompensationSettings, pins: Pins, clock: Clock, *, base_path: Path, device: str
) -> LinuxCncStore:
    """Create the store without reading or writing yet.

    A relative directory is relative to `base_path`; `device` is the device's name in errors.
    """
    directory = base_path / settings.directory
    if settings.method == "comp-files":
        banks = Banks(settings, directory, Activation.POWER_CYCLE, device)
        return CompFileStore(pins, banks, settings.accepted_loss_um * 1e-3)
    banks = Banks(settings, directory, Activation.IMMEDIATE, device)
    return LiveStore(pins, banks, clock, settings.timeout_s)
