"""Link to the bridge process between volcal and LinuxCNC.

If the machine must be stopped and the bridge process does not answer, a new bridge process is started for the stop.
"""

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
from drivers.foreign_errors import cause_of
from drivers.linuxcnc.pins import PinValue

BRIDGE = Path(__file__).resolve().parent / "bridge"
PROTOCOL = 1
LOOKS = frozenset({"hello", "ini", "status", "hal_get"})
"""Requests that only read."""
END_WITHIN_S = 2.0
STDERR_TAIL_BYTES = 400
STOPPED_HINT = "press the emergency stop, look where the axes stand, and restart LinuxCNC"
START_HINT = "check that linuxcnc-uspace is installed, and that LinuxCNC runs under the same user with the same HOME"

Answer = dict[str, Any]


class _Bridge(NamedTuple):
    """Bridge process. If it ends unexpectedly, the last line of its standard error is reported."""

    process: subprocess.Popen[bytes]
    stderr: IO[bytes]


class BridgeLink:
    """Link to the bridge process between volcal and LinuxCNC; it implements the interface `Pins` to HAL.

    Any thread may use the link; requests are sent one at a time. Waits use the wall clock.
    """

    def __init__(
        self,
        command: Sequence[str],
        *,
        response_timeout_s: float,
        watchdog_timeout_s: float,
        heartbeat_timeout_s: float,
        device: str,
    ) -> None:
        self._command = [*command, str(BRIDGE)]
        self._look_only = False
        self.response_timeout_s = response_timeout_s
        self._hello = {"watch_s": watchdog_timeout_s, "heartbeat_s": heartbeat_timeout_s}
        self.where = {"device": device, "link": "linuxcnc bridge"}
        self._bridge: _Bridge | None = None
        self._buffered = b""
        self._unresponsive = False
        self._number = 0
        self._lock = threading.RLock()
        self.hello: Answer = {}

    @property
    def connected(self) -> bool:
        """True if a bridge process is running."""
        return self._bridge is not None and self._bridge.process.poll() is None

    @property
    def pid(self) -> int | None:
        return None if self._bridge is None else self._bridge.process.pid

    def open(self, *, look_only: bool = False) -> None:
        """Start the bridge process between volcal and LinuxCNC.

        If `look_only` is True, the bridge has no means to send commands to LinuxCNC, and all requests but queries are
        refused until the link is closed.

        Raises LinkLost if the bridge cannot be started or if LinuxCNC does not run, and ProtocolError if the version of
        the bridge's protocol is not the expected one.
        """
        with self._lock:
            self.close()
            self._look_only = look_only
            self._bridge = self._start_process()
            try:
                self._answer(0)
                self.hello = self.ask("hello", **self._hello)
            except BaseException:
                self.close()
                raise
            if self.hello.get("protocol") != PROTOCOL:
                protocol = self.hello.get("protocol")
                self.close()
                raise ProtocolError(f"the bridge speaks protocol {protocol}, not {PROTOCOL}", **self.where)

    def close(self) -> None:
        """End the bridge process; repeated calls have no further effect.

        A bridge that ends stops the motion that it has started, unless it no longer responds and has to be killed.
        """
        with self._lock:
            self._look_only = False
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
                _ended(process)  # bounded: an abort by a new bridge must not wait for this one

    def ask(self, what: str, **fields: object) -> Answer:
        """Send a request to the bridge and return the answer.

        Raises LinkLost or LinkTimeout if no answer comes or if a process of LinuxCNC has stopped, and CommandRejected
        if LinuxCNC refuses the request.
        """
        with self._lock:
            if self._look_only and what not in LOOKS:
                raise CommandRejected(
                    f"refused by a link that was opened only to read: {what}",
                    hint="close the device and open it for a run",
                    **self.where,
                )
            self._number += 1
            self._send({"id": self._number, "do": what, **fields})
            answer = self._answer(self._number)
        if "ok" not in answer:
            raise self._refusal(answer)
        reply = answer["ok"]
        if not isinstance(reply, dict):
            raise ProtocolError(f"no answer to {what!r} from the bridge: {str(reply)[:80]}", **self.where)
        return reply

    def abort(self) -> None:
        """Stop any motion of the machine.

        If the bridge process has ended or does not answer, a new bridge process is started to stop the motion.
        """
        with self._lock:
            if not self._unresponsive and self.connected:
                try:
                    self.ask("abort")
                except (LinkLost, LinkTimeout):
                    if self.connected and not self._unresponsive:
                        raise  # LinuxCNC itself has stopped; another bridge would say the same
                else:
                    return
            self.open()
            self.ask("abort")

    # ------------------------------------------------------------------ pins

    def get(self, name: str) -> PinValue:
        return self.get_all([name])[0]

    def get_all(self, names: Sequence[str]) -> list[PinValue]:
        """Return the values of several HAL pins by a single request to the bridge."""
        values = self.ask("hal_get", names=list(names)).get("values")
        if not isinstance(values, list) or len(values) != len(names):
            raise ProtocolError("the bridge did not return the value of every pin", **self.where)
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
                [*self._command, "look"] if self._look_only else self._command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                # Ctrl-C must reach only the agent, which stops the machine first. A process group, not a session: the
                # scheduler treats a session as one unit (autogroup), and a session with few requests was seen to
                # starve for seconds beside busy ones.
                process_group=0,
            )
        except OSError as error:
            stderr.close()
            raise LinkLost(f"the bridge cannot be started: {cause_of(error)}", hint=START_HINT, **self.where) from error
        return _Bridge(process, stderr)

    def _send(self, request: Answer) -> None:
        bridge = self._bridge
        if bridge is None or bridge.process.stdin is None:
            raise LinkLost("the device is not open", hint="open it first", **self.where)
        try:
            bridge.process.stdin.write(json.dumps(request).encode() + b"\n")
            bridge.process.stdin.flush()
        except OSError as error:
            raise self._ended() from error

    def _answer(self, number: int) -> Answer:
        """Return the answer to request `number`; late answers to earlier requests are discarded."""
        ends_s = wall_seconds() + self.response_timeout_s
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
                    raise LinkTimeout(
                        f"no answer within {self.response_timeout_s:g} s", hint="check LinuxCNC", **self.where
                    )
                chunk = os.read(bridge.process.stdout.fileno(), 65536)
                if not chunk:
                    raise self._ended()
                self._buffered += chunk
        line, _, self._buffered = self._buffered.partition(b"\n")
        return line

    def _parse(self, line: bytes) -> Answer:
        try:
            answer = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ProtocolError(f"not JSON from the bridge: {line[:80]!r}", **self.where) from error
        if not isinstance(answer, dict):
            raise ProtocolError(f"no object from the bridge: {line[:80]!r}", **self.where)
        return answer

    def _refusal(self, answer: Answer) -> DeviceError:
        text = str(answer.get("text", "no reason given"))
        if answer.get("error") == "stopped":
            return LinkLost(text, hint=STOPPED_HINT, **self.where)
        if answer.get("error") == "gone":
            return LinkLost(text, hint=START_HINT, **self.where)
        return CommandRejected(text, **self.where)

    def _ended(self) -> LinkLost:
        """Return the error for an ended bridge, with its exit code and its last line on standard error."""
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
    """Wait briefly for the process to exit; return True if it has."""
    try:
        process.wait(END_WITHIN_S)
    except subprocess.TimeoutExpired:
        return False
    return True


def _close(stream: IO[bytes]) -> None:
    try:
        stream.close()
    except BrokenPipeError:
        return  # undelivered data no longer matters
