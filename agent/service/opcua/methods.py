"""Execution of OPC UA methods. Each method calls the `Control` of the service, and the errors that it raises become OPC
UA results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

import structlog
from asyncua import ua
from asyncua.ua.status_codes import StatusCodes

from agent.errors import Busy
from agent.runs.run_request import run_request
from agent.service.alarms import alarm_of
from agent.service.control import Alarm, Control
from agent.service.opcua.guard import refusal_result
from agent.service.opcua.model import METHODS, Argument
from drivers.errors import InputError, PermissionMissing, UserError, VolcalError

log = structlog.get_logger()


class MethodCalls:
    """OPC UA methods by name. Any thread except the thread of the server's event loop may call them.

    `last_refusal` is the alarm that describes the most recent refusal of a method; OPC UA itself transmits only a
    status code.
    """

    def __init__(self, control: Control) -> None:
        self._control = control
        self._guard = threading.Lock()
        self._last_refusal: Alarm | None = None
        self._methods: dict[str, Callable[..., str | None]] = {
            "Start": self._start,
            "ResumeRun": lambda: control.resume_run("opc ua"),
            "Hold": control.hold,
            "Resume": control.resume,
            "Abort": self._abort,
            "Reset": control.reset,
            "Answer": control.answer,
        }

    @property
    def last_refusal(self) -> Alarm | None:
        with self._guard:
            return self._last_refusal

    def call(self, name: str, arguments: Sequence[ua.Variant]) -> Any:
        """Execute the method `name`. Return its output arguments or, if it is refused, a call result with the status
        code of the refusal.

        The returned object has the form that asyncua sends.
        """
        try:
            result = self._methods[name](*_values(name, arguments))
        except VolcalError as error:
            log.info("OPC UA method refused", method=name, reason=str(error))
            return self._refusal(error)
        except Exception as error:
            log.exception("OPC UA method failed", method=name)
            return self._refusal(error)
        log.info("OPC UA method", method=name)
        return [] if result is None else [ua.Variant(result, ua.VariantType.String)]

    def _refusal(self, error: Exception) -> ua.CallMethodResult:
        with self._guard:
            self._last_refusal = alarm_of(error)
        return refusal_result(_status_code(error))

    def _start(self, kind: str, position_set: str, stations: list[int], slot: float, full: bool, consent: bool) -> str:
        return self._control.start(
            run_request(
                kind=kind,
                source="opc ua",
                position_set=position_set or None,
                stations=stations or None,
                slot_minutes=slot or None,
                full_allowed=full,
                consent=consent,
            )
        )

    def _abort(self, reason: str) -> None:
        self._control.abort(reason or "abort over OPC UA")


_INPUTS = {method.name: method.inputs for method in METHODS}
_KINDS: dict[str, type] = {"String": str, "Double": float, "Int32": int, "Boolean": bool}


def _values(name: str, arguments: Sequence[ua.Variant]) -> list[Any]:
    """Return the values of the arguments after checking them against their declaration; asyncua does not check them.

    Null stands for an empty text or array. Raise InputError if the number of arguments or a type is wrong.
    """
    declared = _INPUTS[name]
    if len(arguments) != len(declared):
        raise InputError(f"{name} takes {len(declared)} arguments, {len(arguments)} were given")
    return [_value(argument, variant) for argument, variant in zip(declared, arguments, strict=True)]


def _value(argument: Argument, variant: ua.Variant) -> Any:
    array = argument.form.endswith("[]")
    kind = _KINDS[argument.form.removesuffix("[]")]
    value = variant.Value
    if value is None and (array or kind is str):
        return [] if array else ""
    items = value if array and isinstance(value, list) else [value]
    if isinstance(value, list) is not array or not all(type(item) is kind for item in items):
        raise InputError(f"{argument.name} must be of type {argument.form}")
    return value


def _status_code(error: Exception) -> int:
    if isinstance(error, UserError):
        return StatusCodes.BadInvalidArgument
    if isinstance(error, Busy | PermissionMissing):
        return StatusCodes.BadInvalidState
    return StatusCodes.BadUnexpectedError
