"""OPC UA address space. It consists of the nodes defined in `agent.service.opcua.model`, which are updated from the
status of the service, and of the events of the service."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from asyncua import ua
from asyncua.common.node import Node
from asyncua.server.event_generator import EventGenerator
from asyncua.server.server import Server
from asyncua.ua.attribute_ids import AttributeIds
from asyncua.ua.object_ids import ObjectIds

from agent.service.control import Alarm, Control, Event, Status
from agent.service.opcua.guard import GuardedServer
from agent.service.opcua.methods import MethodCalls
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


class AddressSpace:
    """OPC UA nodes under one root object. They must be used only in the server's event loop."""

    def __init__(self, server: Server, guarded: GuardedServer, control: Control) -> None:
        self._server = server
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

    async def show(self, status: Status) -> None:
        """Update the nodes with all values of the service status that have changed since the last call."""
        for variable in VARIABLES:
            await self._write(variable.path, variable.of(status))
        refusal = self._calls.last_refusal
        await self._write(REFUSED_CODE, refusal.code if refusal else 0)
        await self._write(REFUSED_TEXT, f"{refusal.text}. {refusal.hint}" if refusal else "")

    async def show_outcome(self, event: Event) -> None:
        await self._write(OUTCOME, json.dumps({"text": event.text, **dict(event.data)}, default=str))

    async def send_state_event(self, status: Status) -> None:
        await self._send_event(
            STATE_EVENT.name, status.doing or status.state.value, PackMLState=status.packml, RunState=status.state.value
        )

    async def send_alarm_event(self, alarm: Alarm) -> None:
        await self._send_event(ALARM_EVENT.name, alarm.text, Code=alarm.code, Hint=alarm.hint)

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
        free: dict[ua.NodeId, bool] = {}
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
