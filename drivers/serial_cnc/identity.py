"""Identity of a GRBL controller: its build, settings, offsets and modes. The module reads them and changes nothing."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.clock import Clock, Deadline
from drivers.errors import CommandRejected, ProtocolError
from drivers.serial_cnc.controller_settings import ControllerSettings
from drivers.serial_cnc.conversation import Conversation
from drivers.serial_cnc.lines import MessageLine

MOVING = "Run"
POLL_S = 0.2
RESPONSIVE_STATES = frozenset({"Idle", "Alarm"})
"""States in which the controller answers every query."""


@dataclass(frozen=True)
class ControllerIdentity:
    """Settings of a GRBL controller, with its parameters (lines of ``$#``) and its modes (words of ``$G``)."""

    settings: ControllerSettings
    parameters: list[MessageLine]
    modes: str


def await_rest(conversation: Conversation, clock: Clock, within_s: float) -> None:
    """Wait at most `within_s` seconds on `clock` for the end of a motion that a previous user left running."""
    deadline = Deadline.after(clock, within_s)
    while conversation.report().state == MOVING and not deadline.expired:
        clock.sleep(POLL_S)


def read_identity(conversation: Conversation) -> ControllerIdentity:
    """Read the identity of a controller: its settings, parameters and modes.

    Raises CommandRejected if the controller is busy, and ProtocolError if it is not a GRBL controller.
    """
    report = conversation.report()
    if report.state not in RESPONSIVE_STATES:
        raise CommandRejected(
            f"the controller is in state {report.state}: it reports its settings only while idle",
            hint="finish, resume or reset the activity there, then start again",
            **conversation.where,
        )
    conversation.synchronise()
    lines = conversation.ask("$I")
    if not any(isinstance(line, MessageLine) and line.kind == "VER" for line in lines):
        raise ProtocolError(
            "no version in the answer to $I", hint="GRBL 1.1 or grblHAL is needed", **conversation.where
        )
    settings = ControllerSettings.of([*lines, *conversation.ask("$$")])
    parameters = [line for line in conversation.ask("$#") if isinstance(line, MessageLine)]
    modes = [line.text for line in conversation.ask("$G") if isinstance(line, MessageLine) and line.kind == "GC"]
    if not modes:
        raise ProtocolError("no modes in the answer to $G", hint="GRBL 1.1 or grblHAL is needed", **conversation.where)
    return ControllerIdentity(settings, parameters, modes[0])
