"""Machine under Objects/Machines: its types, its values and its notifications, with two clients; bad node sets."""

from __future__ import annotations

import asyncio
import re
import shutil
from collections.abc import Iterator
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from asyncua import ua
from fake_control import FakeControl
from opcua_world import (
    TOKEN,
    WITHIN_S,
    World,
    browsed_by_node,
    calibrated,
    machine_node,
    opened,
    require_node,
    status_of,
    until,
)

from agent.errors import EndpointUnavailable
from agent.execution.states import RunState
from agent.service.control import Alarm
from agent.service.daemon.endpoints import open_endpoints
from agent.service.opcua import endpoint, node_sets
from agent.service.opcua.companion_types import ALERT, DEVICES, MACHINE_TOOL, MACHINERY, RESULT
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.service.opcua.machine_model import LAST, LAST_META, MACHINE_VARIABLES, READY_EVENT, RESULTS
from agent.service.opcua.model import NAMESPACE
from agent.service.opcua.node_set_files import NODE_SETS, node_sets_to_load
from agent.settings.opcua import OpcUaSettings

PLATE = {
    "manufacturer": "Musterbau",
    "serial_number": "4711",
    "product_instance_uri": "urn:musterbau:m8:4711",
    "year_of_construction": 2019,
}
SHIPPED = Path(str(files("agent.service.opcua") / "companion"))
BAD_NO_DATA, WAITING = ua.StatusCodes.BadNoData, ua.StatusCodes.BadWaitingForInitialData


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Iterator[World]:
    sets = further(tmp_path_factory.mktemp("further"))
    yield from opened(tmp_path_factory.mktemp("opcua"), identification=PLATE, node_sets=sets)


@pytest.fixture(autouse=True)
def at_rest(request) -> None:
    if "world" in request.fixturenames:
        request.getfixturevalue("world").control.begin_anew()


def test_the_machine_has_the_published_types_and_nothing_that_was_not_read(world):
    async def scene() -> None:
        async with world.connected() as client:
            uris = await client.get_namespace_array()
            machines = await client.nodes.objects.get_child(f"{uris.index(MACHINERY)}:Machines")
            (machine,) = await machines.get_children()
            assert (await machine.read_browse_name()).to_string() == f"{uris.index(NAMESPACE)}:mill-7"
            kind = await machine.read_type_definition()
            assert (uris[kind.NamespaceIndex], kind.Identifier) == (MACHINE_TOOL, 13)
            plate = await machine.get_child(f"{uris.index(DEVICES)}:Identification")
            assert (await plate.read_type_definition()).Identifier == 11
            serial = await plate.get_child(f"{uris.index(DEVICES)}:SerialNumber")
            assert await serial.read_value() == "4711"
            assert (await machine_node(client, "Identification.Manufacturer").read_value()).Text == "Musterbau"
            assert await machine_node(client, "Identification.YearOfConstruction").read_value() == 2019
            assert await status_of(client, "Identification.Model") == BAD_NO_DATA
            assert await status_of(client, "Monitoring.MachineTool.OperationMode") == BAD_NO_DATA
            assert await status_of(client, "MachineryBuildingBlocks.MachineryItemState.CurrentState") == BAD_NO_DATA
            assert await status_of(client, "Production.ActiveProgram.Name") == WAITING
            assert await status_of(client, f"{LAST}.VCE") == WAITING
            for variable in MACHINE_VARIABLES:
                found = machine_node(client, variable.path)
                assert (await found.read_data_type_as_variant_type()).name in (variable.form, "Int32", "Guid")

    asyncio.run(scene())


def test_a_further_node_set_of_the_directory_is_loaded_with_what_it_builds_on(world):
    async def scene() -> None:
        async with world.connected() as client:
            uris = await client.get_namespace_array()
            kind = client.get_node(ua.NodeId(ua.Int32(1), ua.Int16(uris.index("urn:further"))))
            assert (await kind.read_browse_name()).Name == "GaugeType"
            (above,) = await kind.get_referenced_nodes(ua.ObjectIds.HasSubtype, ua.BrowseDirection.Inverse)
            assert (await above.read_browse_name()).Name == "ElementMonitoringType"

    asyncio.run(scene())


def test_state_result_and_alerts_follow_the_run(world):
    async def scene() -> None:
        async with world.connected() as client:
            item = "MachineryBuildingBlocks.MachineryItemState.CurrentState"
            world.control.now(RunState.MEASURING, run_id="r-1", position_set="S1+S3")
            await until(client, f"{item}", ua.LocalizedText("Executing"))
            await until(client, "Production.ActiveProgram.State.CurrentState", ua.LocalizedText("Running"))
            number = await machine_node(client, "Production.ActiveProgram.State.CurrentState.Number").read_value()
            state = client.get_node(await machine_node(client, f"{item}.Id").read_value())
            assert (number, (await state.read_browse_name()).Name) == (1, "Executing")
            assert await machine_node(client, "Production.ActiveProgram.JobIdentifier").read_value() == "r-1"

            heard: asyncio.Queue = asyncio.Queue()

            class Handler:
                def event_notification(self, event) -> None:
                    heard.put_nowait(event)

            subscription = await client.create_subscription(50, Handler())
            uris = await client.get_namespace_array()
            ready = client.get_node(ua.NodeId(ua.String(READY_EVENT), ua.Int16(uris.index(NAMESPACE))))
            await client.load_data_type_definitions()
            await subscription.subscribe_events(machine_node(client, RESULTS), ready)
            ended = calibrated(world.state, "r-1", vce_um=3.5)
            world.control.now(RunState.COMPLETE)
            world.control.tell("outcome", "accepted")
            await until(client, f"{LAST}.VCE", 3.5)
            assert await machine_node(client, f"{LAST}.VE").read_value() == 38.5
            assert await machine_node(client, f"{LAST}.Verdict").read_value() == "accepted"
            assert await machine_node(client, f"{LAST_META}.ResultEvaluation").read_value() == 1
            assert await machine_node(client, f"{LAST_META}.CreationTime").read_value() == datetime.fromisoformat(ended)
            unit = await machine_node(client, f"{LAST}.VCE.EngineeringUnits").read_value()
            assert (unit.UnitId, unit.DisplayName.Text) == (13384, "µm")

            event = await asyncio.wait_for(heard.get(), WITHIN_S)
            assert event.Result.ResultMetaData.ResultId == "r-1"
            assert event.Message.Text.startswith("The new table")

            alert = client.get_node(ua.NodeId(ua.Int32(ALERT.number), ua.Int16(uris.index(ALERT.namespace))))
            await subscription.subscribe_events(machine_node(client, "Notification.Messages"), alert)
            world.control.fault()
            event = await asyncio.wait_for(heard.get(), WITHIN_S)
            assert (event.ErrorCode, event.Severity, event.Retain) == ("311", 800, True)
            assert event.Message.Text == "the mount does not answer. check the cable"
            # a client that connects later asks for what is open, and gets it between two marks
            refresh = client.get_node(ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType_ConditionRefresh)))
            conditions = client.get_node(ua.ObjectIds.ConditionType)
            await conditions.call_method(refresh, ua.Variant(subscription.subscription_id, ua.VariantType.UInt32))
            event = await asyncio.wait_for(heard.get(), WITHIN_S)
            assert (event.ErrorCode, event.Retain) == ("311", True)
            world.control.reset()
            event = await asyncio.wait_for(heard.get(), WITHIN_S)
            assert (event.ErrorCode, event.Retain) == ("311", False)
            await subscription.delete()

    asyncio.run(scene())


WRONG_ARGUMENTS = (
    ua.Variant([1], ua.VariantType.UInt32),
    ua.Variant("1", ua.VariantType.String),
    ua.Variant(1.0, ua.VariantType.Double),
    ua.Variant(True, ua.VariantType.Boolean),
    ua.Variant(),
)
"""Values that are no number of a subscription."""


@pytest.mark.parametrize(
    "method", [ua.ObjectIds.ConditionType_ConditionRefresh, ua.ObjectIds.ConditionType_ConditionRefresh2]
)
def test_open_alarms_are_sent_only_to_a_subscription_of_the_session_that_asks(world, method):
    expected = 1 if method == ua.ObjectIds.ConditionType_ConditionRefresh else 2

    async def scene() -> None:
        world.control.fault()
        async with world.connected() as client, world.connected() as other:
            uris = await client.get_namespace_array()
            await client.load_data_type_definitions()
            alert = ua.NodeId(ua.Int32(ALERT.number), ua.Int16(uris.index(ALERT.namespace)))
            heard: asyncio.Queue = asyncio.Queue()

            class Handler:
                def event_notification(self, event) -> None:
                    heard.put_nowait(event)

            subscription = await client.create_subscription(50, Handler())
            item = await subscription.subscribe_events(
                machine_node(client, "Notification.Messages"), client.get_node(alert)
            )

            async def refresh(asking, number: int) -> None:
                node = asking.get_node(ua.NodeId(ua.Int32(method)))
                arguments = [ua.Variant(one, ua.VariantType.UInt32) for one in (number, item)[:expected]]
                await asking.get_node(ua.ObjectIds.ConditionType).call_method(node, *arguments)

            with pytest.raises(ua.UaStatusCodeError) as caught:
                await refresh(other, subscription.subscription_id)
            assert caught.value.code == ua.StatusCodes.BadUserAccessDenied
            with pytest.raises(ua.UaStatusCodeError) as caught:
                await refresh(client, subscription.subscription_id + 1000)
            assert caught.value.code == ua.StatusCodes.BadSubscriptionIdInvalid
            with pytest.raises(ua.UaStatusCodeError) as caught:
                await client.get_node(ua.ObjectIds.ConditionType).call_method(
                    client.get_node(ua.NodeId(ua.Int32(method)))
                )
            assert caught.value.code == ua.StatusCodes.BadArgumentsMissing
            own = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
            requests = [
                ua.CallMethodRequest(
                    ua.NodeId(ua.Int32(ua.ObjectIds.ConditionType)), ua.NodeId(ua.Int32(method)), given
                )
                for given in ([wrong, own][:expected] for wrong in WRONG_ARGUMENTS)
            ]
            # no request of a call hinders the others
            for answer in await client.uaclient.call(requests):
                assert answer.StatusCode.value == ua.StatusCodes.BadInvalidArgument
                codes = [one.value for one in answer.InputArgumentResults]
                assert codes == [ua.StatusCodes.BadTypeMismatch, ua.StatusCodes.Good][:expected]
            assert heard.empty()
            await refresh(client, subscription.subscription_id)
            event = await asyncio.wait_for(heard.get(), WITHIN_S)
            assert (event.ErrorCode, event.Retain) == ("311", True)
            await subscription.delete()

    asyncio.run(scene())


def test_another_vendors_client_finds_the_machine(world, tmp_path):
    require_node()
    ended = calibrated(world.state, "r-2", vce_um=4.25)
    world.control.now(RunState.HELD, run_id="r-3", position_set="S1")
    world.control.tell("outcome", "accepted")

    async def shown() -> None:
        async with world.connected() as client:
            await until(client, f"{LAST}.VCE", 4.25)

    asyncio.run(shown())
    found = browsed_by_node(world, tmp_path)
    assert found["types"] == {
        "machine": [MACHINE_TOOL, 13, "MachineToolType"],
        "identification": [MACHINE_TOOL, 11, "MachineToolIdentificationType"],
        "monitoring": [MACHINE_TOOL, 14, "MonitoringType"],
        "production": [MACHINE_TOOL, 21, "ProductionType"],
        "notification": [MACHINE_TOOL, 7, "NotificationType"],
        "itemState": [MACHINERY, 1002, "MachineryItemState_StateMachineType"],
        "result": [RESULT, 2001, "ResultType"],
    }
    assert (found["name"], found["manufacturer"], found["serialNumber"]) == ("mill-7", "Musterbau", "4711")
    assert found["productInstanceUri"] == PLATE["product_instance_uri"]
    assert (found["program"], found["itemState"], found["packml"]) == ("Interrupted", "NotExecuting", "Held")
    assert (found["ve"], found["vce"], found["verdict"]) == (38.5, 4.25, "accepted")
    assert abs(datetime.fromisoformat(found["ended"]) - datetime.fromisoformat(ended)).total_seconds() < 1e-3


def copied(directory: Path) -> Path:
    return Path(shutil.copytree(SHIPPED, directory / "sets"))


def without(directory: Path, name: str) -> Path:
    sets = copied(directory)
    (sets / name).unlink()
    return sets


def changed(directory: Path, name: str, pattern: str, by: str) -> Path:
    path = copied(directory) / name
    path.write_text(re.sub(pattern, by, path.read_text(encoding="utf-8"), count=1, flags=re.DOTALL), encoding="utf-8")
    return path.parent


FURTHER = """<UANodeSet xmlns="http://opcfoundation.org/UA/2011/03/UANodeSet.xsd">
<NamespaceUris><Uri>urn:further</Uri><Uri>http://opcfoundation.org/UA/MachineTool/</Uri></NamespaceUris>
<Models><Model ModelUri="urn:further" Version="1.0.0" PublicationDate="2026-01-01T00:00:00Z">
<RequiredModel ModelUri="{required}" PublicationDate="2024-11-01T00:00:00Z"/></Model></Models>
<UAObjectType NodeId="ns=1;i=1" BrowseName="1:GaugeType"><DisplayName>GaugeType</DisplayName><References>
<Reference ReferenceType="i=45" IsForward="false">ns=2;i=23</Reference></References></UAObjectType></UANodeSet>"""
"""Node set of a type below ElementMonitoringType of Machine Tools, as those of other specifications."""


def further(directory: Path, required: str = MACHINE_TOOL) -> Path:
    sets = copied(directory)
    (sets / "further.xml").write_text(FURTHER.format(required=required))
    return sets


MACHINE_TOOL_FILE = "Opc.Ua.MachineTool.NodeSet2.xml"
BAD = {
    "missing folder": (lambda d: d / "none", "does not exist"),
    "cut off": (lambda d: changed(d, MACHINE_TOOL_FILE, r"(.{20000}).*", r"\1"), "cannot be read"),
    "two of one namespace": (
        lambda d: Path(shutil.copy(copied(d) / MACHINE_TOOL_FILE, d / "sets" / "older.xml")).parent,
        "MachineTool.NodeSet2.xml and older.xml have the same namespace",
    ),
    "a set that builds on another one": (lambda d: further(d, "urn:none"), "builds on urn:none, which is not here"),
    "one of the seven needs a newer one": (
        lambda d: changed(d, MACHINE_TOOL_FILE, '(/UA/Machinery/" Version=")1.03.0', r"\g<1>9.9.0"),
        "MachineTool/ needs version 9.9.0 of http://opcfoundation.org/UA/Machinery/: 1.04.1 is there",
    ),
    "one of the seven builds on another one": (
        lambda d: changed(d, MACHINE_TOOL_FILE, 'Model ModelUri="[^"]*/IA/', 'Model ModelUri="urn:none'),
        "MachineTool/ builds on urn:none, which is not here",
    ),
    "another document": (lambda d: changed(d, MACHINE_TOOL_FILE, r".*", "<svg/>"), "not a UANodeSet"),
    "another namespace": (
        lambda d: changed(d, MACHINE_TOOL_FILE, '<Model ModelUri="[^"]*', '<Model ModelUri="urn:x'),
        "the namespace urn:x of its model is not one of its NamespaceUris",
    ),
    "a set is missing": (
        lambda d: without(d, MACHINE_TOOL_FILE),
        "no file here has the namespace http://opcfoundation.org/UA/MachineTool/",
    ),
    "too old": (lambda d: changed(d, MACHINE_TOOL_FILE, 'Version="1.02.0"', 'Version="1.01.1"'), "1.01.1 .* too old"),
}  # fmt: skip
NOT_IMPORTED = {
    "a type is missing": (
        lambda d: changed(d, MACHINE_TOOL_FILE, 'BrowseName="1:AlertType"', 'BrowseName="1:Other"'),
        "the type AlertType .* is missing",
    ),
    "not importable": (
        lambda d: changed(d, MACHINE_TOOL_FILE, '<UAVariable NodeId="ns=1;i=231"', '<UAVariable NodeId="ns=x"'),
        "cannot be read",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", list(BAD))
def test_an_unusable_node_set_is_named_with_what_to_do(tmp_path, what):
    make, words = BAD[what]
    with pytest.raises(EndpointUnavailable, match=words) as caught:
        node_sets_to_load(OpcUaSettings(node_sets=make(tmp_path)))
    assert caught.value.where["key"] == "opcua.node_sets"
    assert str(tmp_path) in caught.value.where["file"]
    assert "UA-Nodeset" in caught.value.hint or "keep one" in caught.value.hint


def test_each_of_the_seven_is_imported_after_those_on_which_it_builds(tmp_path):
    shipped = list(node_sets_to_load(OpcUaSettings()))
    assert shipped == [one.uri for one in NODE_SETS]
    further(tmp_path, required=DEVICES)
    own = changed_in_place(tmp_path / "sets", "Opc.Ua.Machinery_Result.NodeSet2.xml")
    jobs = list(node_sets_to_load(OpcUaSettings(node_sets=own)))
    assert jobs.index(RESULT) > jobs.index("urn:further")
    assert [uri for uri in jobs if uri != "urn:further"] == shipped


def changed_in_place(sets: Path, name: str) -> Path:
    """Let a node set build on `urn:further` as well."""
    text = (sets / name).read_text(encoding="utf-8")
    (sets / name).write_text(
        text.replace("<RequiredModel ", '<RequiredModel ModelUri="urn:further"/><RequiredModel ', 1)
    )
    return sets


class StoppedServer:
    """Server that is stopped while it imports its first node set."""

    def __init__(self, stop: asyncio.Event) -> None:
        self.stop = stop
        self.imported = 0

    async def import_xml(self, **_: object) -> None:
        self.imported += 1
        self.stop.set()


def test_a_server_that_is_stopped_loads_no_further_node_set_and_keeps_none(monkeypatch):
    found = node_sets_to_load(OpcUaSettings())
    monkeypatch.setattr(node_sets, "node_sets_to_load", lambda _: found)

    async def scene() -> int:
        server: Any = StoppedServer(asyncio.Event())
        with pytest.raises(EndpointUnavailable, match="stopped while it was loading"):
            await node_sets.load_node_sets(server, OpcUaSettings(), server.stop)
        return int(server.imported)

    assert asyncio.run(scene()) == 1
    first, second = list(found.values())[:2]
    assert len(first.root) == 0
    assert len(second.root) > 0


def test_a_server_that_does_not_open_in_time_is_stopped_and_says_which_settings_to_change(tmp_path, monkeypatch):
    class Slow:
        def __init__(self, *_: object) -> None: ...

        async def serve(self, stop: asyncio.Event, opened: object) -> None:
            await stop.wait()

    stub = SimpleNamespace(OpcUaServer=Slow, ServerFiles=lambda *_: None)
    monkeypatch.setattr(endpoint, "import_module", lambda _: stub)
    monkeypatch.setattr(endpoint, "OPEN_TIMEOUT_S", 0.0)
    slow = OpcUaEndpoint(OpcUaSettings(), tmp_path, TOKEN)
    with pytest.raises(EndpointUnavailable, match="did not open within 0 s") as caught:
        slow.start(FakeControl())
    assert "opcua.further_node_sets" in caught.value.hint
    assert not slow.alive


@pytest.mark.parametrize("what", list(NOT_IMPORTED))
def test_without_usable_node_sets_the_service_goes_on_and_says_so(tmp_path, monkeypatch, what):
    monkeypatch.setattr(endpoint, "OPEN_TIMEOUT_S", WITHIN_S)
    make, words = NOT_IMPORTED[what]
    own = OpcUaEndpoint(OpcUaSettings(node_sets=make(tmp_path)), tmp_path, TOKEN)
    alarms: list[Alarm] = []
    with open_endpoints([own], FakeControl(), alarms.append) as open_ones:
        assert open_ones == []
    (alarm,) = alarms
    assert re.search(words, alarm.text)
    assert alarm.text.startswith("the service goes on without OPC UA")
    assert (alarm.code, alarm.where["endpoint"]) == (203, "OPC UA")
    assert MACHINE_TOOL_FILE in alarm.where["file"]


def test_no_defect_of_the_machine_space_keeps_the_service_from_starting(tmp_path, monkeypatch) -> None:
    async def fails(*_: object) -> None:
        raise KeyError("a reference to a type that the node set does not have")

    monkeypatch.setattr("agent.service.opcua.machine_space.load_node_sets", fails)
    monkeypatch.setattr(endpoint, "OPEN_TIMEOUT_S", WITHIN_S)
    alarms: list[Alarm] = []
    own = OpcUaEndpoint(OpcUaSettings(), tmp_path, TOKEN)
    with open_endpoints([own], FakeControl(), alarms.append) as open_ones:
        assert open_ones == []
    assert alarms[0].text == "the service goes on without OPC UA: the server cannot be built: the log names the cause"
