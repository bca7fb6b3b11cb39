"""Both directions of a punch/read line.

*Punch*: the controller sends DC2, the tape, DC4. *Read*: it sends DC1 when READ is pressed, takes the tape, stops and
starts the sender by DC3 and DC1 as its memory fills, and sends DC3 at the end. Who starts is the operator, at the
controller: nothing here can make it punch or read.

Source: FANUC B-63503EN/02, 5.3: meaning of DC1 to DC4; DC3 stops a sender within ten characters.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn

from drivers.clock import Clock, Deadline
from drivers.errors import DeadlineExpired, LinkTimeout, ProtocolError, ReadBackMismatch
from drivers.links.serial_port import SerialAddress, SerialPort
from drivers.serial_cnc.tape.blocks import MARK, Tape, TapeError, differences, parse_tape
from drivers.serial_cnc.tape.characters import Character, DeviceControl, ParityFault, decode, encode, encode_control
from drivers.serial_cnc.tape.settings import TapeSettings

AT_ONCE = 8
"""Characters between two looks for a DC3: it must stop us within ten."""
BITS_OF_CHARACTER = 11
POLL_S = 0.02
SHOWN_DIFFERENCES = 5

Announce = Callable[[str], None]


class PunchRead:
    """A context that holds the line. `announce` tells a person what to press.

    Raises LinkLost, LinkTimeout, ProtocolError; DeadlineExpired where nobody pressed anything.
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
        """What the controller punches. Slowed down by nobody: it is taken as fast as it comes."""
        self._announce("press PUNCH at the controller")
        characters = self._from_first_mark()
        text = MARK
        while text.count(MARK) < 2:
            text += self._next_text(characters, text)
            if len(text) > self._settings.longest_tape:
                self._refuse(f"no second {MARK} within {self._settings.longest_tape} characters")
        try:
            return parse_tape(text)
        except TapeError as error:
            self._refuse(str(error))

    def send(self, tape: Tape) -> None:
        """Send once READ is pressed. An error leaves a part of the tape in the controller, and says how much."""
        data = encode(tape.text())
        self._announce("press READ at the controller")
        self._await_start()
        sent = 0
        try:
            while sent < len(data):
                self._obey_flow_control(sent)
                chunk = data[sent : sent + AT_ONCE]
                self._port.write(chunk)
                sent += len(chunk)
                self._clock.sleep(len(chunk) * BITS_OF_CHARACTER / self._settings.baud)
            self._obey_flow_control(sent, ended=True)
        except Exception as error:
            blocks = data[:sent].count(encode("\n"))
            error.add_note(
                f"the controller has read {blocks} of {len(tape.blocks) + 2} blocks; read its backup back in"
            )
            raise

    def write(self, tape: Tape) -> None:
        """Send, have it punched back, compare. Raises ReadBackMismatch naming the parameters that differ."""
        self.send(tape)
        self.compare(tape, self.receive())

    def compare(self, wanted: Tape, found: Tape) -> None:
        try:
            different = differences(wanted, found)
        except TapeError as error:
            self._refuse(str(error))
        if not different:
            return
        shown = "; ".join(map(str, different[:SHOWN_DIFFERENCES]))
        more = f" and {len(different) - SHOWN_DIFFERENCES} more" if len(different) > SHOWN_DIFFERENCES else ""
        raise ReadBackMismatch(
            f"{len(different)} values read back differently from what was written: {shown}{more}",
            hint="is writing of parameters enabled (PWE)? read the backup back in before the machine is used",
            **self.where,
        )

    # ------------------------------------------------------------------ the controller sends

    def _from_first_mark(self) -> list[Character]:
        """Everything up to the first mark is leader; the characters that came right behind it."""
        deadline = Deadline.after(self._clock, self._settings.operator_within_s)
        while True:
            characters = self._received()
            for place, character in enumerate(characters):
                if character == MARK:
                    return characters[place + 1 :]
            self._require_pressed(deadline, "PUNCH")

    def _next_text(self, held: list[Character], text: str) -> str:
        """The text that has come, of `held` first; waits for some."""
        deadline = Deadline.after(self._clock, self._settings.silent_within_s)
        while not held:
            held.extend(self._received())
            if not held and deadline.expired:
                raise LinkTimeout(
                    f"the punched tape breaks off after {text.count(chr(10))} blocks: silent for "
                    f"{self._settings.silent_within_s:g} s",
                    hint="was RESET pressed, or the cable drawn? punch again",
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

    # ------------------------------------------------------------------ the controller takes

    def _await_start(self) -> None:
        deadline = Deadline.after(self._clock, self._settings.operator_within_s)
        while DeviceControl.READER_START not in self._received():
            self._require_pressed(deadline, "READ")

    def _obey_flow_control(self, sent: int, *, ended: bool = False) -> None:
        """Go on unless the controller has stopped us; then wait until it lets us go on. At the end it need not."""
        stopped = self._last_flow_control(self._received()) is DeviceControl.READER_STOP
        deadline = Deadline.after(self._clock, self._settings.stopped_within_s)
        while stopped and not ended:
            if deadline.expired:
                raise LinkTimeout(
                    f"the controller has stopped the transfer (DC3) after {sent} characters and not let it go on "
                    f"within {self._settings.stopped_within_s:g} s",
                    hint="look at its alarm: memory full, write protection, a format it does not know",
                    **self.where,
                )
            self._clock.sleep(POLL_S)
            stopped = self._last_flow_control(self._received()) is not DeviceControl.READER_START

    def _last_flow_control(self, characters: list[Character]) -> DeviceControl | None:
        """The last of reader start and reader stop; None where neither has come."""
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
                f"{key} was not pressed within {self._settings.operator_within_s:g} s",
                hint="or the line is wired or set differently: baud, stop bits, ISO code, device number",
                **self.where,
            )
        self._clock.sleep(POLL_S)

    def _refuse(self, text: str) -> NoReturn:
        self._port.write(encode_control(DeviceControl.READER_STOP))
        raise ProtocolError(
            text, hint="check baud, stop bits and cable; the controller must be set to ISO code", **self.where
        )
