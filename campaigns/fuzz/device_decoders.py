"""Decoders of register contents, serial frames and device files, and of what people and clients type or send."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ValidationError

from agent.planning.new_machine.fields import parse_travels
from agent.planning.new_machine.spindle import parse_spindle
from agent.service.http.models import AbortBody, AnswerBody, RestoreBody, ResumeRunBody, SettingsBody, StartBody
from campaigns.fuzz.memory_file import MemoryFolder
from campaigns.fuzz.trial import Decoder
from drivers.canopen_mount.description import load_description
from drivers.canopen_mount.settings import AxisSettings
from drivers.clock import VirtualClock
from drivers.links.modbus_rtu import RtuEndpoint, RtuTransport
from drivers.links.modbus_serial_line import SerialLine, build_frame
from drivers.linuxcnc.installation.ini_file import IniFile
from drivers.modbus_cnc.codec import NumberFormat
from drivers.modbus_cnc.codes import MAJOR_VERSION, PROTOCOL
from drivers.modbus_cnc.registers import BlockLayouts
from drivers.modbus_cnc.session import ModbusSession
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.modbus_cnc.store import BLOCK_BYTES, BankReader, crc32, data_blocks, table_bytes, table_descriptor
from drivers.roles import TableImage
from drivers.serial_cnc.tape.transfer import decode, encode
from simulators.wire.grbl.blocks import BlockError, BlockParser, WorkOffsets
from twin.artefact.position_set import parse_position_set
from twin.machine.kinematic_chain import parse_chain

MAX_NODES = 1000
UNIT = 1
WHERE = {"device": "cnc", "link": "fuzz"}
READ_REQUEST = bytes.fromhex("03 03E8 0002")
READ_ANSWER = bytes.fromhex("03 04 0001 0002")
EXCEPTION_ANSWER = bytes.fromhex("83 02")
INI = b"""[EMC]
MACHINE = mill
[HAL]
HALFILE = mill.hal
HALFILE = other.hal
# >>> volcal linuxcnc install
POSTGUI_HALFILE = volcal.hal
# <<< volcal linuxcnc install
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
"""
OBJECT_TYPES = {0x6040: 6, 0x6041: 6, 0x6060: 2, 0x6061: 2, 0x6064: 4, 0x607A: 4, 0x6081: 7, 0x6083: 7, 0x6084: 7}
"""CANopen data type of each object that the EDS file lists."""
GCODE = (b"G21G90G0X1.5Y-2Z3", b"G38.2Z-10F100", b"G1X10F200", b"G10L2P1X1Y2Z3", b"G92X0", b"G43.1Z5", b"G4P0.5")
BODIES: tuple[tuple[type[BaseModel], bytes], ...] = (
    (StartBody, b'{"kind": "calibrate", "consent": true, "source": "page"}'),
    (ResumeRunBody, b'{"source": "page"}'),
    (AbortBody, b'{"reason": "abort pressed"}'),
    (AnswerBody, b'{"number": 1, "yes": true}'),
    (RestoreBody, b'{"run_id": "20260101-000000", "role": "backup", "source": "page"}'),
    (SettingsBody, b'{"toml": "[machine]"}'),
)


def device_decoders() -> Iterator[Decoder]:
    for numbers in (NumberFormat("float64"), NumberFormat("float64", word_order="low-first")):
        layouts = BlockLayouts(numbers)
        yield Decoder(f"status registers ({numbers.word_order})", [_status(layouts)], _status_decoder(layouts))
        yield Decoder(f"bank ({numbers.word_order})", [_bank(layouts)], _bank_decoder(numbers))
    frames = [build_frame(UNIT, READ_ANSWER), build_frame(UNIT, EXCEPTION_ANSWER)]
    yield Decoder("Modbus RTU frame", frames[:1], _rtu)
    yield Decoder("Modbus RTU frame with valid CRC", [READ_ANSWER], lambda data: _rtu(build_frame(UNIT, data)))
    yield Decoder("INI file of LinuxCNC", [INI, INI.replace(b"\n", b"\r\n")], _ini)
    yield Decoder("EDS file of a drive", [_eds_file()], _reading_eds())
    yield Decoder("line of G-code to the simulator", GCODE, _gcode, (BlockError, UnicodeDecodeError))
    yield Decoder("characters of a tape", [encode("N10G0X0\r\n")], decode)
    for body, good in BODIES:
        yield Decoder(f"request {body.__name__} (JSON)", [good], body.model_validate_json, (ValidationError,))
    yield Decoder("kinematic chain", [b"tool-Y-Z-X-bed-workpiece"], _typed(parse_chain))
    yield Decoder("position sets", [b"S1", b"S1+S3"], _typed(lambda text: parse_position_set(text, 2)))
    yield Decoder("travels", [b"800 500 400", b"-10:800 0:500 -400:0"], _typed(parse_travels))
    yield Decoder("spindle direction", [b"-Z", b"+Y"], _typed(parse_spindle))


def _typed(parse: Callable[[str], object]) -> Callable[[bytes], object]:
    """Return a decoder of what was typed: as with arguments of a command, bytes outside UTF-8 become surrogates."""
    return lambda data: parse(data.decode("utf-8", "surrogateescape"))


def _status(layouts: BlockLayouts) -> bytes:
    """Return a consistent status block: zero in every register but those that identify the register map."""
    block = bytearray(2 * layouts.status.size)
    for name, value in (("protocol", PROTOCOL), ("version", MAJOR_VERSION << 8)):
        at = 2 * layouts.status.offset(name)
        block[at : at + 2] = value.to_bytes(2, "big")
    return layouts.status.reordered(bytes(block))


def _status_decoder(layouts: BlockLayouts) -> Callable[[bytes], object]:
    """Return a decoder of status blocks. The link returns as many bytes as were requested, whatever the answer was."""
    size = 2 * layouts.status.size
    return lambda data: layouts.decode_status(data[:size].ljust(size, b"\0"), WHERE, 1000)


def _bank(layouts: BlockLayouts) -> bytes:
    """Return the descriptor and the blocks of a good table, one after the other."""
    counts = np.arange(81, dtype=np.int32).reshape(3, 3, 3, 3)
    table = TableImage((0.0, 0.0, 0.0), (100.0, 100.0, 100.0), 1e-4, counts)
    data = table_bytes(table)
    descriptor = layouts.descriptor.pack(table_descriptor(1, table, crc32(data)))
    return descriptor.ljust(BLOCK_BYTES, b"\0") + b"".join(map(layouts.block.reordered, data_blocks(data)))


class _BankLink:
    """Link whose read window shows the blocks of a bank; behind the last one it shows zeros."""

    where = WHERE
    reconnection = None

    def __init__(self, data: bytes) -> None:
        self._data = data

    def exchange(self, _: int, selector: bytes, *__: int, idempotent: bool) -> bytes:
        assert idempotent
        first = BLOCK_BYTES * int.from_bytes(selector[2:], "big")
        return selector + self._data[first : first + BLOCK_BYTES].ljust(BLOCK_BYTES, b"\0")


def _bank_decoder(numbers: NumberFormat) -> Callable[[bytes], object]:
    settings = ModbusCncSettings(host="127.0.0.1", word_order=numbers.word_order)

    def decode(data: bytes) -> object:
        link: Any = _BankLink(data)
        return BankReader(ModbusSession(link, VirtualClock(), settings), MAX_NODES).read(1)

    return decode


class _EndingPort:
    """Serial port on which one frame arrives, and then nothing ever again."""

    def __init__(self, frame: bytes) -> None:
        self._here, there = socket.socketpair()
        there.sendall(frame)
        there.close()
        self.in_waiting = 0

    def fileno(self) -> int:
        return self._here.fileno()

    def read(self, count: int) -> bytes:
        return self._here.recv(count) if count else b""

    def write(self, data: bytes) -> int:
        return len(data)

    def close(self) -> None:
        self._here.close()


class _PortTransport(RtuTransport):
    """Master on a port that is already open."""

    def __init__(self, port: Any) -> None:
        endpoint = RtuEndpoint(SerialLine(port="/dev/null"), UNIT)
        super().__init__(endpoint, VirtualClock(), timeout_s=1.0, where=WHERE)
        self._serial = port


def _rtu(data: bytes) -> object:
    port = _EndingPort(data[:4096])
    try:
        return _PortTransport(port).ask(READ_REQUEST)
    finally:
        port.close()


def _ini(data: bytes) -> object:
    """Read the file as the installation does, add lines to it, and take them out again."""
    ini = IniFile(Path("mill.ini"), data)
    ini.without_marked_lines()  # raises if a mark is damaged
    section = ini.require_section("HAL")
    entries = list(ini.entries(section))
    ini.insert_after(entries[-1][0] if entries else section.header, "HALFILE = volcal.hal")
    ini.append("[VOLCAL]", "DIRECTORY = /var/lib/volcal")
    return IniFile(ini.path, ini.content()).without_marked_lines()


def _eds_file() -> bytes:
    """Return the EDS file of a drive with all objects that the driver needs, and one that depends on the node."""
    listed = "\n".join(f"{number}=0x{index:04X}" for number, index in enumerate(OBJECT_TYPES, start=1))
    objects = "\n".join(
        f"[{index:04X}]\nParameterName=o{index:X}\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType=rw\nPDOMapping=0"
        for index, kind in OBJECT_TYPES.items()
    )
    text = f"""[FileInfo]
FileName=drive.eds
[DeviceInfo]
VendorNumber=0x1
ProductNumber=0x402
[OptionalObjects]
SupportedObjects={len(OBJECT_TYPES)}
{listed}
{objects}
DefaultValue=$NODEID+0x180
"""
    return text.encode()


def _reading_eds() -> Callable[[bytes], object]:
    folder = MemoryFolder()
    axis = {"node_id": 5, "encoder_counts_per_revolution": 4096, "lower_deg": -90.0, "upper_deg": 90.0}
    speed = {"speed_deg_per_s": 10.0, "acceleration_deg_per_s2": 10.0}
    settings = AxisSettings.model_validate({**axis, **speed, "eds": "drive.eds"})
    return lambda data: folder.reading({"drive.eds": data}, lambda path: load_description(settings, path))


def _gcode(data: bytes) -> object:
    return BlockParser(WorkOffsets()).read(data.decode("ascii"), (0.0, 0.0, 0.0))
