"""Simulated operator that moves the artefact of a simulated machine over the machine's control channel."""

from __future__ import annotations

import json
import socket
from contextlib import suppress

import structlog
from pydantic import Field

from drivers.clock import Clock
from drivers.errors import CommandRejected, LinkLost, LinkTimeout, ProtocolError
from drivers.foreign_errors import cause_of
from drivers.options import DriverOptions
from drivers.registry import DeviceContext, DriverPlugin
from drivers.roles import DiagnosticFinding, OperatorRequest, OperatorTask, PlacementRequest
from twin.units import S_PER_MIN

LONGEST_ANSWER = 65536
log = structlog.get_logger()


class SimulatedOperatorSettings(DriverOptions):
    """Address on which `volcal simulate` listens for control requests, as printed in its first line of output.

    `carrying_minutes` is the machine time that the person takes to put the artefact in its place.
    """

    host: str = "127.0.0.1"
    port: int = Field(ge=1, le=65535)
    response_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)
    carrying_minutes: float = Field(default=0.0, ge=0.0, le=600.0)


class SimulatedOperator:
    """Simulated person with the role `drivers.roles.Operator`, who fulfils and confirms every request.

    The person takes the time that the settings state, on the clock of the run, so that a simulated run takes as long as
    one with a person.
    """

    def __init__(self, settings: SimulatedOperatorSettings, name: str, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._name = name
        self._socket: socket.socket | None = None

    def open(self) -> None:
        self.close()
        try:
            self._socket = socket.create_connection(
                (self._settings.host, self._settings.port), timeout=self._settings.response_timeout_s
            )
        except OSError as error:
            raise self._lost(f"no answer at {self._address}: {cause_of(error)}") from error
        self._request({"do": "status"})

    def close(self) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.close()
            self._socket = None

    def stop(self) -> None:
        """Do nothing: this device starts no motion."""

    def diagnose(self) -> list[DiagnosticFinding]:
        answer = self._request({"do": "status"})
        text = f"simulated machine at {self._address}, machine time {answer.get('machine_time_s')} s"
        return [DiagnosticFinding(self._name, ok=True, text=text)]

    def ask(self, request: OperatorRequest) -> bool:
        """Place the artefact at the requested station or, by hand, in the requested position, and return True (the
        answer yes).

        Raises CommandRejected if the simulator refuses the request, and LinkError if the simulator does not answer.
        """
        if request.task is not OperatorTask.CONSENT:
            if request.station is None:
                raise CommandRejected("the request names no station for the artefact", device=self._name)
            self._clock.sleep(self._settings.carrying_minutes * S_PER_MIN)
            if isinstance(request, PlacementRequest):
                pose = {"azimuth_deg": request.azimuth_deg, "elevation_deg": request.elevation_deg}
                self._request({"do": "place_by_hand", "station": request.station, **pose})
            else:
                self._request({"do": "place_artefact", "station": request.station})
        log.info("simulated operator finished the task", task=request.task.value, station=request.station)
        return True

    def _request(self, request: dict[str, object]) -> dict[str, object]:
        answer = self._exchange(json.dumps(request).encode() + b"\n")
        if "error" in answer:
            raise CommandRejected(f"the simulator refused: {answer['error']}", device=self._name)
        return answer

    def _exchange(self, line: bytes) -> dict[str, object]:
        if self._socket is None:
            raise self._lost("the control channel is not open")
        try:
            self._socket.sendall(line)
            reply = self._receive_line(self._socket)
        except TimeoutError as error:
            self.close()
            raise LinkTimeout(
                f"no answer within {self._settings.response_timeout_s:g} s", device=self._name, link=self._address
            ) from error
        except OSError as error:
            self.close()
            raise self._lost(cause_of(error)) from error
        return self._decode(reply)

    def _receive_line(self, connection: socket.socket) -> bytes:
        line = b""
        while not line.endswith(b"\n"):
            chunk = connection.recv(4096)
            if not chunk or len(line) > LONGEST_ANSWER:
                raise ConnectionResetError("the simulator closed the connection")
            line += chunk
        return line

    def _decode(self, reply: bytes) -> dict[str, object]:
        try:
            answer = json.loads(reply)
        except ValueError as error:
            raise ProtocolError("answer is not JSON", device=self._name, link=self._address) from error
        if not isinstance(answer, dict):
            raise ProtocolError("answer is not a JSON object", device=self._name, link=self._address)
        return answer

    @property
    def _address(self) -> str:
        return f"{self._settings.host}:{self._settings.port}"

    def _lost(self, reason: str) -> LinkLost:
        return LinkLost(
            reason, device=self._name, link=self._address, hint="is `volcal simulate` running with --control?"
        )


def _create(settings: SimulatedOperatorSettings, context: DeviceContext) -> SimulatedOperator:
    return SimulatedOperator(settings, context.name, context.clock)


PLUGIN = DriverPlugin("simulated-operator", SimulatedOperatorSettings, _create)
