"""Nodes of the machine under ``Objects/Machines``, made from `agent.service.opcua.machine_model`."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import structlog
from asyncua import ua
from asyncua.common.instantiate_util import instantiate
from asyncua.common.node import Node
from asyncua.server.event_generator import EventGenerator
from asyncua.server.server import Server
from asyncua.ua.object_ids import ObjectIds
from asyncua.ua.status_codes import StatusCodes

from agent.service.control import Alarm, Status
from agent.service.opcua.companion_types import (
    ALERT,
    MACHINE_TOOL_TYPE,
    MACHINES,
    MEASURING,
    MEASURING_RESULT,
    MEASURING_SYSTEM,
    MONITORED_ELEMENT,
    PERIPHERAL,
    PERIPHERALS,
    RESULT_READY,
    CompanionType,
)
from agent.service.opcua.last_calibration import CalibrationResult, JournalResults, journal_results
from agent.service.opcua.machine_model import (
    ALERTS,
    CALIBRATION,
    LAST,
    LAST_META,
    MACHINE,
    MACHINE_VARIABLES,
    PARTS,
    READY_EVENT,
    RESULTS,
    SHARED_PARTS,
    SHARED_VARIABLES,
    STATE_MACHINES,
    Facts,
    MachineValue,
    MachineVariable,
    OptionalPart,
    StateMachine,
)
from agent.service.opcua.measuring_model import PERIPHERAL_ROOT, Addition, additions_of
from agent.service.opcua.model import ALARM_EVENT
from agent.service.opcua.node_sets import load_node_sets
from agent.settings.opcua import OpcUaSettings
from drivers.errors import VolcalError

log = structlog.get_logger()

_MICROMETRE: Final = ua.EUInformation(
    NamespaceUri="http://www.opcfoundation.org/UA/units/un/cefact",
    UnitId=ua.Int32(0x3448),  # the UNECE code 4H, as OPC 10000-8 encodes it
    DisplayName=ua.LocalizedText("µm"),
    Description=ua.LocalizedText("micrometre"),
)


class MachineSpace:
    """Nodes of the machine. They must be used only in the server's event loop. If `stop` is set, they are built no
    further."""

    def __init__(self, server: Server, settings: OpcUaSettings, state_directory: Path, stop: asyncio.Event) -> None:
        self._server = server
        self._stop = stop
        self._settings = settings
        self._state_directory = state_directory
        self._results = JournalResults()
        self._variables: tuple[MachineVariable, ...] = MACHINE_VARIABLES
        self._state_machines: tuple[StateMachine, ...] = STATE_MACHINES
        self._own = ua.Int16(0)
        self._indices: dict[str, int] = {}
        self._alerts = EventGenerator(server.iserver.isession)
        self._open_alerts: dict[int, EventGenerator] = {}
        self._ready = EventGenerator(server.iserver.isession)
        self._told: CalibrationResult | None = None
        self._states: dict[str, Mapping[str, tuple[ua.NodeId, int]]] = {}
        self._shown: dict[str, Any] = {}

    async def build(self, own: int, name: str) -> None:
        """Add the machine `name`. `own` is the index of the own namespace, whose nodes already exist. Raise
        EndpointUnavailable if the node sets cannot be loaded."""
        loaded = await load_node_sets(self._server, self._settings, self._stop)
        self._own = ua.Int16(own)
        self._indices = {uri: place for place, uri in enumerate(await self._server.get_namespace_array())}
        additions = additions_of(loaded)
        self._variables += tuple(variable for one in additions for variable in one.variables)
        self._state_machines += tuple(machine for one in additions for machine in one.state_machines)
        measures = MEASURING in loaded
        await self._add_to_machines(MEASURING_SYSTEM if measures else MACHINE_TOOL_TYPE, MACHINE, name)
        if PERIPHERALS in loaded:
            await self._add_to_machines(PERIPHERAL, f"{MACHINE}.{PERIPHERAL_ROOT}", f"{name} touch probe")
        for part in PARTS:
            await self._add_part(replace(part, type=MEASURING_RESULT) if measures and part.path == LAST else part)
        await self._add_calibration()
        for place, part_path in SHARED_PARTS:
            await self._node(place).add_reference(self._node(part_path), ObjectIds.HasAddIn)
        for one in additions:
            await self._add_parts_of(one)
        for variable in self._variables:
            if variable.namespace:
                await self._add_variable(variable)
        for machine in self._state_machines:
            self._states[machine.path] = await self._states_of(machine)
        await self._alerts.init(self._type(ALERT), self._node(ALERTS))
        # The type has no default value from which asyncua could learn the type of this field.
        self._alerts.event.add_property("ErrorCode", "", ua.VariantType.String)
        await self._ready.init(await self._own_type(RESULT_READY, READY_EVENT), self._node(RESULTS))

    async def read_result(self) -> None:
        """Read the results of calibrations and the qualification of the stylus from the journal, in a thread. If the
        journal cannot be read, what was read before stays."""
        try:
            self._results = await asyncio.to_thread(journal_results, self._state_directory)
        except VolcalError as error:
            log.warning("result of the last calibration not read", error=str(error))

    async def show(self, status: Status) -> None:
        """Update the nodes that have changed since the last call. Send an event about a new result, which a client can
        read then."""
        facts = Facts(status, self._settings, self._results)
        for variable in self._variables:
            await self._write(variable.path, self._value(variable, facts))
        for machine in self._state_machines:
            await self._show_state(machine, facts)
        await self._show_result()
        result = self._results.last
        if result is not None and result != self._told:
            self._told = result
            self._ready.event.Result = _structures(result)[1]
            await self._ready.trigger(message=result.verdict.sentence["en"])

    async def send_alert(self, alarm: Alarm, *, active: bool) -> None:
        """Send an AlertType event: the alarm has appeared, or a reset has removed it.

        Each open alarm keeps an event of its own, which asyncua sends again when a client asks for a refresh.
        """
        found = self._open_alerts.pop(alarm.code, None)
        if found is None:
            found = EventGenerator(self._server.iserver.isession)
            found.event = copy(self._alerts.event)
        if active:
            self._open_alerts[alarm.code] = found
        fields = {
            "Severity": ALARM_EVENT.severity,
            "ConditionName": f"alarm {alarm.code}",
            "NodeId": self._id(f"{MACHINE}.{ALERTS}.{alarm.code}"),
            "EnabledState": ua.LocalizedText("Enabled"),
            "EnabledState/Id": True,
            "ActiveState": ua.LocalizedText("Active" if active else "Inactive"),
            "ActiveState/Id": active,
            "Retain": active,
            "ErrorCode": str(alarm.code),
        }
        for field, value in fields.items():
            setattr(found.event, field, value)
        await found.trigger(message=f"{alarm.text}. {alarm.hint}" if alarm.hint else alarm.text)

    async def _add_to_machines(self, kind: CompanionType, path: str, name: str) -> None:
        await instantiate(
            self._type(MACHINES), self._type(kind), self._id(path), ua.QualifiedName(name, self._own),
            ua.LocalizedText(name), instantiate_optional=False,
        )  # fmt: skip

    async def _add_parts_of(self, addition: Addition) -> None:
        for part in addition.parts:
            await self._add_part(part)
        for place, reference, part_path in addition.shared_parts:
            await self._node(place).add_reference(self._node(part_path), getattr(ObjectIds, reference))

    async def _add_part(self, part: OptionalPart) -> None:
        """Add a part, unless the type of what is above has made it already: other versions of a node set may have as
        mandatory what is optional in another."""
        if await self._exists(part.path):
            return
        above, _, name = f"{MACHINE}.{part.path}".rpartition(".")
        parent = self._server.get_node(self._id(above))
        browse_name = ua.QualifiedName(name, ua.UInt16(self._indices[part.namespace]))
        await instantiate(
            parent, self._type(part.type), self._id(f"{MACHINE}.{part.path}"), browse_name, ua.LocalizedText(name),
            instantiate_optional=False,
        )  # fmt: skip
        if part.reference:
            # asyncua attaches what stands in a folder with Organizes, and all else with HasComponent
            node, wanted = self._node(part.path), getattr(ObjectIds, part.reference)
            await parent.add_reference(node, wanted)
            for other in {ObjectIds.Organizes, ObjectIds.HasComponent} - {wanted}:
                if node in await parent.get_referenced_nodes(other, ua.BrowseDirection.Forward, includesubtypes=False):
                    await parent.delete_reference(node, other)

    async def _exists(self, path: str) -> bool:
        try:
            await self._node(path).read_browse_name()
        except ua.UaError:
            return False
        return True

    async def _add_calibration(self) -> None:
        """Add the element that shows the run: ElementMonitoringType is abstract, so it has a type of its own."""
        own_type = await self._own_type(MONITORED_ELEMENT, "CalibrationMonitoringType")
        await instantiate(
            self._node("Monitoring"), own_type, self._id(f"{MACHINE}.{CALIBRATION}"),
            ua.QualifiedName("Calibration", self._own), instantiate_optional=False,
        )  # fmt: skip
        for path in SHARED_VARIABLES:
            await self._node(CALIBRATION).add_reference(self._server.get_node(self._id(path)), ObjectIds.HasComponent)

    async def _own_type(self, above: CompanionType, name: str) -> Node:
        """Add a type of the own namespace below an abstract one."""
        return await self._type(above).add_object_type(self._id(name), ua.QualifiedName(name, self._own))

    async def _add_variable(self, variable: MachineVariable) -> None:
        above, _, name = variable.path.rpartition(".")
        index, kind = self._indices[variable.namespace], _variant_type(variable.form)
        data_type = (
            ua.NodeId(ua.Int32(variable.enumeration), ua.Int16(index))
            if variable.enumeration is not None
            else ua.NodeId(getattr(ObjectIds, variable.form.removesuffix("[]")))
        )
        parent, node_id = self._node(above), self._id(f"{MACHINE}.{variable.path}")
        if await self._exists(variable.path):
            return
        add = parent.add_property if variable.is_property else parent.add_variable
        empty = [] if variable.form.endswith("[]") else ua.get_default_value(kind)
        node = await add(node_id, ua.QualifiedName(name, ua.UInt16(index)), empty, kind, data_type)
        if variable.in_micrometres:
            await node.delete_reference(
                self._server.get_node(ObjectIds.BaseDataVariableType), ObjectIds.HasTypeDefinition
            )
            await node.add_reference(ObjectIds.BaseAnalogType, ObjectIds.HasTypeDefinition, bidirectional=False)
            unit = self._id(f"{MACHINE}.{variable.path}.EngineeringUnits")
            await node.add_property(unit, ua.QualifiedName("EngineeringUnits"), _MICROMETRE)

    async def _states_of(self, machine: StateMachine) -> Mapping[str, tuple[ua.NodeId, int]]:
        """Return identifier and number of each state by its name. A subtype may inherit its states."""
        found: dict[str, tuple[ua.NodeId, int]] = {}
        kinds = [self._type(machine.type)]
        while kinds:
            kind = kinds.pop()
            for child in await kind.get_children(nodeclassmask=ua.NodeClass.Object):
                numbers = await child.get_properties()
                for number in numbers:
                    if (await number.read_browse_name()).Name == "StateNumber":
                        name = (await child.read_browse_name()).Name
                        found.setdefault(name, (child.nodeid, await number.read_value()))
            kinds += await kind.get_referenced_nodes(ObjectIds.HasSubtype, ua.BrowseDirection.Inverse)
        return found

    async def _show_state(self, machine: StateMachine, facts: Facts) -> None:
        name, awaited = machine.of(facts), machine.awaited(facts)
        # another node set than the shipped one may lack a state: then its name is all that is shown
        node_id, number = self._states[machine.path].get(name or "", (None, None))
        current = f"{machine.path}.CurrentState"
        await self._write(current, _data_value("LocalizedText", name, awaited))
        await self._write(f"{current}.Id", _data_value("NodeId", node_id, awaited))
        if machine.numbered:
            await self._write(f"{current}.Number", _data_value("UInt32", number, awaited))

    async def _show_result(self) -> None:
        """Show the result as the structures of OPC 40001-101; their fields are also variables."""
        result = self._results.last
        for path, value in zip((LAST_META, LAST), (None, None) if result is None else _structures(result), strict=True):
            await self._write(path, _data_value("ExtensionObject", value, result is None))

    def _value(self, variable: MachineVariable, facts: Facts) -> ua.DataValue:
        value = variable.of(facts)
        if isinstance(value, tuple):
            nodes = variable.form == "NodeId[]"
            return _data_value(variable.form, [self._id(f"{MACHINE}.{one}") if nodes else one for one in value], False)
        return _data_value(variable.form, value, variable.awaited(facts))

    async def _write(self, path: str, value: ua.DataValue) -> None:
        shown = value.Value, value.StatusCode
        if self._shown.get(path) != shown:
            await self._node(path).write_value(value)
            self._shown[path] = shown

    def _type(self, wanted: CompanionType) -> Node:
        return self._server.get_node(ua.NodeId(ua.Int32(wanted.number), ua.Int16(self._indices[wanted.namespace])))

    def _node(self, path: str) -> Node:
        return self._server.get_node(self._id(f"{MACHINE}.{path}"))

    def _id(self, path: str) -> ua.NodeId:
        return ua.NodeId(ua.String(path), self._own)


def _data_value(form: str, value: MachineValue | ua.NodeId | object | None, awaited: bool) -> ua.DataValue:
    """Return the value, or the status that says why there is none."""
    if value is None:
        code = StatusCodes.BadWaitingForInitialData if awaited else StatusCodes.BadNoData
        return ua.DataValue(StatusCode=ua.StatusCode(ua.UInt32(code)))
    shown = ua.LocalizedText(str(value)) if form == "LocalizedText" else value
    return ua.DataValue(ua.Variant(shown, _variant_type(form)), StatusCode=ua.StatusCode(ua.UInt32(StatusCodes.Good)))


def _variant_type(form: str) -> ua.VariantType:
    built_in = {"Duration": "Double"}
    name = form.removesuffix("[]")
    return ua.VariantType[built_in.get(name, name)]


def _structures(result: CalibrationResult) -> tuple[object, object]:
    """Return the metadata of a result and the whole of it, as structures of classes that asyncua makes from the node
    set."""
    meta = _generated("ResultMetaDataType")(ResultId=result.run_id, CreationTime=result.ended)
    return meta, _generated("ResultDataType")(ResultMetaData=meta)


def _generated(name: str) -> Callable[..., object]:
    made: Callable[..., object] = getattr(ua, name)
    return made
