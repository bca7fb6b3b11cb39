"""Linux namespaces around a LinuxCNC: it has one lock, fixed keys of shared memory and servers on all interfaces.

A program started here has network, IPC, mounts and processes of its own; another enters the same by `nsenter_command`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

MODULES = Path("/usr/lib/linuxcnc/modules")
TMP = Path("/tmp")  # noqa: S108  of the namespace
PROGRAMS = Path(__file__).resolve().parents[2]
"""Where volcal is: whoever enters the namespace must find it, also where that is under the /tmp outside."""
HOME = str(TMP)
"""LinuxCNC keeps its tool table in a file under HOME: whoever talks to it must have the same."""


def unshare_command(command: list[str]) -> list[str]:
    """`command` as the first process of namespaces of its own; it ends with the process that starts it."""
    return [
        "unshare",
        *_user(),
        "--net",
        "--ipc",
        "--mount",
        "--pid",
        "--fork",
        "--kill-child",
        "--mount-proc",
        *command,
    ]


def nsenter_command(pid: int) -> list[str]:
    """What to put before a command that shall run in the namespaces of process `pid`, as seen from here."""
    user = ["--user", "--preserve-credentials"] if _user() else []
    return ["nsenter", "--target", str(pid), *user, "--net", "--ipc", "--mount", "--pid", "env", f"HOME={HOME}"]


def unavailable_reason() -> str:
    """Why no LinuxCNC can run here; empty where one can."""
    for program, package in (("linuxcnc", "linuxcnc-uspace"), ("halcompile", "linuxcnc-uspace-dev")):
        if shutil.which(program) is None:
            return f"{program} is not installed (package {package})"
    for program, package in (("faketime", "faketime"), ("unshare", "util-linux"), ("ip", "iproute2")):
        if shutil.which(program) is None:
            return f"{program} is not installed (package {package})"
    tried = subprocess.run(  # noqa: S603
        unshare_command(["true"]), capture_output=True, text=True, timeout=10.0, check=False
    )
    return "" if tried.returncode == 0 else f"no namespaces can be had: {tried.stderr.strip()}"


def make_private(work: Path, modules: list[Path]) -> None:
    """Called first inside: loopback up, a /dev/shm and a /tmp of our own in which `work` and these programs stay where
    they are, and `modules` beside those that LinuxCNC loads."""
    _run("ip", "link", "set", "lo", "up")
    # faketime names what it shares by process ids, which begin again in here
    _run("mount", "-t", "tmpfs", "-o", "mode=1777", "tmpfs", "/dev/shm")  # noqa: S108
    _run("mount", "-t", "tmpfs", "tmpfs", "/mnt")
    hidden = [path for path in (PROGRAMS, work) if path.is_relative_to(TMP)]
    kept = [(path, Path("/mnt", str(number))) for number, path in enumerate(hidden)]
    for path, aside in kept:
        aside.mkdir()
        _run("mount", "--bind", str(path), str(aside))
    _run("mount", "-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(TMP))
    for path, aside in kept:
        path.mkdir(parents=True, exist_ok=True)
        _run("mount", "--move", str(aside), str(path))
    here = TMP / "modules"
    shutil.copytree(MODULES, here)
    for module in modules:
        shutil.copy(module, here)
    _run("mount", "--bind", str(here), str(MODULES))


def first_child(pid: int) -> int | None:
    """The only child of a process, as `unshare --fork` has one; None before it is there."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return int(children[0]) if children else None


def _user() -> list[str]:
    return [] if os.geteuid() == 0 else ["--user", "--map-root-user"]


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, timeout=30.0)  # noqa: S603
