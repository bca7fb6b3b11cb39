"""Registers and abort coil of one panel connection.

All connections read the same status. A value that a panel writes into the command registers remains a draft of its own
connection until the panel writes the sequence number of the command. Commands of two panels therefore cannot mix, and a
draft is discarded when its connection closes.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.execution.states import RunState
from agent.service.gateway.command_block import FIRST, SIZE, read_command
from agent.service.gateway.frames import ExceptionCode, RegisterError
from agent.service.gateway.gateway import Gateway
from agent.service.gateway.registers import ABORT_COIL, IN_COMMAND, PANEL, STATUS

_SEQUENCE = IN_COMMAND["sequence"].address - FIRST
_CODE = slice(IN_COMMAND["access_code"].address - FIRST, IN_COMMAND["access_code"].end - FIRST)
_BEAT = PANEL[0].address


class PanelSession:
    """Registers and abort coil of one panel connection, with the interface `RegisterTable`, through which decoded
    requests read and write them. Only one thread may use the object."""

    def __init__(self, gateway: Gateway) -> None:
        self._gateway = gateway
        self._draft = [0] * SIZE

    def read(self, address: int, count: int) -> Sequence[int]:
        if _within(address, count, STATUS[0].address, STATUS[-1].end):
            return self._gateway.image()[address : address + count]
        if _within(address, count, FIRST, FIRST + SIZE):
            shown = [*self._draft]
            shown[_CODE] = (0, 0)
            return shown[address - FIRST : address - FIRST + count]
        if (address, count) == (_BEAT, 1):
            return (self._gateway.heartbeats.panel_beat or 0,)
        raise RegisterError(ExceptionCode.ADDRESS)

    def write(self, address: int, words: Sequence[int]) -> None:
        if (address, len(words)) == (_BEAT, 1):
            self._gateway.heartbeats.beat(words[0])
            return
        if not _within(address, len(words), FIRST, FIRST + SIZE):
            raise RegisterError(ExceptionCode.ADDRESS)
        start = address - FIRST
        draft = [*self._draft]
        draft[start : start + len(words)] = words
        if start <= _SEQUENCE < start + len(words):
            self._commit(draft)
        else:
            self._draft = draft

    def _commit(self, draft: Sequence[int]) -> None:
        """Submit the draft as a command. Clear the draft even if the command fails, so that the next command inherits
        neither its consent nor its access code.
        """
        self._draft = [0] * SIZE
        self._gateway.handler.submit(read_command(draft))

    def read_coils(self, address: int, count: int) -> Sequence[bool]:
        if (address, count) != (ABORT_COIL, 1):
            raise RegisterError(ExceptionCode.ADDRESS)
        return (self._gateway.status().state is RunState.ABORTING,)

    def write_coils(self, address: int, states: Sequence[bool]) -> None:
        if (address, len(states)) != (ABORT_COIL, 1):
            raise RegisterError(ExceptionCode.ADDRESS)
        if states[0]:
            self._gateway.handler.abort()


def _within(address: int, count: int, start: int, end: int) -> bool:
    return start <= address and address + count <= end
