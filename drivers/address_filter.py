"""Hint at the address filter of systemd, behind which the service reaches this computer only.

The filter discards packets without an answer, so a refused connection looks like a machine that is switched off.
"""

from __future__ import annotations

import ipaddress
import os
from collections.abc import Mapping

FILTER_SETTING = "IPAddressAllow"


def filter_hint(hint: str, host: str, environment: Mapping[str, str] = os.environ) -> str:
    """Return `hint` for an address that cannot be reached, preceded by the systemd setting that permits the address if
    this process is the service under systemd and `host` is another computer."""
    if "NOTIFY_SOCKET" not in environment or _is_loopback(host):
        return hint
    return (
        f"allow the address with {FILTER_SETTING}={host} in /etc/systemd/system/volcal.service.d/machine.conf (then "
        f"`systemctl daemon-reload`), since the service reaches no other computer without it; or {hint}"
    )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
