"""Buses between two processes: channel words, settings, the socketcand protocol byte by byte,
multicast if available.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import can
import canopen
import pytest
from aloud import NOT_HERE
from can_listening import listening

from drivers.errors import ConfigurationError, LinkLost
from drivers.links.can_adapters import CanAddress
from drivers.links.can_bus import CanNetworks
from simulators.wire.can.channel import CanChannel, multicast_works, open_channel
from simulators.wire.can.drive import DriveConfig, drive_node
from simulators.wire.can.server import CanServer
from simulators.wire.can.socketcand_server import SocketcandServerBus, format_frame


class StillAxes:
    def begin_turn(self, axis: str, angle_deg: float, speed_deg_per_s: float | None) -> None:
        raise AssertionError("nothing turns here")

    def position_deg(self, axis: str) -> float:
        return 1.5

    def moving(self, axis: str) -> bool:
        return False

    def halt(self, axis: str | None = None) -> None:
        return None


@contextmanager
def pumped(bus: can.BusABC) -> Iterator[list[can.Message]]:
    """Keep reading the bus, as a CAN server does, and close it at the end."""
    with bus, listening(bus) as received:
        yield received


class RawClient:
    """Client on a plain socket that speaks the protocol as documented."""

    def __init__(self, port: int) -> None:
        self._stream = socket.create_connection(("127.0.0.1", port), timeout=600.0)
        self._text = ""

    def expect(self, text: str) -> None:
        while len(self._text) < len(text):
            chunk = self._stream.recv(256)
            assert chunk, f"the server hung up after {self._text!r}"
            self._text += chunk.decode("ascii")
        assert self._text.startswith(text), self._text
        self._text = self._text[len(text) :]

    def expect_end(self) -> None:
        assert self._stream.recv(16) == b""

    def say(self, text: str) -> None:
        self._stream.sendall(text.encode("ascii"))

    def close(self) -> None:
        self._stream.close()

    def next_message(self) -> str:
        while ">" not in self._text:
            self._text += self._stream.recv(256).decode("ascii")
        message, _, self._text = self._text.partition(">")
        return message + ">"


def raw_mode(port: int) -> RawClient:
    client = RawClient(port)
    client.expect("< hi >")
    client.say("< open can0 >")
    client.expect("< ok >")
    client.say("< rawmode >")
    client.expect("< ok >")
    return client


def test_socketcand_dialogue() -> None:
    bus = SocketcandServerBus("can0")
    with pumped(bus) as received:
        one, other = raw_mode(bus.port), raw_mode(bus.port)
        one.say("< echo >")
        one.expect("< echo >")
        one.say("< send 605 8 40 41 60 0 0 0 0 0 >< send 1ABCDEF0 2 1 f1 >")
        first, second = other.next_message().split(" "), other.next_message().split(" ")
        assert (first[1], first[2], first[4]) == ("frame", "605", "4041600000000000")
        assert (second[1], second[2], second[4]) == ("frame", "1ABCDEF0", "01F1")
        bus.send(can.Message(arbitration_id=0x85, data=b"\x11\x86\x21", is_extended_id=False))
        assert one.next_message().split(" ")[4] == "118621", "the sender hears the bus and not itself"
        one.close()
        other.close()
    assert [(message.arbitration_id, message.is_extended_id) for message in received] == [
        (0x605, False),
        (0x1ABCDEF0, True),
    ]
    assert bytes(received[0].data) == bytes.fromhex("4041600000000000")


@pytest.mark.parametrize(
    "bad", ["< send 605 3 1 2 >", "< send xyz 0 >", "< send 605 9 1 2 3 4 5 6 7 8 9 >", "< send 605 1 1FF >"]
)
def test_socketcand_refuses_what_is_no_frame(bad: str) -> None:
    bus = SocketcandServerBus("can0")
    with pumped(bus) as received:
        client = raw_mode(bus.port)
        client.say(bad)
        client.expect("< error wrong frame >")
        client.close()
    assert received == []


def test_socketcand_knows_its_bus_and_its_commands() -> None:
    bus = SocketcandServerBus("can0")
    with pumped(bus):
        client = RawClient(bus.port)
        client.expect("< hi >")
        client.say("< dance >")
        client.expect("< error unknown command >")
        client.say("< open can7 >")
        client.expect("< error could not open bus >")
        client.expect_end()
        client.close()
        endless = RawClient(bus.port)
        endless.expect("< hi >")
        endless.say("x" * 300)
        endless.expect_end()
        endless.close()


@pytest.mark.parametrize(
    "spec", ["", "can0", "socketcand:127.0.0.1", "socketcand:127.0.0.1:http", "udp_multicast::1", "slcan:", "virtual:"]
)
def test_unknown_words_say_the_forms(spec: str) -> None:
    with pytest.raises(ConfigurationError, match=r"socketcand:HOST:PORT"):
        open_channel(spec)


def test_port_in_use_is_named() -> None:
    with open_channel("socketcand:127.0.0.1:0").bus as bus:
        assert isinstance(bus, SocketcandServerBus)
        with pytest.raises(ConfigurationError, match=f"127.0.0.1:{bus.port}"):
            open_channel(f"socketcand:127.0.0.1:{bus.port}")


def drive_read(channel: CanChannel) -> bytes:
    """Read the position of a drive through the link that the agent would open."""
    networks = CanNetworks()
    node, _ = drive_node(DriveConfig(5, "azimuth", 1000.0), StillAxes())
    with CanServer(channel.bus, [node]):
        link = networks.acquire(CanAddress.of(channel.interface, channel.channel, channel.options))
        try:
            return bytes(link.add_node(5, canopen.ObjectDictionary()).sdo.upload(0x6064, 0))
        finally:
            link.close()


@pytest.mark.parametrize("spec", ["socketcand:127.0.0.1:0", "slcan:any", "virtual:channel-test"])
def test_drive_behind_a_channel(spec: str) -> None:
    assert drive_read(open_channel(spec)) == bytes.fromhex("DC 05 00 00")


needs_multicast = pytest.mark.skipif(
    not multicast_works(), reason=f"{NOT_HERE}: CAN over multicast in one process: this network has none"
)


@needs_multicast
def test_drive_behind_multicast() -> None:
    assert drive_read(open_channel("udp_multicast:239.74.163.2:0")) == bytes.fromhex("DC 05 00 00")


@needs_multicast
def test_own_frames_are_dropped_on_multicast() -> None:
    channel = open_channel("udp_multicast:239.74.163.2:0")
    networks = CanNetworks()
    link = networks.acquire(CanAddress.of(channel.interface, channel.channel, channel.options))
    heard: list[int] = []
    done = threading.Event()

    def hear(identifier: int, data: bytearray, stamp: float) -> None:
        heard.append(identifier)
        if identifier == 0x185:
            done.set()

    assert link._shared is not None
    network = link._shared.network
    for identifier in (0x205, 0x185):
        network.subscribe(identifier, hear)
    network.send_message(0x205, b"\x0f\x00")
    channel.bus.send(can.Message(arbitration_id=0x185, data=b"\x37\x06", is_extended_id=False))
    try:
        assert done.wait(5.0)
        assert heard == [0x185]
    finally:
        link.close()
        channel.bus.shutdown()


def test_two_processes_over_socketcand() -> None:
    """The agent's side is a separate process with all its parameters on the command line."""
    program = (
        "import sys, canopen\n"
        "from drivers.links.can_adapters import CanAddress\n"
        "from drivers.links.can_bus import CanNetworks\n"
        "options = {'host': '127.0.0.1', 'port': int(sys.argv[1])}\n"
        "link = CanNetworks().acquire(CanAddress.of('socketcand', 'can0', options))\n"
        "print(link.add_node(5, canopen.ObjectDictionary()).sdo.upload(0x6041, 0).hex())\n"
        "link.close()\n"
    )
    channel = open_channel("socketcand:127.0.0.1:0")
    node, _ = drive_node(DriveConfig(5, "azimuth", 1000.0), StillAxes())
    with CanServer(channel.bus, [node]):
        result = subprocess.run(
            [sys.executable, "-c", program, str(channel.options["port"])],
            capture_output=True,
            text=True,
            timeout=600.0,
            check=True,
        )
    assert result.stdout.strip() == "4006"


def test_connection_refused_is_a_lost_link() -> None:
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    with pytest.raises(LinkLost, match=rf"socketcand:can0@127.0.0.1:{port}"):
        CanNetworks().acquire(CanAddress.of("socketcand", "can0", {"host": "127.0.0.1", "port": port}))


def test_server_that_goes_away_is_noticed() -> None:
    bus = SocketcandServerBus("can0")
    networks = CanNetworks()
    with pumped(bus):
        address = CanAddress.of("socketcand", "can0", {"host": "127.0.0.1", "port": bus.port})
        link = networks.acquire(address)
        link.check()
    assert link._shared is not None
    receiver = link._shared.receiver
    receiver.join(5.0)
    assert not receiver.is_alive()
    with pytest.raises(LinkLost, match="closed the connection"):
        link.check()
    link.close()


@pytest.mark.parametrize("spec", ["socketcand:127.0.0.1:0", "virtual:bus-off"])
def test_bus_off_ends_receiving(spec: str) -> None:
    """Adapters that report bus-off send an error frame of class 0x40 (linux/can/error.h)."""
    channel = open_channel(spec)
    with pumped(channel.bus):
        link = CanNetworks().acquire(CanAddress.of(channel.interface, channel.channel, channel.options))
        link.check()
        channel.bus.send(can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8)))
        assert link._shared is not None
        receiver = link._shared.receiver
        receiver.join(5.0)
        with pytest.raises(LinkLost, match="off the bus"):
            link.check()
        link.close()


def test_error_frame_in_the_words_of_socketcand() -> None:
    message = can.Message(arbitration_id=0x40, is_error_frame=True, data=bytes(8))
    assert format_frame(message, 12.5) == "< error 00000040 12.500000 >"


def test_interface_that_the_kernel_has_not() -> None:
    """This fails on every kernel; one without CAN gives another reason than one with it."""
    with pytest.raises(ConfigurationError, match="socketcan:nocan7 cannot be opened"):
        open_channel("socketcan:nocan7")
    with pytest.raises(LinkLost, match=r"cannot open the CAN bus.*link socketcan:nocan7.*ip link"):
        CanNetworks().acquire(CanAddress.of("socketcan", "nocan7", {}))


def test_network_is_shared_and_counted() -> None:
    networks = CanNetworks()
    address = CanAddress.of("virtual", "shared", {})
    first, second = networks.acquire(address), networks.acquire(address)
    assert first._shared is second._shared
    first.add_node(5, canopen.ObjectDictionary())
    with pytest.raises(ConfigurationError, match="two devices claim CANopen node 5"):
        second.add_node(5, canopen.ObjectDictionary())
    assert first._shared is not None
    bus = first._shared.bus
    first.close()
    first.close()
    second.check()
    second.add_node(5, canopen.ObjectDictionary())
    second.close()
    with pytest.raises(can.CanOperationError):
        bus.recv(0.0)
    with pytest.raises(LinkLost, match="not open"):
        second.check()


@pytest.mark.parametrize("interface", ["no-such-interface", "socketcand"])
def test_wrong_bus_settings_are_configuration_errors(interface: str) -> None:
    with pytest.raises(ConfigurationError, match=f"{interface}:can9"):
        CanNetworks().acquire(CanAddress.of(interface, "can9", {}))
