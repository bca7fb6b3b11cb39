"""The bridge process: started, asked, and started again when only that can stop the machine."""

from __future__ import annotations

import json
import os
import selectors
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

from drivers.clock import wall_seconds
from drivers.errors import CommandRejected, DeviceError, LinkLost, LinkTimeout, ProtocolError
from drivers.linuxcnc.pins import PinValue

BRIDGE = Path(__file__).resolve().parent / "bridge"
PROTOCOL = 1
END_WITHIN_S = 2.0
STDERR_TAIL_BYTES = 400
START_HINT = "is LinuxCNC running, under the same user and with the same HOME? Is linuxcnc-uspace installed?"

Answer = dict[str, Any]


class _Bridge(NamedTuple):
    """A process and what it says on standard error, kept for the message of its end."""

    process: subprocess.Popen[bytes]
    stderr: IO[bytes]


class BridgeLink:
    """Asks one thing at a time, from any thread; plays `drivers.linuxcnc.pins.Pins`. Waits are by the wall clock."""

    def __init__(self, command: Sequence[str], *, answer_within_s: float, watch_s: float, device: str) -> None:
        self._command = [*command, str(BRIDGE)]
        self._within_s = answer_within_s
        self._watch_s = watch_s
        self.where = {"device": device, "link": "linuxcnc bridge"}
        self._bridge: _Bridge | None = None
        self._buffered = b""
        self._unresponsive = False
        self._number = 0
        self._lock = threading.RLock()
        self.hello: Answer = {}

    @property
    def connected(self) -> bool:
        """Whether there is a bridge that has not ended."""
        return self._bridge is not None and self._bridge.process.poll() is None

    @property
    def pid(self) -> int | None:
        return None if self._bridge is None else self._bridge.process.pid

    def open(self) -> None:
        """Start the bridge. LinkLost where it or LinuxCNC is not there."""
        with self._lock:
            self.close()
            self._bridge = self._start_process()
            try:
                self._answer(0)
                self.hello = self.ask("hello", watch_s=self._watch_s)
            except BaseException:
                self.close()
                raise
            if self.hello.get("protocol") != PROTOCOL:
                spoken = self.hello.get("protocol")
                self.close()
                raise ProtocolError(f"the bridge speaks protocol {spoken}, not {PROTOCOL}", **self.where)

    def close(self) -> None:
        """End the bridge, which stops a motion that it began; idempotent."""
        with self._lock:
            if self._bridge is None:
                return
            process, stderr = self._bridge
            if self._unresponsive:
                process.kill()
            self._bridge, self._buffered, self._unresponsive = None, b"", False
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    _close(stream)
            stderr.close()
            if not _ended(process):
                process.kill()
                _ended(process)  # who wants to abort by another bridge does not wait for this one for ever

    def ask(self, what: str, **fields: object) -> Answer:
        """What the bridge answers. CommandRejected where LinuxCNC refuses, LinkLost, LinkTimeout."""
        with self._lock:
            self._number += 1
            self._send({"id": self._number, "do": what, **fields})
            answer = self._answer(self._number)
        if "ok" in answer:
            reply: Answer = answer["ok"]
            return reply
        raise self._refusal(answer)

    def abort(self) -> None:
        """Stop whatever moves, by a new bridge where the old one has gone or does not answer."""
        with self._lock:
            if self._unresponsive or not self.connected:
                self.open()
            self.ask("abort")

    # ------------------------------------------------------------------ pins

    def get(self, name: str) -> PinValue:
        return self.get_all([name])[0]

    def get_all(self, names: Sequence[str]) -> list[PinValue]:
        """In one round trip."""
        values: list[PinValue] = self.ask("hal_get", names=list(names))["values"]
        return values

    def set(self, name: str, value: PinValue) -> None:
        try:
            self.ask("hal_set", name=name, value=value)
        except CommandRejected as error:
            raise error.at(pin=name) from None

    # ------------------------------------------------------------------ bytes

    def _start_process(self) -> _Bridge:
        stderr = tempfile.TemporaryFile()  # noqa: SIM115  closed with the link
        try:
            process = subprocess.Popen(  # noqa: S603  the command is the user's own setting
                self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                # Ctrl-C is for the agent, which stops the machine first. A group and no session: those are scheduled
                # as one (autogroup), and beside busy ones a session of few requests was seen to starve for seconds.
                process_group=0,
            )
        except OSError as error:
            stderr.close()
            raise LinkLost(
                f"the bridge cannot be started: {error.strerror or error}", hint=START_HINT, **self.where
            ) from error
        return _Bridge(process, stderr)

    def _send(self, request: Answer) -> None:
        bridge = self._bridge
        if bridge is None or bridge.process.stdin is None:
            raise LinkLost("device is not open", hint="open it first", **self.where)
        try:
            bridge.process.stdin.write(json.dumps(request).encode() + b"\n")
            bridge.process.stdin.flush()
        except OSError as error:
            raise self._ended() from error

    def _answer(self, number: int) -> Answer:
        """The answer of that number; later ones of requests that were given up are dropped."""
        ends_s = wall_seconds() + self._within_s
        while True:
            answer = self._parse(self._line(ends_s))
            self._unresponsive = False
            if answer.get("id") == number:
                if number == 0 and "error" in answer:
                    raise self._refusal(answer)
                return answer

    def _line(self, ends_s: float) -> bytes:
        bridge = self._bridge
        assert bridge is not None and bridge.process.stdout is not None  # noqa: S101  sent to just now
        with selectors.DefaultSelector() as readable:
            readable.register(bridge.process.stdout, selectors.EVENT_READ)
            while b"\n" not in self._buffered:
                left_s = ends_s - wall_seconds()
                if left_s <= 0.0 or not readable.select(left_s):
                    self._unresponsive = True
                    raise LinkTimeout(f"no answer within {self._within_s:g} s", hint="see LinuxCNC", **self.where)
                chunk = os.read(bridge.process.stdout.fileno(), 65536)
                if not chunk:
                    raise self._ended()
                self._buffered += chunk
        line, _, self._buffered = self._buffered.partition(b"\n")
        return line

    def _parse(self, line: bytes) -> Answer:
        try:
            answer = json.loads(line)
        except ValueError as error:
            raise ProtocolError(f"not JSON from the bridge: {line[:80]!r}", **self.where) from error
        if not isinstance(answer, dict):
            raise ProtocolError(f"no object from the bridge: {line[:80]!r}", **self.where)
        return answer

    def _refusal(self, answer: Answer) -> DeviceError:
        text = str(answer.get("text", "no reason given"))
        if answer.get("error") == "gone":
            return LinkLost(text, hint=START_HINT, **self.where)
        return CommandRejected(text, **self.where)

    def _ended(self) -> LinkLost:
        """The bridge has gone: its exit code and the last that it said."""
        assert self._bridge is not None  # noqa: S101  it was asked
        process, stderr = self._bridge
        try:
            ended = f"ended with {process.wait(END_WITHIN_S)}"
        except subprocess.TimeoutExpired:
            ended = "closed its pipe"
        stderr.seek(0, 2)
        stderr.seek(max(0, stderr.tell() - STDERR_TAIL_BYTES))
        messages = stderr.read().decode(errors="replace").strip().splitlines()
        return LinkLost(f"the bridge {ended}{': ' + messages[-1] if messages else ''}", hint=START_HINT, **self.where)


def _ended(process: subprocess.Popen[bytes]) -> bool:
    """Whether it has gone, or went within a moment."""
    try:
        process.wait(END_WITHIN_S)
    except subprocess.TimeoutExpired:
        return False
    return True


def _close(stream: IO[bytes]) -> None:
    try:
        stream.close()
    except BrokenPipeError:
        return  # what could not be delivered is no matter any more
