"""Further node sets: the machine as a measuring system of OPC 40210, its probe as one of OPC 40505; bad files."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from asyncua import ua
from opcua_node_sets import DI, GMS, MACHINE_TOOL, MACHINERY, RESULT, WMTP, written_gms, written_wmtp
from opcua_world import World, browsed_by_node, calibrated, machine_node, opened, status_of, until
from volcal_command import volcal

from agent.errors import EndpointUnavailable
from agent.execution.states import RunState
from agent.service.opcua.machine_model import LAST, RESULTS
from agent.service.opcua.measuring_model import ADDITIONS
from agent.service.opcua.model import NAMESPACE
from agent.service.opcua.node_set_files import MAX_BYTES, node_sets_to_load
from agent.settings.opcua import OpcUaSettings

PROBE_PLATE = {"manufacturer": "Tastwerk", "model": "T 40", "serial_number": "A-17"}
BAD_NO_DATA, WAITING = ua.StatusCodes.BadNoData, ua.StatusCodes.BadWaitingForInitialData


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Iterator[World]:
    sets = tmp_path_factory.mktemp("sets")
    yield from opened(
        tmp_path_factory.mktemp("opcua"), probe=PROBE_PLATE, calibration_interval_days=30.0,
        further_node_sets=(written_wmtp(sets / "wmtp.xml"), written_gms(sets / "gms.xml")),
    )  # fmt: skip


@pytest.fixture(autouse=True)
def at_rest(request) -> None:
    if "world" in request.fixturenames:
        request.getfixturevalue("world").control.begin_anew()


def test_the_machine_is_a_measuring_system_and_its_probe_a_peripheral(world):
    async def scene() -> None:
        async with world.connected() as client:
            uris = await client.get_namespace_array()
            at = {uri: uris.index(uri) for uri in (GMS, WMTP, MACHINE_TOOL, DI, MACHINERY, RESULT, NAMESPACE)}

            async def kind(node) -> tuple[str, int]:
                found = await node.read_type_definition()
                return uris[found.NamespaceIndex], found.Identifier

            machines = await client.nodes.objects.get_child(f"{at[MACHINERY]}:Machines")
            machine, probe = await machines.get_children()
            assert await kind(machine) == (GMS, 1002)
            assert await kind(await machine.get_child(f"{at[DI]}:Identification")) == (GMS, 1011)
            assert await kind(await machine.get_child(f"{at[MACHINE_TOOL]}:Monitoring")) == (GMS, 1004)
            tools = await machine.get_child([f"{at[MACHINE_TOOL]}:Equipment", f"{at[MACHINE_TOOL]}:Tools"])
            (sensor,) = await tools.get_children()
            assert await kind(sensor) == (GMS, 1007)
            assert await (await sensor.get_child(f"{at[GMS]}:Class")).read_value() == 3
            assert await (await sensor.get_child(f"{at[MACHINE_TOOL]}:Identifier")).read_value() == "A-17"
            # one folder of results, found from the machine and from its building blocks
            results = await machine.get_child([f"{at[GMS]}:ResultManagement", f"{at[RESULT]}:Results"])
            assert results == machine_node(client, f"{RESULTS}.Results")
            assert await kind(machine_node(client, LAST)) == (GMS, 2004)
            plan = await machine.get_child([f"{at[MACHINE_TOOL]}:Production", f"{at[MACHINE_TOOL]}:ProductionPlan"])
            (job,) = await plan.get_referenced_nodes(ua.ObjectIds.HasOrderedComponent)
            assert await kind(job) == (GMS, 1016)
            assert len(await plan.get_children()) == 1

            assert await kind(probe) == (WMTP, 1003)
            assert (await probe.read_browse_name()).Name == "mill-7 touch probe"
            plate = await probe.get_child([f"{at[WMTP]}:DeviceInformation", f"{at[DI]}:Identification"])
            assert (await (await plate.get_child(f"{at[DI]}:Manufacturer")).read_value()).Text == "Tastwerk"
            assert (await (await plate.get_child(f"{at[DI]}:Model")).read_value()).Text == "T 40"

            for path in ("Equipment.Tools.Probe.Locked", "Equipment.Tools.Probe.IsQualifiedStatus"):
                assert await status_of(client, path) == BAD_NO_DATA
            for variable in (one for addition in ADDITIONS for one in addition.variables):
                status = await status_of(client, variable.path)
                assert status in (ua.StatusCodes.Good, BAD_NO_DATA, WAITING), variable.path

    asyncio.run(scene())


def test_job_prognosis_and_tool_follow_the_run(world):
    job, prognosis = "Production.ProductionPlan.Run", "Notification.Prognoses.Calibration"

    async def scene() -> None:
        async with world.connected() as client:
            assert await status_of(client, f"{job}.RunsPlanned.IsValid") == WAITING
            world.control.now(RunState.MEASURING, run_id="r-1", kind="nightly", minutes_left=2.5)
            await until(client, f"{job}.RemainingTime", 150_000.0)
            assert await machine_node(client, f"{job}.Identifier").read_value() == "r-1"
            assert await machine_node(client, f"{job}.MeasurementReason").read_value() == 0
            assert (await machine_node(client, f"{job}.State.CurrentState").read_value()).Text == "Running"
            assert await machine_node(client, f"{job}.RunsPlanned.IsValid").read_value() is True
            assert await machine_node(client, f"{job}.RunsCompleted").read_value() == 0
            active = await machine_node(client, "Monitoring.ToolMonitoring.ActiveTool").read_value()
            assert active == [machine_node(client, "Equipment.Tools.Probe").nodeid]

            assert await machine_node(client, f"{prognosis}.CalibrationInterval").read_value() == 30 * 86_400_000
            assert await status_of(client, f"{prognosis}.Calibrated") == WAITING
            ended = datetime.fromisoformat(
                calibrated(world.state, "r-1", vce_um=3.5, probe={"facts": {"rows": [], "rings": [{"n": 1}]}})
            )
            world.control.now(RunState.COMPLETE, minutes_left=0.0)
            world.control.tell("outcome", "accepted")
            await until(client, f"{prognosis}.Calibrated", True)
            assert await machine_node(client, f"{prognosis}.DateOfCalibration").read_value() == ended
            assert await machine_node(client, f"{prognosis}.PredictedTime").read_value() == ended + timedelta(days=30)
            assert await machine_node(client, f"{job}.RunsCompleted").read_value() == 1
            assert await status_of(client, f"{job}.RemainingTime") == BAD_NO_DATA
            assert await status_of(client, "Monitoring.ToolMonitoring.ActiveTool") == BAD_NO_DATA
            assert await machine_node(client, "Equipment.Tools.Probe.IsQualifiedStatus").read_value() == 0
            assert await machine_node(client, f"{LAST}.UsedTools").read_value() == ["A-16"]
            assert await status_of(client, "Equipment.Tools.Probe.Alignment") == BAD_NO_DATA

    asyncio.run(scene())


def test_another_vendors_client_finds_the_measuring_system(world, tmp_path):
    found = browsed_by_node(world, tmp_path)
    assert found["types"]["machine"] == [GMS, 1002, "GMSType"]
    assert found["types"]["identification"] == [GMS, 1011, "GMSIdentificationType"]
    assert found["types"]["monitoring"] == [GMS, 1004, "GMSMonitoringType"]
    assert found["types"]["result"] == [GMS, 2004, "GMSResultType"]
    assert found["name"] == "mill-7"


def written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def large(path: Path, size: int = MAX_BYTES + 1) -> Path:
    with path.open("wb") as file:
        file.truncate(size)
    return path


BAD = {
    "missing": (lambda d: (d / "none.xml",), "there is no such OPC UA node set"),
    "a folder": (lambda d: (d,), "cannot be read: .*directory"),
    "not XML": (lambda d: (written(d / "a.xml", "GMS"),), "it is not XML in line 1"),
    "a page of the web": (lambda d: (written(d / "a.xml", "<html/>"),), "it is not a UANodeSet with a model"),
    "too large": (lambda d: (large(d / "a.xml"),), "larger than 4 MB together with this one"),
    "too large with the others": (
        lambda d: (written_gms(d / "a.xml"), large(d / "b.xml", MAX_BYTES - 1_400_000)), "larger than 4 MB together",
    ),
    "another namespace": (lambda d: (written_gms(d / "a.xml", uri="urn:x"),), "urn:x of its model is not one of its"),
    "of the server": (
        lambda d: (written_gms(d / "a.xml", uri="http://opcfoundation.org/UA/"),), "is part of the server itself",
    ),
    "shipped already": (
        lambda d: (written_gms(d / "a.xml", uri=MACHINE_TOOL),), "MachineTool/ is also that of Opc.Ua.MachineTool",
    ),
    "twice": (lambda d: (written_gms(d / "a.xml"), written_gms(d / "b.xml")), "GMS/ is also that of a.xml"),
    "without what it builds on": (
        lambda d: (written_gms(d / "a.xml", also_required="urn:none"),), "builds on urn:none, which is not here",
    ),
    "newer than what it builds on": (
        lambda d: (written_gms(d / "a.xml", old="9.0.0"),), "needs version 9.0.0 of .*: 1.* is there",
    ),
    "a long version of what it builds on": (
        lambda d: (written_gms(d / "a.xml", old="9" * 5000),), "the version that it needs of .* is too long",
    ),
    "what it builds on has no namespace": (
        lambda d: (written(d / "a.xml", written_gms(d / "b.xml").read_text().replace(
            f'RequiredModel ModelUri="{DI}"', "RequiredModel")),), "on which it builds has no namespace",
    ),
    "on itself": (lambda d: (written_gms(d / "a.xml", also_required=GMS),), "it builds on itself"),
}  # fmt: skip


@pytest.mark.parametrize("what", list(BAD))
def test_an_unusable_file_is_named_with_what_to_do(tmp_path, what):
    make, words = BAD[what]
    files = make(tmp_path)
    with pytest.raises(EndpointUnavailable, match=words) as caught:
        node_sets_to_load(OpcUaSettings(further_node_sets=files))
    assert caught.value.where["key"] == "opcua.further_node_sets"
    assert caught.value.where["file"] == str(files[-1])
    assert caught.value.hint


def test_order_in_the_settings_does_not_matter(tmp_path):
    base = written_gms(tmp_path / "base.xml")
    above = written(tmp_path / "above.xml", base.read_text().replace(f'ModelUri="{GMS}"', 'ModelUri="urn:above"', 1)
                    .replace(f"<Uri>{GMS}</Uri>", f"<Uri>urn:above</Uri><Uri>{GMS}</Uri>")
                    .replace("</Model>", f'<RequiredModel ModelUri="{GMS}"/></Model>'))  # fmt: skip
    assert list(node_sets_to_load(OpcUaSettings(further_node_sets=(above, base))))[-2:] == [GMS, "urn:above"]


def test_zeros_at_the_end_of_a_version_do_not_count(tmp_path):
    # Machine Tools is there as 1.02.0, Result Transfer as 1.01.0
    text = written_gms(tmp_path / "gms.xml").read_text()
    for version in ("1.02", "1.02.0.0"):
        file = written(tmp_path / "a.xml", text.replace(f'"{MACHINE_TOOL}" Version="1.01.1"',
                                                        f'"{MACHINE_TOOL}" Version="{version}"'))  # fmt: skip
        assert version in file.read_text()
        assert GMS in node_sets_to_load(OpcUaSettings(further_node_sets=(file,)))


def test_the_check_of_the_settings_says_it_before_the_service_does(tmp_path):
    settings = tmp_path / "volcal.toml"
    quick = Path(__file__).parents[2] / "config" / "quick.toml"
    settings.write_text(f'{quick.read_text()}\n[opcua]\nenabled = true\nfurther_node_sets = ["gms.xml"]\n')
    said = volcal("config", "check", settings, exit_code=EndpointUnavailable.exit_code).stderr
    assert "there is no such OPC UA node set" in said
    assert "opcua.further_node_sets" in said
