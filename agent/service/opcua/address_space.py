"""OPC UA address space. It consists of the nodes defined in `agent.service.opcua.model`, which are updated from the
status of the service, and of the events of the service."""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import structlog
from asyncua import ua
from asyncua.common.node import Node
from asyncua.server.event_generator import EventGenerator
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIds
from asyncua.ua.status_codes import StatusCodes

from agent.errors import Busy, NotAllowedInState
from agent.runs.run_request import run_request
from agent.service.alarms import alarm_of
from agent.service.control import Alarm, Control, Event, Status
from agent.service.opcua.guard import REFRESHES, GuardedServer, refusal_result
from agent.service.opcua.machine_space import MachineSpace
from agent.service.opcua.model import (
    ALARM_EVENT,
    EVENT_TYPES,
    METHODS,
    NAMESPACE,
    OUTCOME,
    OWN_VARIABLES,
    REFUSED_CODE,
    REFUSED_TEXT,
    ROOT,
    STATE_EVENT,
    VARIABLES,
    Argument,
)
from drivers.errors import InputError, PermissionMissing, UserError, VolcalError

log = structlog.get_logger()
_INPUTS = {method.name: method.inputs for method in METHODS}
_KINDS: dict[str, type] = {"String": str, "Double": float, "Int32": int, "Boolean": bool}


class AddressSpace:
    """OPC UA nodes under one root object. They must be used only in the server's event loop."""

    def __init__(self, server: Server, guarded: GuardedServer, control: Control, machine: MachineSpace) -> None:
        self._server = server
        self._machine = machine
        self._guarded = guarded
        self._control = control
        self._calls = MethodCalls(control)
        self._nodes: dict[str, Node] = {}
        self._forms: dict[str, str] = {}
        self._shown: dict[str, Any] = {}
        self._events: dict[str, EventGenerator] = {}
        self._index = 0

    async def build(self) -> None:
        self._index = await self._server.register_namespace(NAMESPACE)
        root = await self._server.nodes.objects.add_object(self._id(ROOT), self._name(ROOT))
        self._nodes[""] = root
        for variable in VARIABLES:
            await self._add_variable(variable.path, variable.form, variable.meaning)
        for path, form, meaning in OWN_VARIABLES:
            await self._add_variable(path, form, meaning)
        await self._add_methods(root)
        await self._add_events(root)
        # The own namespace comes first: clients may have kept its index.
        await self._machine.build(self._index, self._control.status().machine)

    async def show(self, status: Status) -> None:
        """Update the nodes with all values of the service status that have changed since the last call."""
        await self._machine.show(status)
        for variable in VARIABLES:
            await self._write(variable.path, variable.of(status))
        refusal = self._calls.last_refusal
        await self._write(REFUSED_CODE, refusal.code if refusal else 0)
        await self._write(REFUSED_TEXT, f"{refusal.text}. {refusal.hint}" if refusal else "")

    async def read_result(self) -> None:
        """Read the result of the last calibration; the next `show` shows it."""
        await self._machine.read_result()

    async def show_outcome(self, event: Event) -> None:
        await self._write(OUTCOME, json.dumps({"text": event.text, **dict(event.data)}, default=str))

    async def send_state_event(self, status: Status) -> None:
        await self._send_event(
            STATE_EVENT.name, status.doing or status.state.value, PackMLState=status.packml, RunState=status.state.value
        )

    async def send_alarm_event(self, alarm: Alarm) -> None:
        await self._send_event(ALARM_EVENT.name, alarm.text, Code=alarm.code, Hint=alarm.hint)
        await self._machine.send_alert(alarm, active=True)

    async def send_alarm_removed(self, alarm: Alarm) -> None:
        await self._machine.send_alert(alarm, active=False)

    async def _send_event(self, name: str, message: str, **fields: Any) -> None:
        generator = self._events[name]
        for field, value in fields.items():
            setattr(generator.event, field, value)
        await generator.trigger(message=message)

    async def _write(self, path: str, value: Any) -> None:
        if path not in self._shown or self._shown[path] != value:
            await self._nodes[path].write_value(_variant(self._forms[path], value))
            self._shown[path] = value

    async def _add_variable(self, path: str, form: str, meaning: str) -> None:
        folder, _, name = path.rpartition("/")
        parent = await self._folder(folder)
        node = await parent.add_variable(self._id(path), self._name(name), _variant(form, _EMPTY[form]))
        await node.write_attribute(
            AttributeIds.Description,
            ua.DataValue(ua.Variant(ua.LocalizedText(meaning), ua.VariantType.LocalizedText)),
        )
        self._nodes[path], self._forms[path] = node, form

    async def _folder(self, path: str) -> Node:
        if path not in self._nodes:
            above, _, name = path.rpartition("/")
            parent = await self._folder(above)
            self._nodes[path] = await parent.add_object(self._id(path), self._name(name))
        return self._nodes[path]

    async def _add_methods(self, root: Node) -> None:
        free = dict.fromkeys(REFRESHES, True)
        for method in METHODS:
            node = await root.add_method(
                self._id(method.name),
                self._name(method.name),
                self._callback(method.name),
                [_argument(argument) for argument in method.inputs],
                [_argument(argument) for argument in method.outputs],
            )
            free[node.nodeid] = method.free
        self._guarded.free_methods = free

    def _callback(self, name: str) -> Callable[..., Awaitable[Any]]:
        """Return the callback of the OPC UA method `name`. The callback executes the method in a thread, so that the
        loop is not blocked.

        The nodes are updated before the client receives the result.
        """

        async def called(_: ua.NodeId, *arguments: ua.Variant) -> Any:
            result = await asyncio.to_thread(self._calls.call, name, arguments)
            await self.show(self._control.status())
            return result

        return called

    async def _add_events(self, root: Node) -> None:
        for kind in EVENT_TYPES:
            fields = [(field.name, _type(field.form)) for field in kind.fields]
            event_type = await self._server.create_custom_event_type(
                self._index, kind.name, ObjectIds.BaseEventType, fields
            )
            generator = await self._server.get_event_generator(event_type.nodeid, root.nodeid)
            generator.event.Severity = kind.severity
            self._events[kind.name] = generator

    def _id(self, path: str) -> ua.NodeId:
        """Return the node identifier made from the path; it is the same after every start of the service."""
        return ua.NodeId(ua.String(path), ua.Int16(self._index))

    def _name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self._index)


_EMPTY: Mapping[str, Any] = {
    "String": "", "Double": 0.0, "Int32": 0, "Boolean": False, "String[]": [], "Int32[]": []
}  # fmt: skip


def _type(form: str) -> ua.VariantType:
    return ua.VariantType[form.removesuffix("[]")]


def _variant(form: str, value: Any) -> ua.Variant:
    return ua.Variant(list(value) if form.endswith("[]") else value, _type(form), is_array=form.endswith("[]"))


def _argument(argument: Argument) -> ua.Argument:
    array = argument.form.endswith("[]")
    return ua.Argument(
        Name=argument.name,
        DataType=ua.NodeId(getattr(ObjectIds, argument.form.removesuffix("[]"))),
        ValueRank=1 if array else -1,
        ArrayDimensions=[0] if array else [],
        Description=ua.LocalizedText(argument.meaning),
    )


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
    if isinstance(error, Busy | PermissionMissing | NotAllowedInState):
        return StatusCodes.BadInvalidState
    if isinstance(error, UserError):
        return StatusCodes.BadInvalidArgument
    return StatusCodes.BadUnexpectedError
