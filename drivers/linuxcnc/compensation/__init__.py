"""Compensation store for LinuxCNC with two banks of tables.

LinuxCNC applies the tables by one of three methods: external offsets, volcal's own kinematics module, or
screw-compensation files.
"""

from drivers.linuxcnc.compensation.factory import LinuxCncStore, create_store
from drivers.linuxcnc.compensation.settings import CompensationSettings

__all__ = ["CompensationSettings", "LinuxCncStore", "create_store"]
