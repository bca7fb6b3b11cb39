"""OPC UA endpoint over real sockets with asyncua's client: access control, reading, method calls and events."""

from __future__ import annotations

import asyncio
import contextlib
import json
import math
import socket
import stat
import sys
from collections.abc import Iterator
from datetime import timedelta

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua.uaerrors import UaStatusCodeError
from fake_control import FakeControl
from opcua_world import TOKEN, WITHIN_S, World, certificate, node, opened, own_id, read, secure

from agent.execution.states import RunState
from agent.service.opcua.certificates import own_certificate
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.service.opcua.model import METHODS, NAMESPACE, PROGRAM_STATES, VARIABLES
from agent.settings.opcua import OpcUaSettings
from drivers.errors import ConfigurationError

ROOT = "Volcal"


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Iterator[World]:
    yield from opened(tmp_path_factory.mktemp("opcua"), anonymous_reading=False)


@pytest.fixture(scope="module")
def readable(tmp_path_factory) -> Iterator[World]:
    yield from opened(tmp_path_factory.mktemp("opcua"), anonymous_reading=True)


@pytest.fixture(autouse=True)
def at_rest(request) -> None:
    for name in ("world", "readable"):
        if name in request.fixturenames:
            request.getfixturevalue(name).control.begin_anew()


async def call(client: Client, method: str, *arguments):
    return await node(client, ROOT).call_method(own_id(method), *arguments)


START = ("calibrate", "S1+S3", ua.Variant([1, 2], ua.VariantType.Int32), 15.5, False, True)


def refused(code: str):
    return pytest.raises(UaStatusCodeError, match=code)


def test_a_run_from_start_to_abort(world):
    async def scene() -> None:
        async with world.connected() as client:
            assert (await client.get_namespace_array())[2] == NAMESPACE
            assert await read(client, "Monitoring/PackMLState") == "Idle"
            run = await call(client, "Start", *START)
            assert run == "2031-05-01-calibrate"
            assert await read(client, "Production/Job/Identifier") == run
            assert await read(client, "Production/ActiveProgram/State") == "Running"
            assert await read(client, "Production/ActiveProgram/Name") == "S1+S3"
            await call(client, "Hold")
            assert await read(client, "Monitoring/RunState") == "held"
            await call(client, "Resume")
            await call(client, "Abort", "dust on the balls")
            assert await read(client, "Monitoring/PackMLState") == "Aborted"
            await call(client, "Reset")
            assert await read(client, "Monitoring/PackMLState") == "Idle"

    asyncio.run(scene())
    request = world.control.asked[0][1]
    assert (request.kind, request.source, request.consent) == ("calibrate", "opc ua", True)
    assert (request.position_set, request.stations, request.slot_minutes) == ("S1+S3", [1, 2], 15.5)
    assert ("abort", "dust on the balls") in world.control.asked


def test_what_is_left_empty_is_as_the_settings_say(world):
    async def scene() -> None:
        async with world.connected() as client:
            await call(
                client, "Start", "nightly", "", ua.Variant([], ua.VariantType.Int32, is_array=True), 0.0, True, False
            )

    asyncio.run(scene())
    request = world.control.asked[0][1]
    assert (request.position_set, request.stations, request.slot_minutes) == (None, None, None)
    assert (request.full_allowed, request.consent) == (True, False)


def test_refusals_are_bad_status_codes_with_their_words_beside(world):
    async def scene() -> None:
        async with world.connected() as client:
            with refused("BadInvalidState"):
                await call(client, "Resume")
            assert await read(client, "Notification/LastRefusalCode") == 210
            assert "not allowed in state idle" in await read(client, "Notification/LastRefusalText")
            await call(client, "Start", *START)
            with refused("BadInvalidState"):
                await call(client, "Start", *START)
            assert await read(client, "Notification/LastRefusalCode") == 460
            assert "in progress" in await read(client, "Notification/LastRefusalText")
            with refused("BadInvalidArgument"):
                await call(client, "Start", "polish", *START[1:])
            assert await read(client, "Notification/LastRefusalCode") == 202
            with refused("BadInvalidArgument"):
                await call(client, "Answer", ua.Variant(3, ua.VariantType.Int32), True)
            world.control.now(RunState.COMPLETE)
            with refused("BadUnexpectedError"):
                await call(client, "Start", "verify", "DEFECT", *START[2:])
            assert await read(client, "Notification/LastRefusalCode") == 900

    asyncio.run(scene())
    assert world.control.count("start") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        (),
        ("verify",),
        (*START, True),
        (1, *START[1:]),
        ("verify", "S1", "1 2", *START[3:]),
        ("verify", "S1", ua.Variant(1, ua.VariantType.Int32), *START[3:]),
        ("verify", "S1", START[2], "15", False, True),
        ("verify", "S1", START[2], 15.0, 0, 1),
        ("verify", "S1", START[2], -1.0, False, True),
        ("verify", "S1", START[2], math.nan, False, True),
    ],
)
def test_arguments_of_another_number_or_type_are_refused(world, arguments):
    async def scene() -> None:
        async with world.connected() as client:
            with refused("BadInvalidArgument"):
                await call(client, "Start", *arguments)

    asyncio.run(scene())
    assert world.control.asked == []


def test_progress_results_alarms_and_question(world):
    async def scene() -> None:
        async with world.connected() as client:
            assert math.isnan(await read(client, "ResultManagement/Results/VENow"))
            assert await read(client, "Monitoring/ActiveBank") == -1
            world.control.now(RunState.MEASURING, fraction=0.25, minutes_left=7.5, balls=12)
            await until(client, "Production/Job/Progress", 0.25)
            assert await read(client, "Production/Job/RemainingTime") == 7.5
            assert await read(client, "Production/Job/Balls") == 12
            world.control.ask(5)
            await until(client, "Notification/QuestionNumber", 5)
            await call(client, "Answer", ua.Variant(5, ua.VariantType.Int32), False)
            assert await read(client, "Notification/QuestionNumber") == -1
            world.control.now(RunState.COMPLETE, ve_before_um=38.5, ve_now_um=9.25, active_bank=1)
            world.control.tell("outcome", "accepted", kind="calibrate", vce_um=3.5)
            await until(client, "ResultManagement/Results/VENow", 9.25)
            outcome = json.loads(await until_other(client, "ResultManagement/Results/Outcome", ""))
            assert outcome == {"text": "accepted", "kind": "calibrate", "vce_um": 3.5}
            assert await read(client, "ResultManagement/Results/VEBefore") == 38.5
            assert await read(client, "Monitoring/ActiveBank") == 1
            world.control.fault()
            await until(client, "Notification/AlarmCodes", [311])
            assert await read(client, "Notification/AlarmHints") == ["check the cable"]

    asyncio.run(scene())
    assert ("answer", (5, False)) in world.control.asked


class Heard:
    def __init__(self) -> None:
        self.events: asyncio.Queue = asyncio.Queue()

    def event_notification(self, event) -> None:
        self.events.put_nowait(event)


def test_events_for_states_and_alarms(world):
    async def scene() -> None:
        async with world.connected() as client:
            heard = Heard()
            types = [
                await client.nodes.base_event_type.get_child(f"2:{name}")
                for name in ("StateChangeEventType", "AlarmEventType")
            ]
            subscription = await client.create_subscription(50, heard)
            await subscription.subscribe_events(node(client, ROOT), types)
            world.control.now(RunState.MEASURING)
            event = await asyncio.wait_for(heard.events.get(), WITHIN_S)
            assert (event.RunState, event.PackMLState, event.Severity) == ("measuring", "Execute", 100)
            world.control.fault()
            found = [await asyncio.wait_for(heard.events.get(), WITHIN_S) for _ in range(2)]
            assert found[0].RunState == "faulted"
            assert (found[1].Code, found[1].Hint, found[1].Severity) == (311, "check the cable", 800)
            assert found[1].Message.Text == "the mount does not answer"
            await subscription.delete()

    asyncio.run(scene())


async def until(client: Client, path: str, value) -> None:
    async with asyncio.timeout(WITHIN_S):
        while await read(client, path) != value:
            await asyncio.sleep(0.01)


async def until_other(client: Client, path: str, value):
    async with asyncio.timeout(WITHIN_S):
        while (found := await read(client, path)) == value:
            await asyncio.sleep(0.01)
    return found


@pytest.mark.parametrize(
    "password", ["", "wrong", TOKEN + "x", TOKEN[:-1], None], ids=["empty", "wrong", "longer", "shorter", "none"]
)
def test_without_the_token_nobody_gets_in(world, password):
    async def scene() -> None:
        async with world.connected(password=password):
            raise AssertionError("let in")

    with pytest.raises((UaStatusCodeError, ua.UaError)):
        asyncio.run(scene())


@pytest.mark.parametrize("password", [TOKEN, None], ids=["token", "none"])
def test_a_strange_certificate_is_refused_even_with_the_token(readable, password):
    async def scene() -> None:
        async with readable.connected(password=password, pair=readable.strange):
            raise AssertionError("let in")

    with refused("BadUserAccessDenied"):
        asyncio.run(scene())


def test_a_certificate_that_ran_out_is_refused(world, tmp_path):
    old = certificate(tmp_path, "old", valid_for=timedelta(hours=1))
    world.trust(old[0])

    async def scene() -> None:
        async with world.connected(pair=old):
            raise AssertionError("let in")

    with refused("BadUserAccessDenied"):
        asyncio.run(scene())


def test_trust_is_given_and_taken_without_a_restart(world, tmp_path):
    guest = certificate(tmp_path, "guest")
    world.trust(guest[0])
    (world.endpoint.trusted_clients / "README").write_text("copy certificates of clients here")
    damaged = guest[0].read_bytes().replace(b"\xa0\x03\x02\x01\x02", b"\xa0\x03\x02\x01\x2c")  # its version is 45
    (world.endpoint.trusted_clients / "a-damaged-one.der").write_bytes(damaged)

    async def scene() -> None:
        async with world.connected(pair=guest) as client:
            assert await read(client, "Identification/Name") == "mill-7"

    asyncio.run(scene())
    (world.endpoint.trusted_clients / guest[0].name).unlink()
    with refused("BadUserAccessDenied"):
        asyncio.run(scene())


def test_idle_connections_keep_no_trusted_client_out(world):
    host, port = world.endpoint.address
    with contextlib.ExitStack() as held:
        idle = [held.enter_context(socket.create_connection((host, port), timeout=WITHIN_S)) for _ in range(50)]
        assert idle[0].recv(1) == b""  # the oldest makes room

        async def play() -> None:
            async with world.connected() as client:
                for _ in range(30):
                    idle.append(held.enter_context(socket.create_connection((host, port), timeout=WITHIN_S)))
                await asyncio.to_thread(idle[40].recv, 1)
                assert await read(client, "Monitoring/PackMLState") == "Idle"

        asyncio.run(play())


def test_nobody_gets_a_session_without_encryption(readable):
    async def scene() -> None:
        client = Client(readable.url, timeout=WITHIN_S)
        modes = [(e.SecurityPolicyUri, e.SecurityMode) for e in await client.connect_and_get_server_endpoints()]
        assert modes == [(SecurityPolicyBasic256Sha256.URI, ua.MessageSecurityMode.SignAndEncrypt)]
        await client.connect()

    with pytest.raises((UaStatusCodeError, ua.UaError)):
        asyncio.run(scene())


def test_anonymous_reads_holds_and_aborts_but_nothing_else(readable):
    async def scene() -> None:
        readable.control.now(RunState.MEASURING)
        async with readable.connected(password=None) as client:
            for method, arguments in (("Start", START), ("Resume", ()), ("Reset", ()), ("ResumeRun", ())):
                with refused("BadUserAccessDenied"):
                    await call(client, method, *arguments)
            with refused("BadUserAccessDenied"):
                await call(client, "Answer", ua.Variant(1, ua.VariantType.Int32), True)
            await until(client, "Monitoring/RunState", "measuring")
            await call(client, "Hold")
            await call(client, "Abort", "")

    asyncio.run(scene())
    assert readable.control.asked == [("hold", None), ("abort", "abort over OPC UA")]


def test_other_methods_of_the_server_need_the_token(readable):
    async def scene() -> None:
        async with readable.connected(password=None) as client:
            server = client.get_node(ua.ObjectIds.Server)
            with refused("BadUserAccessDenied"):
                await server.call_method(ua.NodeId(ua.Int32(ua.ObjectIds.Server_GetMonitoredItems)), 1)

    asyncio.run(scene())


def test_nobody_writes_a_node_or_changes_the_address_space(world):
    async def scene() -> None:
        async with world.connected() as client:
            for path in [variable.path for variable in VARIABLES]:
                with pytest.raises(UaStatusCodeError):
                    await node(client, path).write_value(await node(client, path).read_data_value())
            flag = client.get_node(ua.ObjectIds.Server_ServerDiagnostics_EnabledFlag)
            with refused("BadUserAccessDenied"):
                await flag.write_value(await flag.read_data_value())
            name = ua.DataValue(ua.Variant(ua.LocalizedText("Mine"), ua.VariantType.LocalizedText))
            with refused("BadUserAccessDenied"):
                await node(client, ROOT).write_attribute(ua.AttributeIds.DisplayName, name)
            with pytest.raises((UaStatusCodeError, ConnectionError)):
                await client.nodes.objects.add_object(2, "mine")

    asyncio.run(scene())


def test_a_session_cannot_be_taken_over_from_another_channel(world):
    """asyncua binds a channel to any session it names before checking the user, so a guessed number would be enough."""

    async def scene() -> None:
        async with world.connected() as victim:
            token = victim.uaclient.protocol.authentication_token
            thief = world.client(password=TOKEN[1:], pair=world.strange)
            await secure(thief, world, world.strange)
            await thief.connect_socket()
            try:
                await thief.send_hello()
                await thief.open_secure_channel()
                thief.uaclient.protocol.authentication_token = token
                parameters = ua.ActivateSessionParameters(UserIdentityToken=ua.AnonymousIdentityToken(PolicyId="x"))
                with pytest.raises(UaStatusCodeError):
                    await thief.uaclient.activate_session(parameters)
                with pytest.raises((UaStatusCodeError, ConnectionError, TimeoutError)):
                    await call(thief, "Start", *START)
            finally:
                thief.disconnect_socket()
            assert await read(victim, "Monitoring/PackMLState") == "Idle"

    asyncio.run(scene())
    assert world.control.asked == []


def test_the_model_is_what_the_server_offers(world):
    async def scene() -> None:
        async with world.connected() as client:
            for variable in VARIABLES:
                found = node(client, variable.path)
                assert (await found.read_data_type_as_variant_type()).name == variable.form.removesuffix("[]")
                assert (await found.read_attribute(ua.AttributeIds.Description)).Value.Value.Text == variable.meaning
            offered = {(await method.read_browse_name()).Name for method in await node(client, ROOT).get_methods()}
            assert offered == {method.name for method in METHODS}

    asyncio.run(scene())
    assert set(PROGRAM_STATES) == set(RunState)


def test_the_key_is_for_the_owner_only_and_stays_from_start_to_start(world):
    own = world.state / "opcua" / "own"
    assert stat.S_IMODE((own / "key.pem").stat().st_mode) == 0o600
    before = (own / "certificate.der").read_bytes()
    again = own_certificate(world.state / "opcua", "urn:x", "host", "127.0.0.1")
    assert again.certificate.read_bytes() == before


def test_a_damaged_certificate_of_the_server_is_named(tmp_path):
    own_certificate(tmp_path, "urn:x", "host", "127.0.0.1").certificate.write_bytes(b"\x30\x00")
    with pytest.raises(ConfigurationError, match="cannot be read"):
        own_certificate(tmp_path, "urn:x", "host", "127.0.0.1")


def test_a_taken_port_is_named_and_the_door_can_be_closed(world, tmp_path):
    endpoint = OpcUaEndpoint(OpcUaSettings(port=world.endpoint.address[1]), tmp_path, TOKEN)
    with pytest.raises(ConfigurationError, match=r"cannot listen for OPC UA on 127\.0\.0\.1"):
        endpoint.start(FakeControl())
    endpoint.stop()


def test_a_missing_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asyncua", None)
    for name in [name for name in sys.modules if name.startswith("agent.service.opcua.")]:
        if name.rpartition(".")[2] in ("server", "space", "guard", "methods"):
            monkeypatch.delitem(sys.modules, name)
    with pytest.raises(ConfigurationError, match="asyncua is not installed") as caught:
        OpcUaEndpoint(OpcUaSettings(), tmp_path, TOKEN).start(FakeControl())
    assert "volcal[opcua]" in caught.value.hint
