"""Equipment of the contract tests of looks: simulators on their wires, which record what they receive, in conditions in
which a look must change nothing."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, cast

import can
import numpy as np
from rigs import drives

from drivers.canopen_mount.mount import CanopenMount
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import Clock, InterruptibleClock, VirtualClock
from drivers.contract.look_contract import LookRig
from drivers.links.can_bus import CanNetworks
from drivers.modbus_cnc.device import ModbusCnc
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.registry import DeviceContext
from drivers.roles import TableImage
from drivers.serial_cnc.device import SerialCnc
from drivers.serial_cnc.settings import SerialCncSettings
from simulators.scenario import read_scenario
from simulators.wire.can.mounts import CanMounts
from simulators.wire.grbl.port import GrblPort
from simulators.wire.grbl.reports import GrblState
from simulators.wire.modbus.controller import ModbusController
from simulators.wire.modbus.rtu import LineSettings, ModbusRtuController
from simulators.wire.shared_world import SharedWorld
from simulators.world.world import World

SCENARIO = Path(__file__).resolve().parents[2] / "config" / "simulators" / "case-study.toml"
FIRST_MM, SECOND_MM = np.array([1000.0, 100.0, 300.0]), np.array([1400.0, 120.0, 350.0])
TABLE = TableImage((0.0, 0.0, 0.0), (2000.0, 1300.0, 750.0), 1e-4, np.full((3, 2, 3, 3), 25, dtype=np.int32))
MEANWHILE_S = 1.0
"""Machine time from the beginning of a motion to the look at the machine."""
NMT_STOP = 0x02
MARK = b"\xfe"
"""Byte that means nothing to GRBL."""
PATIENCE_S = 600.0
NO_ANSWER_S = 1.2
"""Wall time after which equipment that answers nothing is given up. That which answers has much longer, on a busy
computer too."""
numbers = itertools.count()


class Once:
    """Action that a clock performs once, in the middle of a motion."""

    def __init__(self, inner: Clock, action: Callable[[], None]) -> None:
        self._inner, self._action = inner, action
        self._at_s = inner.now() + MEANWHILE_S
        self.done = False

    def __call__(self) -> None:
        if not self.done and self._inner.now() >= self._at_s:
            self.done = True
            self._action()


class Simulated:
    """World without errors in virtual time, with what its servers have received."""

    def __init__(self) -> None:
        self.world = World(read_scenario(SCENARIO).without_errors())
        self.shared = SharedWorld(self.world)
        self.clock = VirtualClock()
        self.clock.subscribe(self.shared.advance_to)

    def state(self) -> tuple[object, ...]:
        controller = self.world.controller
        mounts = [
            (mount.position_deg("azimuth"), mount.position_deg("elevation")) for mount in self.world.mounts.values()
        ]
        return (
            controller.motion,
            controller.fault,
            tuple(controller.displayed_position()),
            tuple(controller.permissions.items()),
            controller.active_bank,
            sorted(controller.banks),
            mounts,
        )


class ControllerLook(LookRig):
    """Controller with a table in bank 1, which is active. `make` returns a closed device that uses the given clock."""

    def __init__(self, simulated: Simulated, make: Callable[..., Any]) -> None:
        self._simulated = simulated
        self._make = make
        self.device = make(simulated.clock)

    def with_table(self) -> None:
        """Write the table and activate it, and leave the axes at rest away from the ends of their travel."""
        device = self._make(self._simulated.clock)
        device.open()
        with closing(device):
            device.stage(1, TABLE)
            device.activate(1)
            device.move_to(FIRST_MM, feed_mm_per_s=None, guarded=False)

    def read(self) -> object:
        device = cast(Any, self.device)
        return device.active_bank(), device.pending_bank(), dict(device.temperatures_c())

    def read_tables(self) -> object:
        table = cast(Any, self.device).read_table(1)
        assert table is not None
        assert table.same_as(TABLE)
        return table

    def commands(self) -> Sequence[Callable[[], object]]:
        device = cast(Any, self.device)
        return (
            device.reset,
            device.hold,
            device.resume,
            lambda: device.move_to(SECOND_MM, feed_mm_per_s=None, guarded=False),
            lambda: device.move_to(SECOND_MM, feed_mm_per_s=5.0, guarded=True),
            lambda: device.touch_towards(SECOND_MM, feed_mm_per_s=5.0),
            lambda: device.stage(2, TABLE),
            lambda: device.activate(0),
        )

    can_move = True

    def move_with_another_client(self, meanwhile: Callable[[], None]) -> None:
        if not self.can_move:
            return
        once = Once(self._simulated.clock, meanwhile)
        other = self._make(InterruptibleClock(self._simulated.clock, once))
        other.open()
        with closing(other):
            other.move_to(SECOND_MM, feed_mm_per_s=100.0, guarded=False)
            assert np.allclose(other.position(), SECOND_MM, atol=2e-3)
        assert once.done


class ModbusLook(ControllerLook):
    selections = frozenset({"write 2400"})

    def __init__(self, simulated: Simulated, server: ModbusController | ModbusRtuController, base: Path) -> None:
        options = {"timeout_s": 2.0, **server.agent_settings}
        super().__init__(
            simulated, lambda clock: ModbusCnc(ModbusCncSettings.model_validate(options), clock, f"cnc-{base.name}")
        )
        self._registers = server.registers
        self._record: list[str] = []
        read, write = server.registers.read, server.registers.write

        def recorded_read(address: int, count: int) -> bytes:
            self._record.append(f"read {address}")
            return read(address, count)

        def recorded_write(address: int, data: bytes) -> None:
            self._record.append(f"write {address}")
            write(address, data)

        server.registers.read, server.registers.write = recorded_read, recorded_write  # type: ignore[method-assign]

    def received(self) -> list[str]:
        taken, self._record[:] = list(self._record), []
        return taken

    def is_query(self, received: str) -> bool:
        return received.startswith("read")

    def state(self) -> object:
        registers = self._registers
        written = {block.address: bytes(image) for block, image in registers._written.items() if block.address != 2400}
        return self._simulated.state(), written, registers.motion.state, registers.motion.fault


class GrblLook(ControllerLook):
    def __init__(self, simulated: Simulated, port: GrblPort, base: Path) -> None:
        options = {
            **port.agent_settings,
            "restarts_when_opened": False,
            "declared_temperatures_c": {"artefact": 20.0},
            "boot_timeout_s": 60.0,
        }

        def make(clock: Clock, **changes: float) -> SerialCnc:
            return SerialCnc(SerialCncSettings.model_validate(options | changes), DeviceContext("cnc", clock, base))

        super().__init__(simulated, make)
        self.port = port
        self._record = bytearray()
        self._files = base
        self._marked = threading.Event()
        received = port.controller.received

        def recorded(data: bytes) -> None:
            own = data.replace(MARK, b"")
            self._record += own
            received(own)
            if own != data:
                self._marked.set()

        port.controller.received = recorded  # type: ignore[method-assign]

    def expect_no_answer(self) -> None:
        self.answers = False
        self.device = self._make(self._simulated.clock, boot_timeout_s=NO_ANSWER_S)

    def received(self) -> list[str]:
        self._await_all()
        taken = [chr(byte) for byte in self._record]
        self._record.clear()
        return taken

    def is_query(self, received: str) -> bool:
        return received == "?"

    def state(self) -> object:
        self._await_all()
        controller = self.port.controller
        receiver = controller._receiver
        files = {file: file.read_bytes() for file in sorted(self._files.rglob("*")) if file.is_file()}
        return (
            self._simulated.state(),
            controller.state,
            controller._homed,
            controller._critical,
            (bytes(receiver._waiting), "".join(receiver._reading)),
            files,
        )

    def commands(self) -> Sequence[Callable[[], object]]:
        return (*super().commands(), cast(SerialCnc, self.device).home_axes)

    def _await_all(self) -> None:
        """Wait until the controller has received what was written to the line before."""
        self._marked.clear()
        line = os.open(self.port.line.device_path, os.O_WRONLY | os.O_NOCTTY)
        try:
            os.write(line, MARK)
        finally:
            os.close(line)
        assert self._marked.wait(PATIENCE_S)

    def type(self, data: bytes) -> None:
        """Feed bytes to the controller, as another program or a person does."""
        with self._simulated.shared.lock:
            self.port.controller.received(data)


class CanLook(LookRig):
    """Rotary mount with two drives; a sniffer on the bus records all frames."""

    def __init__(self, simulated: Simulated, mounts: CanMounts, sniffer: can.BusABC) -> None:
        self._simulated = simulated
        self._mounts = mounts
        self.bus = sniffer
        self.device = self.make(simulated.clock)
        self.can_move = True

    def make(self, clock: Clock, sdo_timeout_s: float = 5.0) -> CanopenMount:
        axes = drives({"azimuth": 1, "elevation": 2})
        # networks of its own, as another process has
        return CanopenMount(
            CanopenMountSettings.model_validate(
                {**self._mounts.agent_settings, **axes, "sdo_timeout_s": sdo_timeout_s}
            ),
            DeviceContext("mount", clock, Path()),
            CanNetworks(),
        )

    def expect_no_answer(self) -> None:
        self.answers = False
        self.device = self.make(self._simulated.clock, NO_ANSWER_S)

    def read(self) -> object:
        return cast(CanopenMount, self.device).orientation()

    def read_tables(self) -> object:
        return None

    def commands(self) -> Sequence[Callable[[], object]]:
        mount = cast(CanopenMount, self.device)
        return mount.home, lambda: mount.orient_to(30.0, 10.0)

    def received(self) -> list[str]:
        """Return the frames on the bus that no drive has sent, as identifier and data in hexadecimal."""
        seen = []
        while (message := self.bus.recv(0.0)) is not None:
            identifier = message.arbitration_id
            of_a_drive = identifier & 0x780 in (0x580, 0x700) or 0x81 <= identifier <= 0xFF
            if not of_a_drive:
                seen.append(f"{identifier:03X} {bytes(message.data).hex()}")
        return seen

    def is_query(self, received: str) -> bool:
        """Return True for SDO uploads and their aborts: command specifiers 2, 3 and 4 of CiA 301."""
        identifier, data = received.split()
        return int(identifier, 16) & 0x780 == 0x600 and int(data[:2], 16) >> 5 in (2, 3, 4)

    def state(self) -> object:
        return self._simulated.state(), [
            (
                node.state,
                {key: entry.upload() for key, entry in node._sdo._dictionary.items() if entry.read is not None},
            )
            for node, _ in self._mounts._drives.values()
        ]

    def use(self) -> None:
        """Turn the mount once with another client, so that its nodes are operational and send heartbeats."""
        mount = self.make(self._simulated.clock)
        mount.open()
        with closing(mount):
            mount.orient_to(10.0, 5.0)

    def fail(self, fault: str) -> None:
        with self._simulated.shared.lock:
            self._mounts.fail(1, fault)
        self._simulated.clock.sleep(1.0)  # the drive reacts to its fault and reports it

    def stop_nodes(self) -> None:
        with self._simulated.shared.lock:
            for node, _ in self._mounts._drives.values():
                node.receive(0x000, bytes((NMT_STOP, node.node_id)))

    def move_with_another_client(self, meanwhile: Callable[[], None]) -> None:
        if not self.can_move:
            return
        once = Once(self._simulated.clock, meanwhile)
        other = self.make(InterruptibleClock(self._simulated.clock, once))
        other.open()
        with closing(other):
            reached = other.orient_to(60.0, 20.0)
        assert (round(reached.azimuth_deg, 2), round(reached.elevation_deg, 2)) == (60.0, 20.0)
        assert once.done


@contextmanager
def modbus(base: Path, condition: str, *, rtu: bool = False) -> Iterator[LookRig]:
    simulated = Simulated()
    server = (
        ModbusRtuController(simulated.shared, LineSettings())
        if rtu
        else ModbusController(simulated.shared, ("127.0.0.1", 0))
    )
    server.start()
    with closing(server):
        look = ModbusLook(simulated, server, base)
        look.with_table()
        if condition == "emergency stop":
            with simulated.shared.lock:
                simulated.world.controller.fail("emergency stop")
            look.can_move = False
        with closing(look.device):
            yield look


@contextmanager
def grbl(base: Path, condition: str) -> Iterator[LookRig]:
    simulated = Simulated()
    port = GrblPort(simulated.shared, str(base / f"tty{next(numbers)}"))
    port.start()
    with closing(port):
        look = GrblLook(simulated, port, base)
        look.with_table()
        if condition == "locked":
            port.controller.state, port.controller._homed = GrblState.ALARM, False  # as after power-on
        look.can_move = condition == "ready"
        spoilt = {"half a line": b"G53 G0 X-1", "alarm of a limit": b"G53 G0 X500\n", "held": b"!"}
        look.type(spoilt.get(condition, b""))
        if condition == "alarm of a limit":
            look.expect_no_answer()
        with closing(look.device):
            yield look


@contextmanager
def canopen(base: Path, condition: str) -> Iterator[LookRig]:
    simulated = Simulated()
    channel = f"look-{next(numbers)}"
    with ExitStack() as opened:
        sniffer = opened.enter_context(can.Bus(interface="virtual", channel=channel))
        mounts = CanMounts(f"virtual:{channel}", tuple(simulated.world.mounts.values()), simulated.shared.lock)
        opened.callback(mounts.close)
        simulated.shared.subscribe(mounts.advance)
        mounts.start()
        look = CanLook(simulated, mounts, sniffer)
        look.can_move = condition in ("not started", "used")
        if condition != "not started":
            look.use()
        if condition == "fault":
            look.fail("over_current")
        if condition == "stopped":
            look.stop_nodes()
            look.expect_no_answer()
        opened.callback(look.device.close)
        yield look
