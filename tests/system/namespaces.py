"""Namespaces of their own for tests: loopback with multicast or a kernel CAN interface, or a small disk."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
from collections.abc import Sequence
from pathlib import Path

MULTICAST = "ip link set lo up multicast on && ip route add 224.0.0.0/4 dev lo"
KERNEL_CAN = "ip link set lo up && ip link add dev vcan0 type vcan && ip link set vcan0 up"


def inside(preparation: str, command: Sequence[str]) -> list[str]:
    """`command` in a network namespace of its own, after the preparation."""
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    return ["unshare", "--net", *user, "sh", "-c", f'{preparation} && exec "$@"', "sh", *command]


def missing(preparation: str) -> str:
    """Why there is no such namespace on this computer; empty where there is."""
    for program in ("unshare", "ip"):
        if shutil.which(program) is None:
            return f"there is no program {program}"
    tried = subprocess.run(inside(preparation, ["true"]), capture_output=True, text=True, timeout=600.0, check=False)
    return tried.stderr.strip().replace("\n", "; ") or "it cannot be made" if tried.returncode else ""


def kernel_can_missing() -> str:
    """Why this kernel has no CAN; empty where it has."""
    try:
        socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (AttributeError, OSError) as error:
        return f"this kernel has no CAN sockets ({error})"
    absent = missing(KERNEL_CAN)
    return f"no vcan interface ({absent})" if absent else ""


def on_small_disk(directory: Path, size: str, command: Sequence[str]) -> list[str]:
    """`command` with an empty disk of `size` at the existing `directory`, which goes with the command."""
    user = [] if os.geteuid() == 0 else ["--user", "--map-root-user"]
    mount = 'mount -t tmpfs -o "size=$1" tmpfs "$2" && shift 2 && exec "$@"'
    return ["unshare", "--mount", *user, "sh", "-c", mount, "sh", size, str(directory), *command]


def small_disk_missing(directory: Path) -> str:
    """Why there is no small disk on this computer; empty where there is."""
    if shutil.which("unshare") is None:
        return "there is no program unshare"
    command = on_small_disk(directory, "64k", ["true"])
    tried = subprocess.run(command, capture_output=True, text=True, timeout=600.0, check=False)
    return tried.stderr.strip().replace("\n", "; ") or "it cannot be made" if tried.returncode else ""
