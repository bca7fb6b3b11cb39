"""Minimal Debian that really boots: its root is created once, copied for each test, and run under systemd-nspawn."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

NEEDED = ("debootstrap", "systemd-nspawn", "nsenter", "dpkg-deb")
SUITE = "bookworm"
BASE = ("systemd-sysv", "dbus", "init-system-helpers")
ENVIRONMENT = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "LANG": "C.UTF-8"}
BOOTS_WITHIN_S = 120.0
LOOK_EVERY_S = 0.25
T = TypeVar("T")


def base_root(directory: Path, depends: str) -> Path:
    """Return a root with the package's dependencies, cached while the list of packages is unchanged."""
    names = [re.split(r"[ (]", one.strip(), maxsplit=1)[0] for one in depends.split(",")]
    packages = ",".join([*BASE, *(name for name in names if name != "systemd")])
    base, stamp = directory / "base", directory / "base.packages"
    if not (base.is_dir() and stamp.is_file() and stamp.read_text() == packages):
        shutil.rmtree(base, ignore_errors=True)
        directory.mkdir(parents=True, exist_ok=True)
        subprocess.run(
            ["debootstrap", "--variant=minbase", f"--include={packages}", SUITE, str(base), *_mirror()],
            check=True,
        )
        stamp.write_text(packages)
    return base


def _mirror() -> list[str]:
    """Return the mirror that this computer uses, or none for debootstrap's default."""
    if named := os.environ.get("DEBIAN_MIRROR"):
        return [named]
    places = (Path("/etc/apt/sources.list"), *sorted(Path("/etc/apt/sources.list.d").glob("*")))
    text = "\n".join(path.read_text() for path in places if path.is_file())
    found = re.search(r"^(?:URIs:\s*|deb\s+(?:\[[^]]*\]\s+)?)(\S+)", text, re.MULTILINE)
    return [found.group(1)] if found else []


@contextmanager
def booted_container(base: Path, root: Path, log: Path) -> Iterator[Container]:
    """Boot a copy of `base` at `root` with its own network; power it off and remove it at the end."""
    shutil.rmtree(root, ignore_errors=True)
    subprocess.run(["cp", "-a", "--reflink=auto", str(base), str(root)], check=True)
    (root / "etc/machine-id").write_text("uninitialized\n")
    command = ["systemd-nspawn", "-q", "-D", str(root), "--register=no", "--keep-unit", "--private-network", "-b"]
    with (
        log.open("w") as console,
        subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=console, stderr=subprocess.STDOUT) as process,
    ):
        try:
            leader = wait_for(lambda: _child(process), "the container's first process", BOOTS_WITHIN_S)
            container = Container(root, leader)
            wait_for(lambda: container.state() in {"running", "degraded"}, "the container to boot", BOOTS_WITHIN_S)
            yield container
        finally:
            _power_off(process)
    shutil.rmtree(root, ignore_errors=True)


@dataclass(frozen=True)
class Container:
    root: Path
    leader: int

    def run(self, *command: str, check: bool = True, within_s: float = 300.0) -> subprocess.CompletedProcess[str]:
        """Run a command inside. If `check`, raise AssertionError with its output when it fails."""
        entered = ["nsenter", "-t", str(self.leader), "-a", "-r", "-w", "--", *command]
        done = subprocess.run(
            entered, check=False, capture_output=True, text=True, env=ENVIRONMENT, stdin=subprocess.DEVNULL,
            timeout=within_s,
        )  # fmt: skip
        if check and done.returncode != 0:
            raise AssertionError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
        return done

    def out(self, *command: str) -> str:
        return self.run(*command).stdout.strip()

    def state(self) -> str:
        return self.run("systemctl", "is-system-running", check=False).stdout.strip()

    def property(self, unit: str, name: str) -> str:
        return self.out("systemctl", "show", "--value", "-p", name, unit)

    def journal(self, unit: str) -> str:
        return self.out("journalctl", "--no-pager", "-o", "cat", "-u", unit)

    def write(self, path: str, text: str, mode: int = 0o644) -> None:
        inside = self.root / path.lstrip("/")
        inside.parent.mkdir(parents=True, exist_ok=True)
        inside.write_text(text)
        inside.chmod(mode)

    def read(self, path: str) -> str:
        return (self.root / path.lstrip("/")).read_text()

    def exists(self, path: str) -> bool:
        return os.path.lexists(self.root / path.lstrip("/"))


def wait_for(condition: Callable[[], T], what: str, within_s: float) -> T:
    deadline = time.monotonic() + within_s
    while not (found := condition()):
        if time.monotonic() > deadline:
            raise AssertionError(f"timed out after {within_s:.0f} s waiting for {what}")
        time.sleep(LOOK_EVERY_S)
    return found


def _child(process: subprocess.Popen[bytes]) -> int:
    """Return the pid of the container's first process, or 0 while there is none."""
    if process.poll() is not None:
        raise AssertionError(f"systemd-nspawn ended with {process.returncode}; see its log")
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            text = status.read_text()
        except OSError:  # it has ended meanwhile
            continue
        if f"\nPPid:\t{process.pid}\n" in text and re.search(r"^NSpid:\t\d+\t1$", text, re.MULTILINE):
            return int(status.parent.name)
    return 0


def _power_off(process: subprocess.Popen[bytes]) -> None:
    """Send SIGTERM, which systemd-nspawn forwards as a request to power off."""
    process.send_signal(signal.SIGTERM)
    try:
        process.wait(60.0)
    except subprocess.TimeoutExpired:
        process.kill()
