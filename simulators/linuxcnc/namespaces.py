"""Linux namespaces for one LinuxCNC.

The namespaces are needed because LinuxCNC uses one lock, shared memory with fixed keys, and servers on all network
interfaces. A program started by this module has its own network, IPC, mount and process namespaces. Another program
enters these namespaces with `nsenter_command`.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

MODULES = Path("/usr/lib/linuxcnc/modules")
TMP = Path("/tmp")  # noqa: S108  inside the namespace
SHARED_MEMORY = Path("/dev/shm")  # noqa: S108  inside the namespace
PROGRAMS = Path(__file__).resolve().parents[2]
"""Root directory of volcal; programs in the namespaces must find it even if it is under the outer /tmp."""
HOME = str(TMP)
"""HOME of LinuxCNC and of its clients, which must agree because LinuxCNC stores its tool table in a file under HOME."""


def unshare_command(command: list[str]) -> list[str]:
    """Return an `unshare` command that runs `command` as the first process of new namespaces.

    If the `unshare` process ends, `command` is killed.
    """
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
    """Return the prefix of a command that is to run in the namespaces of process `pid`.

    `pid` is the id that the process has outside the namespaces.
    """
    user = ["--user", "--preserve-credentials"] if _user() else []
    return ["nsenter", "--target", str(pid), *user, "--net", "--ipc", "--mount", "--pid", "env", f"HOME={HOME}"]


def unavailable_reason() -> str:
    """Return the reason why LinuxCNC cannot run on this computer, or an empty string if it can run."""
    for program, package in (("linuxcnc", "linuxcnc-uspace"), ("halcompile", "linuxcnc-uspace-dev")):
        if shutil.which(program) is None:
            return f"{program} is not installed (package {package})"
    for program, package in (("faketime", "faketime"), ("unshare", "util-linux"), ("ip", "iproute2")):
        if shutil.which(program) is None:
            return f"{program} is not installed (package {package})"
    result = subprocess.run(  # noqa: S603
        unshare_command(["true"]), capture_output=True, text=True, timeout=10.0, check=False
    )
    return "" if result.returncode == 0 else f"namespaces cannot be created: {result.stderr.strip()}"


def make_private(work: Path, modules: list[Path]) -> None:
    """Prepare the Linux namespaces of this process, which must be new. This must be the first call inside them.

    The function activates the loopback interface and mounts a private /dev/shm and a private /tmp. In them, the
    directory `work` and the volcal programs are still found at their old paths. The files `modules` are added to the
    modules that LinuxCNC can load.
    """
    _run("ip", "link", "set", "lo", "up")
    _run("mount", "-t", "tmpfs", "tmpfs", "/mnt")
    hidden = [path for path in (PROGRAMS, work) if path.is_relative_to(TMP) or path.is_relative_to(SHARED_MEMORY)]
    preserved = [(path, Path("/mnt", str(number))) for number, path in enumerate(hidden)]
    for path, aside in preserved:
        aside.mkdir()
        _run("mount", "--bind", str(path), str(aside))
    # faketime names its shared memory by process ids, which restart in a new namespace
    for private in (SHARED_MEMORY, TMP):
        _run("mount", "-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(private))
    for path, aside in preserved:
        path.mkdir(parents=True, exist_ok=True)
        _run("mount", "--move", str(aside), str(path))
    here = TMP / "modules"
    shutil.copytree(MODULES, here)
    for module in modules:
        shutil.copy(module, here)
    _run("mount", "--bind", str(here), str(MODULES))


def first_child(pid: int) -> int | None:
    """Return the id of the only child of process `pid`, or None if the child does not exist yet.

    Process `pid` may be `unshare --fork`, for example.
    """
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii").split()
    return int(children[0]) if children else None


def _user() -> list[str]:
    return [] if os.geteuid() == 0 else ["--user", "--map-root-user"]


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, timeout=30.0)  # noqa: S603
