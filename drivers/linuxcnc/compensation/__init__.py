"""Compensation store for LinuxCNC: two banks of tables, applied by one of three methods."""

from drivers.linuxcnc.compensation.factory import LinuxCncStore, create_store
from drivers.linuxcnc.compensation.settings import CompensationSettings

__all__ = ["CompensationSettings", "LinuxCncStore", "create_store"]
