"""Tape transfer in both directions over a punch/read line.

The direction of a transfer is named from the side of the controller, and DC1 to DC4 are device control characters.
*Punch*: the controller sends DC2, then the tape, then DC4. *Read*: the controller sends DC1 when the operator presses
READ, and then reads the tape. It sends DC3 to stop the sender when its memory is full, and DC1 to restart the sender.
It sends DC3 at the end. The operator starts both transfers at the controller; this module cannot start them.

The characters of a tape have a seven-bit ISO code with even parity in the eighth bit. With its parity bit, DC3 is 0x93,
but the XON/XOFF handshake of a serial driver recognises DC3 only as 0x13. This module therefore handles flow control
itself.

Source: FANUC B-63503EN/02 (Series 0i connection manual, hardware), 5.3 "RS-232-C interface": one parity bit among
eight, the meaning of DC1 to DC4, a sender that stops within ten characters after DC3, two stop bits. ISO 646 for the
characters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal, NoReturn

from pydantic import Field

from drivers.clock import Clock, Deadline
from drivers.errors import DeadlineExpired, LinkTimeout, ProtocolError, ReadBackMismatch
from drivers.links.serial_port import SerialAddress, SerialPort
from drivers.options import DriverOptions
from drivers.serial_cnc.tape.blocks import MARK, Tape, TapeError, differences, parse_tape

CHARACTERS_PER_WRITE = 8
"""Number of characters sent between two checks for DC3, which must stop the sender within ten characters."""
# Start bit, eight bits including parity, two stop bits.
BITS_OF_CHARACTER = 11
POLL_S = 0.02
MAX_SHOWN_DIFFERENCES = 5
Announce = Callable[[str], None]
Seconds = Annotated[float, Field(gt=0.0, le=3600.0)]


class PunchRead:
    """Tape transfer over a serial line that is open inside the `with` block.

    The function `announce` shows a text that asks the operator to press a key. Methods raise LinkLost, LinkTimeout or
    ProtocolError, and DeadlineExpired if the operator did not press the key in time.
    """

    def __init__(self, settings: TapeSettings, clock: Clock, announce: Announce, *, device: str = "") -> None:
        address = SerialAddress(settings.port, settings.baud, stop_bits=settings.stop_bits)
        self._port = SerialPort(address, device=device)
        self._settings = settings
        self._clock = clock
        self._announce = announce
        self.where = self._port.where

    def __enter__(self) -> PunchRead:
        self._port.open()
        return self

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def receive(self) -> Tape:
        """Receive the tape that the controller punches, without flow control."""
        self._announce("press PUNCH at the controller")
        characters = self._from_first_mark()
        text = MARK
        while text.count(MARK) < 2:
            text += self._next_text(characters, text)
            if len(text) > self._settings.max_tape_length:
                self._refuse(f"no second {MARK} within {self._settings.max_tape_length} characters")
        try:
            return parse_tape(text)
        except TapeError as error:
            self._refuse(str(error))

    def send(self, tape: Tape) -> None:
        """Ask the operator to press READ, then send a tape.

        If an error ends the transfer, the controller has received part of the tape. A note on the error states how much
        was sent.
        """
        data = encode(tape.text())
        self._announce("press READ at the controller")
        self._await_start()
        sent = 0
        try:
            while sent < len(data):
                self._obey_flow_control(sent)
                chunk = data[sent : sent + CHARACTERS_PER_WRITE]
                self._port.write(chunk)
                sent += len(chunk)
                # The bytes leave an output buffer at the baud rate. Without this wait, a DC3 would come after far more
                # than ten characters had been handed to the buffer.
                self._clock.sleep(len(chunk) * BITS_OF_CHARACTER / self._settings.baud)
            self._obey_flow_control(sent, ended=True)
        except Exception as error:
            blocks = data[:sent].count(encode("\n"))
            error.add_note(
                f"the controller has read {blocks} of {len(tape.blocks) + 2} blocks; read its backup back in"
            )
            raise

    def write(self, tape: Tape) -> None:
        """Send a tape, receive it back and compare both tapes.

        Raises ReadBackMismatch if parameters differ. The error names these parameters.
        """
        self.send(tape)
        self.compare(tape, self.receive())

    def compare(self, wanted: Tape, found: Tape) -> None:
        try:
            different = differences(wanted, found)
        except TapeError as error:
            self._refuse(str(error))
        if not different:
            return
        shown = "; ".join(map(str, different[:MAX_SHOWN_DIFFERENCES]))
        more = f" and {len(different) - MAX_SHOWN_DIFFERENCES} more" if len(different) > MAX_SHOWN_DIFFERENCES else ""
        raise ReadBackMismatch(
            f"{len(different)} values read back differently from what was written: {shown}{more}",
            hint="check that parameter writing is enabled (PWE); restore the backup before using the machine",
            **self.where,
        )

    # ------------------------------------------------------------------ punch: the controller sends

    def _from_first_mark(self) -> list[Character]:
        """Discard the leader up to the first mark, and return the characters received after the mark."""
        deadline = Deadline.after(self._clock, self._settings.operator_timeout_s)
        while True:
            characters = self._received()
            for place, character in enumerate(characters):
                if character == MARK:
                    return characters[place + 1 :]
            self._require_pressed(deadline, "PUNCH")

    def _next_text(self, held: list[Character], text: str) -> str:
        """Return the text in `held` and clear it; if `held` is empty, wait for characters first.

        `text` is the text received before; errors use it to name the block.
        """
        deadline = Deadline.after(self._clock, self._settings.character_timeout_s)
        while not held:
            held.extend(self._received())
            if not held and deadline.expired:
                raise LinkTimeout(
                    f"the punched tape breaks off after {text.count(chr(10))} blocks: silent for "
                    f"{self._settings.character_timeout_s:g} s",
                    hint="check whether RESET was pressed or the cable unplugged, then punch again",
                    **self.where,
                )
            if not held:
                self._clock.sleep(POLL_S)
        new = ""
        for character in held:
            if isinstance(character, ParityFault):
                self._refuse(
                    f"parity fault in block {text.count(chr(10)) + new.count(chr(10))}: 0x{character.byte:02X}"
                )
            if character is DeviceControl.PUNCH_OFF and (text + new).count(MARK) < 2:
                self._refuse(f"the controller has ended its tape (DC4) without a second {MARK}")
            if isinstance(character, str):
                new += character
        held.clear()
        return new

    # ------------------------------------------------------------------ read: the controller receives

    def _await_start(self) -> None:
        deadline = Deadline.after(self._clock, self._settings.operator_timeout_s)
        while DeviceControl.READER_START not in self._received():
            self._require_pressed(deadline, "READ")

    def _obey_flow_control(self, sent: int, *, ended: bool = False) -> None:
        """If the controller has sent DC3, wait for DC1; do not wait after the end of the tape.

        Raises LinkTimeout if DC1 does not come within `max_pause_s`.
        """
        stopped = self._last_flow_control(self._received()) is DeviceControl.READER_STOP
        deadline = Deadline.after(self._clock, self._settings.max_pause_s)
        while stopped and not ended:
            if deadline.expired:
                raise LinkTimeout(
                    f"the controller has stopped the transfer (DC3) after {sent} characters and not resumed it "
                    f"within {self._settings.max_pause_s:g} s",
                    hint="check its alarm: memory full, write protection, unknown format",
                    **self.where,
                )
            self._clock.sleep(POLL_S)
            stopped = self._last_flow_control(self._received()) is not DeviceControl.READER_START

    def _last_flow_control(self, characters: list[Character]) -> DeviceControl | None:
        """Return the last reader start or reader stop among `characters`; None if there is neither."""
        words = [c for c in characters if c in (DeviceControl.READER_START, DeviceControl.READER_STOP)]
        for character in characters:
            if isinstance(character, ParityFault):
                self._refuse(f"parity fault in a control character: 0x{character.byte:02X}")
        last = words[-1] if words else None
        return last if isinstance(last, DeviceControl) else None

    # ------------------------------------------------------------------ both

    def _received(self) -> list[Character]:
        return decode(self._port.read(0.0))

    def _require_pressed(self, deadline: Deadline, key: str) -> None:
        if deadline.expired:
            raise DeadlineExpired(
                f"{key} was not pressed within {self._settings.operator_timeout_s:g} s",
                hint="press it, or check the wiring and settings: baud, stop bits, ISO code, device number",
                **self.where,
            )
        self._clock.sleep(POLL_S)

    def _refuse(self, text: str) -> NoReturn:
        self._port.write(encode_control(DeviceControl.READER_STOP))
        raise ProtocolError(
            text, hint="check baud, stop bits and cable; the controller must be set to ISO code", **self.where
        )


class TapeSettings(DriverOptions):
    """Settings of the serial line for tapes.

    The defaults are those of the FANUC manuals: 4800 baud, eight bits including parity, two stop bits.
    """

    port: str = Field(min_length=1)
    baud: int = Field(default=4800, ge=50, le=115200)
    stop_bits: Literal[1, 2] = 2
    operator_timeout_s: Seconds = Field(default=300.0, description="until READ or PUNCH is pressed at the controller")
    max_pause_s: Seconds = Field(default=60.0, description="longest pause that the controller may request by DC3")
    character_timeout_s: Seconds = Field(default=10.0, description="longest gap between two characters of a tape")
    max_tape_length: int = Field(default=1_000_000, ge=100, description="characters")


IGNORED = frozenset({0x00, 0x0D, 0x7F, 0x20})
"""Characters without meaning on a tape: blank tape, carriage return, deleted (punched-out) character, space."""


class DeviceControl(IntEnum):
    """Codes of the device controls DC1 to DC4, without the parity bit."""

    READER_START = 0x11
    PUNCH_ON = 0x12
    READER_STOP = 0x13
    PUNCH_OFF = 0x14


_CONTROLS = {control.value: control for control in DeviceControl}


@dataclass(frozen=True)
class ParityFault:
    """Received byte with a parity error: the number of its set bits is odd."""

    byte: int


Character = str | DeviceControl | ParityFault


def with_even_parity(byte: int) -> int:
    """Return the seven-bit code `byte` with even parity in bit 7."""
    # Bit 7 is set if the seven bits contain an odd number of ones.
    return byte | (byte.bit_count() & 1) << 7


def encode(text: str) -> bytes:
    """Encode ASCII text as tape characters. Raises UnicodeEncodeError for other text."""
    return bytes(with_even_parity(byte) for byte in text.encode("ascii"))


def encode_control(control: DeviceControl) -> bytes:
    return bytes((with_even_parity(control),))


def decode(data: bytes) -> list[Character]:
    """Decode tape bytes into characters, device controls and parity faults, one for each byte.

    Bytes without meaning on a tape, such as blank tape and spaces, are omitted.
    """
    characters: list[Character] = []
    for byte in data:
        seven = byte & 0x7F
        if with_even_parity(seven) != byte:
            characters.append(ParityFault(byte))
        elif seven in _CONTROLS:
            characters.append(_CONTROLS[seven])
        elif seven not in IGNORED:
            characters.append(chr(seven))
    return characters
