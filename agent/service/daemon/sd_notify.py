"""Notification protocol of systemd (sd_notify(3)). Each message is a datagram to the socket named in NOTIFY_SOCKET."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

import structlog

log = structlog.get_logger()
S_PER_US = 1e-6
SEND_TIMEOUT_S = 1.0
"""This timeout is short because signals must be handled even if the service manager does not read (its queue holds ten
messages).
"""


class Notifier:
    """Sender of notifications to systemd. It does nothing if NOTIFY_SOCKET is not set. If the socket is lost, the loss
    is logged and the service continues."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        name = environment.get("NOTIFY_SOCKET", "")
        self._address = f"\0{name[1:]}" if name.startswith("@") else name
        watchdog = environment.get("WATCHDOG_USEC", "")
        ours = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self.watchdog_s = int(watchdog) * S_PER_US if watchdog.isdigit() and ours else None

    def send(self, **assignments: str | int) -> None:
        if not self._address:
            return
        message = "\n".join(f"{name}={value}" for name, value in assignments.items())
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as channel:
                channel.settimeout(SEND_TIMEOUT_S)
                channel.sendto(message.encode(), self._address)
        except OSError as error:
            log.warning("systemd cannot be notified", error=str(error))
