"""Server for service data objects (SDO) according to CiA 301 section 7.2.4.

The server supports expedited transfers in both directions and segmented upload. A segmented download is refused because
of its length, since no writable object of a drive is longer than four bytes. A block transfer is refused as an unknown
command.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

ABORT_TOGGLE = 0x05030000
ABORT_COMMAND = 0x05040001
ABORT_WRITE_ONLY = 0x06010001
ABORT_READ_ONLY = 0x06010002
ABORT_NO_OBJECT = 0x06020000
ABORT_LENGTH = 0x06070010
ABORT_NO_SUBINDEX = 0x06090011
ABORT_VALUE = 0x06090030
ABORT_LOCAL_STATE = 0x08000022


class SdoAbortError(Exception):
    """Error with which the function that reads or writes an entry of the object dictionary aborts a transfer. The abort
    code `code` is sent to the client.
    """

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort 0x{code:08X}")
        self.code = code


@dataclass(frozen=True)
class ObjectEntry:
    """One entry of the object dictionary of a CANopen node.

    `code` is the `struct` letter of the entry's little-endian type, and is empty for a visible string.
    """

    code: str
    read: Callable[[], int | str] | None = None
    write: Callable[[int], None] | None = None

    def upload(self) -> bytes:
        if self.read is None:
            raise SdoAbortError(ABORT_WRITE_ONLY)
        value = self.read()
        return value.encode("ascii") if isinstance(value, str) else struct.pack("<" + self.code, value)

    def download(self, data: bytes) -> None:
        if self.write is None:
            raise SdoAbortError(ABORT_READ_ONLY)
        if len(data) != struct.calcsize("<" + self.code):
            raise SdoAbortError(ABORT_LENGTH)
        self.write(struct.unpack("<" + self.code, data)[0])


ObjectDictionary = Mapping[tuple[int, int], ObjectEntry]


class SdoServer:
    """Server for service data objects (SDO), for one client on one channel."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._indexes = {index for index, _ in dictionary}
        self._object = (0, 0)
        self._rest = b""
        self._toggle = 0

    def answer(self, request: bytes) -> bytes | None:
        """Return the 8-byte answer to an 8-byte request.

        Returns None if the client aborts or if the frame does not have 8 bytes.
        """
        if len(request) != 8:
            return None
        command = request[0]
        specifier = command >> 5
        if specifier == 4:
            self._rest = b""
            return None
        try:
            if specifier == 3:
                return self._upload_segment(command)
            index, subindex = struct.unpack_from("<HB", request, 1)
            self._object = (index, subindex)
            if specifier == 2:
                return self._initiate_upload()
            if specifier == 1:
                return self._initiate_download(command, request[4:])
            raise SdoAbortError(ABORT_COMMAND)
        except SdoAbortError as abort:
            self._rest = b""
            return struct.pack("<BHBI", 0x80, *self._object, abort.code)

    def _entry(self) -> ObjectEntry:
        entry = self._dictionary.get(self._object)
        if entry is None:
            raise SdoAbortError(ABORT_NO_SUBINDEX if self._object[0] in self._indexes else ABORT_NO_OBJECT)
        return entry

    def _initiate_upload(self) -> bytes:
        data = self._entry().upload()
        if len(data) <= 4:
            command = 0x43 | (4 - len(data)) << 2
            return struct.pack("<BHB4s", command, *self._object, data)
        self._rest, self._toggle = data, 0
        return struct.pack("<BHBI", 0x41, *self._object, len(data))

    def _upload_segment(self, command: int) -> bytes:
        if not self._rest:
            raise SdoAbortError(ABORT_COMMAND)
        if (command >> 4) & 1 != self._toggle:
            raise SdoAbortError(ABORT_TOGGLE)
        segment, self._rest = self._rest[:7], self._rest[7:]
        answer = self._toggle << 4 | (7 - len(segment)) << 1 | (not self._rest)
        self._toggle ^= 1
        return struct.pack("<B7s", answer, segment)

    def _initiate_download(self, command: int, data: bytes) -> bytes:
        entry = self._entry()
        if not command & 0x02:
            raise SdoAbortError(ABORT_LENGTH)
        length = 4 - (command >> 2 & 3) if command & 0x01 else 4
        entry.download(data[:length])
        return struct.pack("<BHBI", 0x60, *self._object, 0)
