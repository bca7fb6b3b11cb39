"""Limits that stop a drive: limit switches (0x60FD), software limits of the drive (0x607D), and following error."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.canopen_mount import objects
from drivers.canopen_mount.node import DriveNode
from drivers.canopen_mount.scale import AxisScale

SWITCHES = {-1: "negative limit switch", 1: "positive limit switch"}
"""Names of the limit switches (bits 0 and 1 of 0x60FD), by the direction of counts in which each blocks motion."""


@dataclass(frozen=True)
class SoftLimits:
    """Lower and upper software limit of a drive in encoder counts, as in object 0x607D."""

    lower: int
    upper: int

    def contains(self, counts: int) -> bool:
        return self.lower <= counts <= self.upper


def read_soft_limits(node: DriveNode) -> SoftLimits | None:
    """Return the software limits stored in the drive; None if there are none or if they are disabled.

    The limits are disabled if the lower limit is not below the upper one.
    """
    lower, upper = node.read_optional(objects.LOWER_LIMIT), node.read_optional(objects.UPPER_LIMIT)
    if lower is None or upper is None or lower >= upper:
        return None
    return SoftLimits(lower, upper)


def active_switches(node: DriveNode) -> dict[int, str]:
    """Return the names of a drive's active limit switches, keyed by the direction in which each switch blocks motion.

    The direction is 1 for increasing encoder counts and -1 for decreasing counts.
    """
    inputs = node.read_optional(objects.DIGITAL_INPUTS) or 0
    return {direction: name for direction, name in SWITCHES.items() if inputs & (1 if direction < 0 else 2)}


def blocking_limit(node: DriveNode, target: int, direction: int) -> str:
    """Return a text that names the limit that blocks a turn to `target` counts; an empty string if no limit is known.

    `direction` is 1 for increasing encoder counts and -1 for decreasing counts.
    """
    switch = active_switches(node).get(direction)
    if switch is not None:
        return f"the {switch} is active (0x60FD)"
    limits = read_soft_limits(node)
    if limits is not None and not limits.contains(target):
        return f"the target {target} is outside the drive's software limits {limits.lower} ... {limits.upper} (0x607D)"
    return ""


def describe_unreached_target(node: DriveNode, scale: AxisScale, target: int, direction: int) -> str:
    """Return a text that explains why a turn of a drive has not reached its target.

    The text gives the position, the limit that blocks the turn (if there is one), and the following error. `direction`
    is 1 for increasing encoder counts and -1 for decreasing counts.
    """
    parts = [f"at {scale.angle_deg(node.read(objects.POSITION)):.4f} of {scale.angle_deg(target):.4f} degrees"]
    if reason := blocking_limit(node, target, direction):
        parts.append(reason)
    distance = node.read_optional(objects.FOLLOWING_DISTANCE)
    if distance is not None:
        parts.append(f"following error {abs(distance) / float(scale.counts_per_degree):.4f} degrees (0x60F4)")
    return ", ".join(parts)
