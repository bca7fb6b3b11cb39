"""Bridge to LinuxCNC for a program that runs under another Python interpreter.

The bridge is run by the Python interpreter of the Linux distribution (`/usr/bin/python3 drivers/linuxcnc/bridge`),
because the modules `linuxcnc` and `hal` are built for that interpreter. The bridge imports nothing from volcal.

Each line on standard input is a request, and each line on standard output is an answer; both are JSON objects. Every
request is answered within a few cycles of LinuxCNC's task process; no request waits for the end of a motion. The bridge
stops a motion that it has started if standard input ends, or if no request comes for `watch_s` seconds (set by the
request "hello") during the motion.

    {"id": 7, "do": "status"}  ->  {"id": 7, "ok": {...}}  or  {"id": 7, "error": "refused", "text": "..."}

With the argument `look` the bridge only reads: it opens no command channel, so that it can send LinuxCNC nothing, and
no error channel, because a message that is read there is missing on the panels that show it.

`error` is `refused` (the request was understood but not carried out), `unknown` (HAL, the hardware abstraction layer,
has no such name), `gone` (LinuxCNC does not answer) or `stopped` (a process of LinuxCNC gives no heartbeat).
"""

from __future__ import annotations

import json
import os
import select
import sys
import time
from collections.abc import Callable
from typing import Any

import hal
import hold
import linuxcnc
from halpins import HalPins, NoSuchPinError
from heartbeat import LIMIT_S, ProcessMonitor, ProcessStoppedError

Fields = Any
"""JSON object."""

PROTOCOL = 1
TASK_STATES = {
    linuxcnc.STATE_ESTOP: "estop",
    linuxcnc.STATE_ESTOP_RESET: "estop_reset",
    linuxcnc.STATE_OFF: "off",
    linuxcnc.STATE_ON: "on",
}
MODES = {linuxcnc.MODE_MANUAL: "manual", linuxcnc.MODE_AUTO: "auto", linuxcnc.MODE_MDI: "mdi"}
STATES = {linuxcnc.RCS_DONE: "done", linuxcnc.RCS_EXEC: "exec", linuxcnc.RCS_ERROR: "error"}
LOOKS = frozenset({"hello", "ini", "status", "hal_get"})
"""Requests that a bridge carries out that only reads."""
ERRORS = (linuxcnc.NML_ERROR, linuxcnc.OPERATOR_ERROR)


class RefusedError(Exception):
    """Raised if LinuxCNC or the bridge process refuses a request because of the present state of LinuxCNC."""


class GoneError(Exception):
    """Error that is raised if LinuxCNC no longer answers."""


class Bridge:
    """Bridge to the running LinuxCNC; it carries out the requests that volcal sends.

    The request "hello", which volcal sends first, sets `watch_s`, the longest time without a request during a motion
    that the bridge has started. After a longer time, the bridge stops the motion. If `watch_s` is 0, the time is not
    monitored.
    """

    def __init__(self, *, look_only: bool = False) -> None:
        self._look_only = look_only
        self._command: Any = None if look_only else linuxcnc.command()  # None: whatever needs it is refused before
        self._stat = linuxcnc.stat()
        self._channel = None if look_only else linuxcnc.error_channel()
        self._component = hal.component(f"volcal-bridge-{os.getpid()}")
        self._component.ready()
        self._pins = HalPins()
        self._monitor = ProcessMonitor(linuxcnc.nmlfile)
        self._watch_s = 0.0
        self._heard_s = time.monotonic()
        self._begun: int | None = None
        self._abandoned = False

    def answer(self, request: Fields) -> Fields:
        """Carry out one request and return the fields of the answer."""
        self._heard_s = time.monotonic()
        actions = {
            "hello": self._hello,
            "ini": self._ini,
            "status": self._status,
            "mdi": self._mdi,
            "mode": self._mode,
            "home": self._home,
            "abort": self._abort,
            "pause": self._pause,
            "resume": self._resume,
            "on": self._on,
            "hal_get": lambda r: {"values": [self._pins.get(name) for name in r["names"]]},
            "hal_set": self._hal_set,
        }
        action = actions.get(request.get("do"))
        if action is None:
            raise RefusedError(f"no such request: {request.get('do')!r}")
        if self._look_only and request["do"] not in LOOKS:
            raise RefusedError(f"not carried out by a bridge that only reads: {request['do']}")
        return action(request)

    def pause_s(self) -> float | None:
        """Return the longest time in s that the main loop may wait for a request before it must call `watch`.

        The method `watch` stops a motion for which no request comes any more. Return None if there is no limit.
        """
        return 0.05 if self._watched() else None

    def watch(self) -> None:
        """Stop the motion that the bridge has started if no request has come for `watch_s` seconds.

        The request "hello" sets `watch_s`. A paused motion is not stopped.
        """
        if self._watched() and time.monotonic() - self._heard_s > self._watch_s:
            self._poll()
            if self._under_way() and not self._stat.paused:
                self._abandoned = True
                self._heard_s = time.monotonic()
                self._stop()
            self._begun = self._begun if self._stat.paused else None
            self._heard_s = time.monotonic()

    def end(self) -> None:
        """Stop a motion that the bridge has started.

        The main loop calls this method when standard input has ended, since no further request can come.
        """
        self._poll()
        if self._begun is not None and self._under_way():
            self._stop()

    def _watched(self) -> bool:
        return self._watch_s > 0.0 and self._begun is not None

    def _under_way(self) -> bool:
        stat = self._stat
        return stat.state == linuxcnc.RCS_EXEC or stat.interp_state != linuxcnc.INTERP_IDLE or not stat.inpos

    def _stop(self) -> None:
        """Stop the motion, whoever commanded it; without the task, which would do it, hold its feed through HAL.

        Raises ProcessStoppedError if LinuxCNC cannot carry out an abort.
        """
        try:
            self._monitor.require_alive(surely=True)
        except ProcessStoppedError as error:
            raise ProcessStoppedError(error.part, f"{error.reason}; {self._stop_without(error.part)}") from None
        self._command.abort()

    def _stop_without(self, part: str) -> str:
        """Stop the motion of a LinuxCNC of which `part` has stopped, and return what was achieved."""
        if part == "motion":
            return "nothing but the emergency stop can stop the axes"
        if part == "task":
            return "its motion is held" if hold.hold() else "its motion cannot be held and runs to the end of the line"
        self._command.abort()
        return "its motion was aborted"

    def _poll(self) -> None:
        try:
            self._stat.poll()
        except (SystemError, linuxcnc.error) as error:
            raise GoneError(f"status of LinuxCNC cannot be read: {error.__cause__ or error}") from error

    # ------------------------------------------------------------------ queries

    def _hello(self, request: Fields) -> Fields:
        self._watch_s = float(request.get("watch_s", 0.0))
        self._monitor.limit_s = float(request.get("heartbeat_s", LIMIT_S))
        self._monitor.require_alive(surely=True)
        self._poll()
        return {
            "protocol": PROTOCOL,
            "version": linuxcnc.version,
            "ini": self._stat.ini_filename,
            "pid": os.getpid(),
            "linear_units": self._stat.linear_units,
            "axis_mask": self._stat.axis_mask,
            "joints": self._stat.joints,
            "limits": [(a["min_position_limit"], a["max_position_limit"]) for a in self._stat.axis[:3]],
            "joint_limits": [
                (joint["min_position_limit"], joint["max_position_limit"])
                for joint in self._stat.joint[: self._stat.joints]
            ],
            "watched": self._monitor.watched,
            "monotonic_s": time.monotonic(),
        }

    def _ini(self, request: Fields) -> Fields:
        """Return values of the INI file as text. A missing key gives null, a repeated key gives its first value."""
        self._poll()
        ini = linuxcnc.ini(self._stat.ini_filename)
        return {"values": [ini.find(section, key) for section, key in request["keys"]]}

    def _status(self, request: Fields) -> Fields:
        self._monitor.require_alive()
        self._poll()
        stat = self._stat
        if self._begun is not None and not self._under_way():
            self._begun = None
        joints = range(stat.joints)
        return {
            "position": stat.position[:3],
            "eoffset": self._pins.values("axis.x.eoffset", "axis.y.eoffset", "axis.z.eoffset"),
            "probed": stat.probed_position[:3],
            "tripped": bool(stat.probe_tripped),
            "probe": bool(stat.probe_val),
            "task_state": TASK_STATES.get(stat.task_state, str(stat.task_state)),
            "mode": MODES.get(stat.task_mode, str(stat.task_mode)),
            "state": STATES.get(stat.state, str(stat.state)),
            "idle": stat.interp_state == linuxcnc.INTERP_IDLE,
            "paused": bool(stat.paused),
            "in_position": bool(stat.inpos),
            "velocity": stat.current_vel,
            "homed": all(stat.homed[n] for n in joints),
            "homing": any(stat.joint[n]["homing"] for n in joints),
            "joint_faults": [n for n in joints if stat.joint[n]["fault"]],
            "on_limit": [n for n in joints if stat.joint[n]["min_hard_limit"] or stat.joint[n]["max_hard_limit"]],
            "spindle": any(s["enabled"] for s in stat.spindle[: stat.spindles]),
            "tool": stat.tool_in_spindle,
            "program_offset": [
                sum(parts)
                for parts in zip(stat.g5x_offset[:3], stat.g92_offset[:3], stat.tool_offset[:3])  # noqa: B905  3.9
            ],
            "rotation_deg": stat.rotation_xy,
            "modal": [code / 10.0 for code in stat.gcodes[1:] if code >= 0],
            "feed_override": stat.feedrate,
            "rapid_override": stat.rapidrate,
            "cycle_s": stat.cycle_time,
            "abandoned": self._abandoned,
            "held_by_volcal": hold.held(),
            "errors": self._take_messages(),
            "pins": self._pins.values(*request.get("pins", ())),
            "monotonic_s": time.monotonic(),
        }

    def _take_messages(self) -> list[str]:
        """Return LinuxCNC's error messages since the last call; none if the bridge only reads."""
        messages: list[str] = []
        if self._channel is None:
            return messages
        for _ in range(100):
            message = self._channel.poll()
            if not message:
                break
            if message[0] in ERRORS:
                messages.append(message[1])
        return messages

    # ------------------------------------------------------------------ commands

    def _hal_set(self, request: Fields) -> Fields:
        self._pins.set(request["name"], request["value"])
        return {}

    def _mdi(self, request: Fields) -> Fields:
        """Send one MDI line and wait until LinuxCNC's task has accepted it."""
        self._monitor.require_alive(surely=True)
        self._poll()
        if self._stat.task_state != linuxcnc.STATE_ON:
            raise RefusedError("the machine is not on")
        if self._stat.interp_state != linuxcnc.INTERP_IDLE:
            raise RefusedError("LinuxCNC is busy with a program or another command")
        if self._stat.task_mode != linuxcnc.MODE_MDI:
            self._set_mode(linuxcnc.MODE_MDI)
        self._take_messages()
        self._abandoned = False
        self._command.mdi(request["line"])
        self._begin()
        return {}

    def _mode(self, request: Fields) -> Fields:
        mode = {name: number for number, name in MODES.items()}.get(request["mode"])
        if mode is None:
            raise RefusedError(f"no such mode: {request['mode']!r}")
        self._poll()
        if self._stat.interp_state != linuxcnc.INTERP_IDLE:
            raise RefusedError("LinuxCNC is busy with a program or another command")
        self._set_mode(mode)
        return {}

    def _begin(self) -> None:
        """Record the command just sent as started here, and wait until the task has accepted it."""
        self._begun = serial = self._command.serial
        self._await(lambda stat: stat.echo_serial_number == serial, "take the command")

    def _set_mode(self, mode: int) -> None:
        self._monitor.require_alive(surely=True)
        self._command.mode(mode)
        self._await(lambda stat: stat.task_mode == mode, f"change to mode {MODES[mode]}")

    def _home(self, _request: Fields) -> Fields:
        """Start homing all joints, in the sequence of the INI file. They are unhomed first: otherwise the end of the
        homing of joints that are homed already could not be told from its beginning."""
        self._poll()
        if self._stat.task_state != linuxcnc.STATE_ON:
            raise RefusedError("the machine is not on")
        self._set_mode(linuxcnc.MODE_MANUAL)
        self._command.teleop_enable(0)
        joints = range(self._stat.joints)
        if any(self._stat.homed[n] for n in joints):
            self._command.unhome(-1)
            self._await(lambda stat: not any(stat.homed[n] for n in joints), "unhome the joints")
        self._command.home(-1)
        self._begin()
        return {}

    def _abort(self, _request: Fields) -> Fields:
        self._begun = None
        self._stop()
        return {}

    def _pause(self, _request: Fields) -> Fields:
        self._monitor.require_alive(surely=True)
        self._command.auto(linuxcnc.AUTO_PAUSE)
        return {}

    def _resume(self, _request: Fields) -> Fields:
        self._monitor.require_alive(surely=True)
        self._command.auto(linuxcnc.AUTO_RESUME)
        return {}

    def _on(self, _request: Fields) -> Fields:
        """Switch the machine on, and release a hold by volcal after an abort of the motion that it held.

        Raises RefusedError in an emergency stop, which is never overridden.
        """
        self._monitor.require_alive(surely=True)
        self._poll()
        if self._stat.task_state == linuxcnc.STATE_ESTOP:
            raise RefusedError("emergency stop")
        if hold.held():
            self._command.abort()
            self._await(lambda stat: stat.interp_state == linuxcnc.INTERP_IDLE and stat.inpos, "abort the held motion")
            hold.release()
        if self._stat.task_state != linuxcnc.STATE_ON:
            self._command.state(linuxcnc.STATE_ON)
            self._await(lambda stat: stat.task_state == linuxcnc.STATE_ON, "switch the machine on")
        return {}

    def _await(self, reached: Callable[[Any], bool], what: str) -> None:
        """Wait up to 1 s for a state that LinuxCNC's task reaches within its next cycles, if at all."""
        ends_s = time.monotonic() + 1.0
        while True:
            self._monitor.require_alive()
            self._poll()
            if reached(self._stat):
                return
            if time.monotonic() > ends_s:
                messages = "; ".join(self._take_messages())
                raise RefusedError(f"LinuxCNC did not {what}{': ' if messages else ''}{messages}")
            time.sleep(0.002)


def answer_line(bridge: Bridge, line: bytes) -> Fields:
    """Carry out the request in one line of standard input, and return the answer.

    If the request is invalid or refused, the answer contains the error.
    """
    number = None
    try:
        request = json.loads(line)
        number = request.get("id")
        return {"id": number, "ok": bridge.answer(request)}
    except NoSuchPinError as error:
        return {"id": number, "error": "unknown", "text": str(error)}
    except ProcessStoppedError as error:
        return {"id": number, "error": "stopped", "text": str(error)}
    except GoneError as error:
        return {"id": number, "error": "gone", "text": str(error)}
    except (RefusedError, linuxcnc.error) as error:
        return {"id": number, "error": "refused", "text": str(error)}
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        return {"id": number, "error": "refused", "text": f"not a request: {error!r}"}


def main() -> None:
    replies = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # LinuxCNC's C library prints to standard output, which carries the answers
    try:
        bridge = Bridge(look_only=sys.argv[1:] == ["look"])
    except (linuxcnc.error, hal.error) as error:
        replies.write(json.dumps({"id": 0, "error": "gone", "text": f"LinuxCNC is not running: {error}"}) + "\n")
        return
    replies.write(json.dumps({"id": 0, "ok": {"protocol": PROTOCOL}}) + "\n")
    buffered = b""
    try:
        while True:
            if not select.select([0], [], [], bridge.pause_s())[0]:
                _watch(bridge)
                continue
            chunk = os.read(0, 65536)
            if not chunk:
                return
            *lines, buffered = (buffered + chunk).split(b"\n")
            for line in lines:
                replies.write(json.dumps(answer_line(bridge, line)) + "\n")
    except (BrokenPipeError, KeyboardInterrupt, GoneError):
        return
    finally:
        _end(bridge)


def _watch(bridge: Bridge) -> None:
    try:
        bridge.watch()
    except ProcessStoppedError as error:  # the next request reports it
        sys.stderr.write(f"{error}\n")


def _end(bridge: Bridge) -> None:
    try:
        bridge.end()
    except (GoneError, ProcessStoppedError) as error:
        sys.stderr.write(f"{error}\n")


if __name__ == "__main__":
    main()
