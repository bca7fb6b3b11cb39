"""Differences between GRBL 1.1 and grblHAL as far as a program at the other end of the serial line notices them.

Sources: gnea/grbl, grbl/protocol.c, system.c, report.c, config.h; grblHAL/core, protocol.c, report.c, machine_limits.c,
motion_control.c.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True)
class GrblDialect:
    """Behaviour of one controller firmware. `line_buffer` and `receive_buffer` are in bytes.

    The fields of type bool name what grblHAL does and GRBL 1.1 does not.
    """

    name: str
    welcome: str
    build_info: tuple[str, ...]
    line_buffer: int
    receive_buffer: int
    planner_blocks: int
    repeats_errors: bool
    """After a refused line every further block is answered with the same error, until an empty line, a ``$`` command, a
    jog cancel or a reset.
    """
    reports_when_critical: bool
    """A status query is answered also after alarms 1 and 2; GRBL 1.1 is silent until it is reset."""
    pull_off_shrinks_travel: bool
    """With hard limits (``$21``) the soft limits end one pull-off distance (``$27``) before the switches."""
    cancel_jog_empties_buffer: bool
    """A jog cancel (0x85) discards the lines that wait in the receive buffer, in every state. They are not answered."""
    reports_homed: bool
    """A status report after a reset or a homing contains ``H:0`` or ``H:1``."""
    alarm_when_not_homed: int | None
    """Alarm raised at power-on if the machine must be homed first. GRBL 1.1 gives no code."""


GRBL_11: Final = GrblDialect(
    name="grbl",
    welcome="Grbl 1.1h ['$' for help]",
    build_info=("[VER:1.1h.20190830:volcal simulated machine]", "[OPT:VL,15,128]"),
    line_buffer=80,
    receive_buffer=128,
    planner_blocks=15,
    repeats_errors=False,
    reports_when_critical=False,
    pull_off_shrinks_travel=False,
    cancel_jog_empties_buffer=False,
    reports_homed=False,
    alarm_when_not_homed=None,
)
GRBL_HAL: Final = GrblDialect(
    name="grblhal",
    welcome="GrblHAL 1.1f ['$' or '$HELP' for help]",
    build_info=(
        "[VER:1.1f.20250514:volcal simulated machine]",
        "[OPT:VNMGL,35,1024,3,0]",
        "[AXS:3:XYZ]",
        "[NEWOPT:ENUMS,RT-,HOME,ES,REBOOT]",
        "[FIRMWARE:grblHAL]",
        "[SIGNALS:HSREDP]",
        "[NVS STORAGE:*FLASH]",
        "[DRIVER:simulated]",
    ),
    line_buffer=257,
    receive_buffer=1024,
    planner_blocks=35,
    repeats_errors=True,
    reports_when_critical=True,
    pull_off_shrinks_travel=True,
    cancel_jog_empties_buffer=True,
    reports_homed=True,
    alarm_when_not_homed=11,
)
DIALECTS: Final = {dialect.name: dialect for dialect in (GRBL_11, GRBL_HAL)}
