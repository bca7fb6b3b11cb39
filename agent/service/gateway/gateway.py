"""Gateway state that all panel connections share: the control of the service, the command handler and the heartbeats of
service and panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import structlog

from agent.execution.states import FINAL, RunState
from agent.service.allowed_requests import HOLD
from agent.service.control import Control, Status
from agent.service.gateway.access import AccessCode
from agent.service.gateway.command_handler import CommandHandler
from agent.service.gateway.heartbeat import Heartbeats
from agent.service.gateway.register_codec import number_words, text_words
from agent.service.gateway.registers import (
    FLAGS,
    KIND_NUMBERS,
    MAP_VERSION,
    MAY,
    PACKML_NUMBERS,
    STATE_NUMBERS,
    STATUS,
    UNKNOWN,
    Form,
    Result,
)
from drivers.errors import VolcalError

log = structlog.get_logger()
_AT_REST = FINAL | {RunState.IDLE, RunState.WRITTEN}
_UNKNOWN_WORD = UNKNOWN[Form.U16]


@dataclass(frozen=True)
class Gateway:
    """Gateway state that all panel connections share.

    `on_panel_timeout` is the reaction if the panel's heartbeat is lost during a run that a panel has started: ``note``
    logs the loss, ``hold`` also holds the run, once in each silence of the panel and as soon as the run can be held.
    """

    control: Control
    handler: CommandHandler
    access: AccessCode
    heartbeats: Heartbeats
    on_panel_timeout: Literal["note", "hold"]

    def status(self) -> Status:
        return self.control.status()

    def image(self) -> tuple[int, ...]:
        """Return the content of all status registers.

        The sequence number of the last accepted panel command is read before the status. A panel that finds its own
        sequence number there therefore also finds the status after its command, never an earlier status.
        """
        accepted, result = self.handler.state()
        facts = GatewayFacts(
            heartbeat=self.heartbeats.service_beat,
            panel_alive=self.heartbeats.panel_alive,
            access_code_set=self.access.is_set,
            accepted_sequence=accepted,
            result=result,
        )
        return status_image(self.status(), facts)

    def tick(self) -> None:
        """Update the heartbeats of service and panel, and the time for which all access codes are refused after a wrong
        access code. This method must be called once per second."""
        self.access.tick()
        status = self._status_or_none()
        if self.heartbeats.tick(service_alive=status is not None):
            log.warning("panel heartbeat lost", then=self.on_panel_timeout)
        if status is not None and self.on_panel_timeout == "hold":
            self._hold_if_due(status)

    def _hold_if_due(self, status: Status) -> None:
        # Not only when the timeout expires: a run cannot be held then if, for example, its preflight is in progress.
        run_id = status.run_id
        if run_id is None or run_id != self.handler.latest_start or HOLD not in status.may:
            return
        if not self.heartbeats.hold_due(run_id):
            return
        try:
            self.control.hold()
        except VolcalError as error:
            log.info("run not held after loss of the panel heartbeat", reason=str(error))
        else:
            self.heartbeats.held(run_id)

    def _status_or_none(self) -> Status | None:
        try:
            return self.status()
        except Exception:
            log.exception("status not available")
            return None


@dataclass(frozen=True)
class GatewayFacts:
    """Values of those status registers that describe the gateway itself. The status of the service does not contain
    them."""

    heartbeat: int = 0
    panel_alive: bool = False
    access_code_set: bool = False
    accepted_sequence: int = 0
    result: int = Result.NONE


def status_image(status: Status, facts: GatewayFacts) -> tuple[int, ...]:
    """Return the content of the whole block of status registers, given the status of the service and `facts`, the
    values that describe the gateway itself."""
    values = {**_run_values(status), **_waiting_values(status), **_gateway_values(status, facts)}
    words: list[int] = []
    for register in STATUS:
        value = values[register.name]
        words += text_words(register, value) if isinstance(value, str) else number_words(register, value)
    return tuple(words)


def _run_values(status: Status) -> dict[str, float | str | None]:
    return {
        "state": STATE_NUMBERS.get(status.state, _UNKNOWN_WORD),
        "packml_state": PACKML_NUMBERS.get(status.packml, 0),
        "kind": KIND_NUMBERS.get(status.kind or "", 0),
        "progress": 10000 * status.fraction,
        "minutes_left": _scaled(100, status.minutes_left),
        "ve_before": _scaled(1000, status.ve_before_um),
        "ve_now": _scaled(1000, status.ve_now_um),
        "balls": status.balls,
        "touches": status.touches,
        "active_bank": status.active_bank,
        "position_set": status.position_set or "",
        "run": status.run_id or "",
        "doing": status.doing,
    }


def _waiting_values(status: Status) -> dict[str, float | str | None]:
    """Return the values that require action, by register name: the alarms, the open question, and the bank that is
    written but not active.
    """
    question = status.question
    codes = [alarm.code for alarm in status.alarms[:4]] + [0] * 4
    return {
        "may": _bits(MAY, status.may),
        "bank_waiting": status.written_not_active,
        "alarm_count": len(status.alarms),
        **{f"alarm_{place}": codes[place - 1] for place in range(1, 5)},
        "alarm_text": status.alarms[0].text if status.alarms else "",
        "question_number": question.number if question else 0,
        "question_station": question.station if question else None,
        "question_text": question.text if question else "",
    }


def _gateway_values(status: Status, facts: GatewayFacts) -> dict[str, float | str | None]:
    holds = {
        "running": status.state not in _AT_REST,
        "alarm": bool(status.alarms),
        "question": status.question is not None,
        "bank_waiting": status.written_not_active is not None,
        "unfinished_run": status.unfinished is not None,
        "unproved_table": status.unproved is not None,
        "panel_alive": facts.panel_alive,
        "access_code_set": facts.access_code_set,
    }
    return {
        "map_version": MAP_VERSION,
        "heartbeat": facts.heartbeat & 0xFFFF,
        "flags": _bits(FLAGS, frozenset(name for name, true in holds.items() if true)),
        "accepted_sequence": facts.accepted_sequence,
        "result": facts.result,
    }


def _bits(names: tuple[str, ...], set_ones: frozenset[str]) -> int:
    return sum(1 << place for place, name in enumerate(names) if name in set_ones)


def _scaled(factor: float, value: float | None) -> float | None:
    return None if value is None else factor * value
