"""Gateway state that all panel connections share: the control of the service, the command handler and the heartbeats of
service and panel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import structlog

from agent.service.control import Control, Status
from agent.service.gateway.access import AccessCode
from agent.service.gateway.command_handler import CommandHandler
from agent.service.gateway.heartbeat import Heartbeats
from agent.service.gateway.status_registers import GatewayFacts, status_image
from drivers.errors import VolcalError

log = structlog.get_logger()


@dataclass(frozen=True)
class Gateway:
    """Gateway state that all panel connections share.

    `on_panel_timeout` is the reaction if the panel's heartbeat is lost during a run that a panel has started: ``note``
    logs the loss, ``hold`` also holds the run.
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
            ours = status is not None and status.run_id is not None and status.run_id == self.handler.latest_start
            if ours and self.on_panel_timeout == "hold":
                self._hold()

    def _hold(self) -> None:
        try:
            self.control.hold()
        except VolcalError as error:
            log.info("run not held after loss of the panel heartbeat", reason=str(error))

    def _status_or_none(self) -> Status | None:
        try:
            return self.status()
        except Exception:
            log.exception("status not available")
            return None
