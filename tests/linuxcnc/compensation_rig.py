"""A stock LinuxCNC in its own namespaces, with one of the three compensation methods."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from drivers.roles import TableImage

HERE = Path(__file__).parent
COMPONENTS = HERE.parents[1] / "drivers" / "linuxcnc" / "components"
NAMESPACES = ("unshare", "--net", "--ipc", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc")
ANSWER_WITHIN_S = 600.0
AXES = "xyz"

START = """\
set -e
mount --bind {work} /mnt
mount -t tmpfs tmpfs /tmp
mkdir /tmp/modules
cp /usr/lib/linuxcnc/modules/*.so /mnt/build/*.so /tmp/modules
mount --bind /tmp/modules /usr/lib/linuxcnc/modules
ip link set lo up
chmod 777 /tmp
mkdir -m 777 /tmp/fifo
export RTAPI_UID=65534 RTAPI_FIFO_PATH=/tmp/fifo/rtapi PATH=/mnt/build:$PATH HOME=/tmp
cd /mnt
linuxcnc /mnt/machine.ini </dev/null >/mnt/linuxcnc.log 2>&1 &
for n in $(seq 300); do pidof linuxcncrsh >/dev/null && break; sleep 0.05; done
exec /usr/bin/python3 /mnt/inside.py
"""

INI = """\
[EMC]
MACHINE = test
VERSION = 1.1
[DISPLAY]
DISPLAY = linuxcncrsh --port 5007
[TASK]
TASK = milltask
CYCLE_TIME = 0.001
[RS274NGC]
PARAMETER_FILE = /mnt/machine.var
[EMCMOT]
EMCMOT = motmod
SERVO_PERIOD = 1000000
COMM_TIMEOUT = 1.0
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.1
[HAL]
HALFILE = /mnt/machine.hal
{halfiles}
[VOLCAL]
DIRECTORY = /mnt/tables
[KINS]
KINEMATICS = {kinematics}
JOINTS = 3
[TRAJ]
COORDINATES = X Y Z
LINEAR_UNITS = mm
ANGULAR_UNITS = degree
MAX_LINEAR_VELOCITY = 1000
MAX_LINEAR_ACCELERATION = 5000
"""

AXIS = """\
[AXIS_{letter}]
MIN_LIMIT = -100
MAX_LIMIT = {upper}
MAX_VELOCITY = 1000
MAX_ACCELERATION = 5000
OFFSET_AV_RATIO = 0.2
[JOINT_{number}]
TYPE = LINEAR
MIN_LIMIT = -100
MAX_LIMIT = {upper}
MAX_VELOCITY = 1000
MAX_ACCELERATION = 5000
STEPGEN_MAXACCEL = 10000
FERROR = 5
MIN_FERROR = 5
HOME = 0
HOME_SEQUENCE = 0
HOME_ABSOLUTE_ENCODER = 2
{comp}
"""

HAL = """\
loadrt [KINS]KINEMATICS
loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS
loadrt sampler depth=8000 cfg=fffffffff
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net j0 joint.0.motor-pos-cmd => joint.0.motor-pos-fb sampler.0.pin.0
net j1 joint.1.motor-pos-cmd => joint.1.motor-pos-fb sampler.0.pin.1
net j2 joint.2.motor-pos-cmd => joint.2.motor-pos-fb sampler.0.pin.2
net estop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in
net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared
net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed
"""

SAMPLED = """\
net {signal} axis.{letter}.pos-cmd => sampler.0.pin.{command}
net {offset} axis.{letter}.eoffset => sampler.0.pin.{eoffset}
"""

UPPER_MM = (800.0, 400.0, 320.0)


def compile_components(folder: Path) -> Path:
    """Compile the modules and the loader from source, as a user would, and return `folder`."""
    subprocess.run(
        ["make", "-s", "-C", str(COMPONENTS), f"OUT={folder}"], check=True, capture_output=True, timeout=600.0
    )
    return folder


def unavailable_reason() -> str:
    """Return why LinuxCNC cannot run here; an empty string if it can."""
    for program in ("linuxcnc", "halcompile"):
        if shutil.which(program) is None:
            return f"{program} IS NOT INSTALLED: apt-get install linuxcnc-uspace linuxcnc-uspace-dev"
    tried = subprocess.run([*NAMESPACES, "true"], capture_output=True, text=True, check=False)
    return "" if tried.returncode == 0 else f"NO NAMESPACES HERE: {tried.stderr.strip()}"


def machine(work: Path, build: Path, way: str) -> Path:
    """Create a directory with INI, HAL and programs for `way`: external-offsets, kinematics or comp-files."""
    work.mkdir(mode=0o755)
    shutil.copytree(build, work / "build")
    (work / "tables").mkdir()
    if way == "comp-files":
        subprocess.run([COMPONENTS / "volcal-comp-files-init", work / "tables"], check=True)
    halfiles = {"external-offsets": "HALFILE = /mnt/volcal-eoffset.hal", "kinematics": "HALFILE = /mnt/volcal-kins.hal"}
    halfiles["comp-files"] = "HALFILE = /mnt/tables/acting/bank.hal"
    for name in ("volcal-eoffset.hal", "volcal-kins.hal"):
        shutil.copy(COMPONENTS / name, work)
    text = INI.format(
        halfiles=halfiles[way] + "\nHALFILE = /mnt/after.hal",
        kinematics="volcal_kins" if way == "kinematics" else "trivkins coordinates=xyz",
    )
    hal, after = HAL, "setp sampler.0.enable 0\naddf sampler.0 servo-thread\n"
    for number, letter in enumerate(AXES):
        comp = f"COMP_FILE = /mnt/tables/acting/{letter}.comp\nCOMP_FILE_TYPE = 0" if way == "comp-files" else ""
        text += AXIS.format(letter=letter.upper(), number=number, upper=UPPER_MM[number], comp=comp)
        names = (f"volcal-{letter}-position", f"volcal-{letter}-offset")
        hal_part = SAMPLED.format(
            signal=names[0], offset=names[1], letter=letter, command=3 + number, eoffset=6 + number
        )
        after += hal_part
    (work / "machine.ini").write_text(text)
    (work / "machine.hal").write_text(hal)
    (work / "after.hal").write_text(after)
    return work


class Controller:
    """Running LinuxCNC; implements `drivers.linuxcnc.pins.Pins`."""

    def __init__(self, work: Path) -> None:
        self.work = work
        # the checkout may be below /tmp, which is a different directory inside the namespace
        shutil.copy(HERE / "compensation_inside.py", work / "inside.py")
        with (work / "inside.log").open("w") as said:
            self._process = self._started(START.format(work=work), said)
        try:
            self._line()
        except BaseException:
            self.kill()
            raise

    def _started(self, script: str, said: IO[str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [*NAMESPACES, "bash", "-c", script],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=said,
            process_group=0,
        )

    def __call__(self, operation: str, *arguments: object) -> Any:
        assert self._process.stdin
        self._process.stdin.write(json.dumps([operation, *arguments]).encode() + b"\n")
        self._process.stdin.flush()
        answer = self._line()
        if "error" in answer:
            raise RuntimeError(f"{operation}{arguments}: {answer['error']}")
        return answer["result"]

    def get(self, name: str) -> Any:
        return self("get", name)

    def set(self, name: str, value: object) -> None:
        self("set", name, value)

    def motor(self) -> NDArray[np.float64]:
        return np.array([self.get(f"joint.{n}.motor-pos-cmd") for n in range(3)])

    def displayed(self) -> NDArray[np.float64]:
        """Return the programmed axis positions, which LinuxCNC shows without the external offset."""
        return np.array([self.get(f"axis.{a}.pos-cmd") for a in AXES])

    def ready(self) -> None:
        """Switch the machine on and home it, unless that is done already."""
        if self.get("motion.motion-enabled") and self.get("motion.is-all-homed"):
            return
        assert self("on") and self("home"), self.log()

    def at(self, *position_mm: float) -> None:
        """Move to the position and wait for rest; trims and offsets follow at their own speed a moment later."""
        x, y, z = position_mm
        assert self("mdi", f"G53 G0 X{x} Y{y} Z{z}"), self.log()
        assert self("mdi", "G4 P0.05"), self.log()

    def start_sampling(self) -> None:
        self("start_sampling", "/mnt/samples.txt")

    def samples(self) -> NDArray[np.float64]:
        """Return the samples, shape (count, 9): motor, axis command, external offset; one row per servo period."""
        assert self("finish_sampling")
        rows = [line.split() for line in (self.work / "samples.txt").read_text().splitlines()]
        return np.array([row for row in rows if len(row) == 9], dtype=float)

    def log(self) -> str:
        return (self.work / "linuxcnc.log").read_text()[-3000:]

    def kill(self) -> None:
        """Kill every process of the namespace at once, as a power cut does."""
        if self._process.poll() is None:
            os.kill(self._process.pid, signal.SIGKILL)
        self._process.wait(ANSWER_WITHIN_S)
        for stream in (self._process.stdin, self._process.stdout):
            if stream:
                stream.close()

    def _line(self) -> Any:
        assert self._process.stdout
        ready, _, _ = select.select([self._process.stdout], [], [], ANSWER_WITHIN_S)
        line = self._process.stdout.readline() if ready else b""
        if not line:
            said = (self.work / "inside.log").read_text() + self.log()
            raise RuntimeError(f"LinuxCNC does not answer: {said}")
        return json.loads(line)


def trilinear(table: TableImage, position_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the corrections at positions of shape (n, 3), by hat functions over all nodes instead of cells."""
    hats = []
    for axis in range(3):
        nodes = table.origin_mm[axis] + table.step_mm[axis] * np.arange(table.shape[axis])
        inside = np.clip(position_mm[:, axis], nodes[0], nodes[-1])
        hats.append(np.maximum(0.0, 1.0 - np.abs(inside[:, None] - nodes) / table.step_mm[axis]))
    return np.asarray(np.einsum("ni,nj,nk,ijkc->nc", *hats, table.counts * table.resolution_mm))


def smooth_table(seed: int, largest_mm: float = 0.024) -> TableImage:
    """Return a table of waves across the workspace in which every correction depends on all axes, without symmetry."""
    random = np.random.default_rng(seed)
    shape = (11, 6, 5)
    grid = np.meshgrid(*[np.linspace(0.0, 1.0, count) for count in shape], indexing="ij")
    waves = np.zeros((*shape, 3))
    for axis in range(3):
        for _ in range(4):
            k, phase = random.uniform(-4.0, 4.0, 3), random.uniform(0.0, 6.0)
            waves[..., axis] += np.sin(k[0] * grid[0] + k[1] * grid[1] + k[2] * grid[2] + phase)
    counts = np.rint(waves / np.abs(waves).max() * largest_mm / 1e-4).astype(np.int32)
    return TableImage((0.0, 0.0, 0.0), (80.0, 80.0, 80.0), 1e-4, counts)


@contextmanager
def running(work: Path) -> Iterator[Controller]:
    controller = Controller(work)
    try:
        yield controller
    finally:
        controller.kill()
