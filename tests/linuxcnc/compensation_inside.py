"""Test helper under the system's Python, beside its own LinuxCNC: JSON lines [operation, arguments ...] on stdin.

Answers are JSON lines on stdout. It uses no code of the driver, so that a store is tested independently of the
driver's bridge.
"""

import ctypes
import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import hal
import linuxcnc

PATIENCE_S = 600.0
SHARED_KEY = 0x564F4C31
SLOT_BYTES = 3 * 4 + 3 * 4 + 8 * 8 + 262144 * 12
COUNTS_AT = 24 + 3 * 4 + 3 * 4 + 8 * 8


def connected():
    """Connect to LinuxCNC once its task answers."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        try:
            status = linuxcnc.stat()
            status.poll()
            return linuxcnc.command(), status, linuxcnc.error_channel()
        except (linuxcnc.error, SystemError):
            time.sleep(0.05)
    raise SystemExit("LinuxCNC did not start")


class Inside:
    def __init__(self):
        self.command, self.status, self.errors = connected()
        self.component = hal.component("compensation-test")
        self.component.ready()

    def get(self, name):
        return hal.get_value(name)

    def set(self, name, value):
        hal.set_p(name, str(int(value)) if isinstance(value, bool) else repr(value))

    def wait(self, *names_and_values):
        """Wait until every pin has its value; return True if all have."""
        pairs = list(zip(names_and_values[::2], names_and_values[1::2], strict=True))
        end_s = time.monotonic() + PATIENCE_S
        while time.monotonic() < end_s:
            if all(hal.get_value(name) == value for name, value in pairs):
                return True
            time.sleep(0.002)
        return False

    def on(self):
        self.command.state(linuxcnc.STATE_ESTOP_RESET)
        self.command.wait_complete(PATIENCE_S)
        self.command.state(linuxcnc.STATE_ON)
        self.command.wait_complete(PATIENCE_S)
        self.status.poll()
        return self.status.task_state == linuxcnc.STATE_ON

    def off(self):
        self.command.state(linuxcnc.STATE_OFF)
        self.command.wait_complete(PATIENCE_S)

    def estop(self):
        self.command.state(linuxcnc.STATE_ESTOP)
        self.command.wait_complete(PATIENCE_S)

    def home(self):
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.command.wait_complete(PATIENCE_S)
        self.command.teleop_enable(0)
        self.command.wait_complete(PATIENCE_S)
        self.command.home(-1)
        homed = self.wait("motion.is-all-homed", True)
        self.command.mode(linuxcnc.MODE_MDI)
        self.command.wait_complete(PATIENCE_S)
        return homed

    def mdi(self, text, within_s=PATIENCE_S):
        self.start(text)
        return self.command.wait_complete(within_s) == linuxcnc.RCS_DONE

    def start(self, text):
        self.command.mode(linuxcnc.MODE_MDI)
        self.command.wait_complete(PATIENCE_S)
        self.command.mdi(text)

    def abort(self):
        self.command.abort()
        self.command.wait_complete(PATIENCE_S)

    def gcodes(self):
        self.status.poll()
        return list(self.status.gcodes)

    def feed(self, override):
        self.command.feedrate(override)

    def joint_mode(self, yes):
        self.command.mode(linuxcnc.MODE_MANUAL)
        self.command.wait_complete(PATIENCE_S)
        self.command.teleop_enable(0 if yes else 1)
        self.command.wait_complete(PATIENCE_S)

    def jog(self, joint_mode, axis, speed, distance):
        self.command.jog(linuxcnc.JOG_INCREMENT, joint_mode, axis, speed, distance)

    def messages(self):
        messages = []
        while (message := self.errors.poll()) is not None:
            messages.append(message[1])
        return messages

    def positions(self):
        self.status.poll()
        return {"position": self.status.position[:3], "actual": self.status.actual_position[:3]}

    def run(self, *words):
        completed = subprocess.run(list(words), capture_output=True, text=True, check=False)
        return [completed.returncode, completed.stdout + completed.stderr]

    def start_sampling(self, path):
        """Sample every servo period from now on into `path`, one row per period."""
        hal.set_p("sampler.0.enable", "0")
        stale = hal.get_value("sampler.0.curr-depth")
        if stale:
            subprocess.run(["halsampler", "-n", str(stale)], stdout=subprocess.DEVNULL, timeout=PATIENCE_S, check=True)
        hal.set_p("sampler.0.enable", "1")
        with Path(path).open("w") as file:
            self.sampling = subprocess.Popen(["halsampler"], stdout=file)

    def finish_sampling(self):
        hal.set_p("sampler.0.enable", "0")
        taken = self.wait("sampler.0.curr-depth", 0)
        self.sampling.send_signal(signal.SIGINT)  # it then writes what it has taken
        self.sampling.wait(PATIENCE_S)
        return taken

    def damage_table(self, bank, node):
        """Write a wrong value to the shared memory, as a faulty driver of another device could."""
        libc = ctypes.CDLL(None)
        libc.shmat.restype = ctypes.c_void_p
        libc.shmat.argtypes = [ctypes.c_int, ctypes.c_void_p, ctypes.c_int]
        address = libc.shmat(libc.shmget(SHARED_KEY, 0, 0), None, 0)
        count = ctypes.c_int32.from_address(address + COUNTS_AT + (bank - 1) * SLOT_BYTES + 12 * node)
        count.value += 1000
        return count.value


def say(answer):
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def main():
    inside = Inside()
    say("ready")
    for line in sys.stdin:
        operation, *arguments = json.loads(line)
        try:
            answer = {"result": getattr(inside, operation)(*arguments)}
        except Exception as error:  # noqa: BLE001  every error is an answer
            answer = {"error": f"{type(error).__name__}: {error}"}
        say(answer)


main()
