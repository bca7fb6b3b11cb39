"""Access code of panels: one number that all panels share.

The code prevents a wrong or misconfigured device from moving the machine. The code does not protect against
eavesdropping or attacks, because Modbus transmits it unencrypted and it has only 32 bits.
"""

from __future__ import annotations

import hmac
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from agent.files import read_text
from agent.settings.credentials import handed_over, open_mode
from agent.settings.panel_gateway import GatewaySettings
from drivers.errors import ConfigurationError

CREDENTIAL: Final = "panel-code"
LOCKED_TICKS: Final = 5
"""Time in s after a wrong code during which no code is checked; trying all 2³² codes would take about 680 years."""


def access_code_path(settings: GatewaySettings, environment: Mapping[str, str] = os.environ) -> Path | None:
    """Return the path of the access code file.

    A file passed by systemd (LoadCredential=panel-code:…) has priority over the file named in the settings. Return None
    if there is neither.
    """
    return handed_over(CREDENTIAL, environment) or settings.access_code_file


def read_access_code(path: Path) -> int:
    """Return the access code. Raise ConfigurationError if the file does not contain a number from 1 to 4294967295, or
    if users other than its owner can access the file."""
    text = read_text(path, error=ConfigurationError).strip()
    if (mode := open_mode(path)) is not None:
        raise ConfigurationError(
            f"the access code file can be read by others (mode {mode:04o})", hint=f"chmod 600 {path}", file=str(path)
        )
    if not (text.isascii() and text.isdecimal() and 1 <= int(text) <= 0xFFFFFFFF):
        raise ConfigurationError(
            "the access code is not an integer from 1 to 4294967295",
            hint="write a single line with a number that is hard to guess",
            file=str(path),
        )
    return int(text)


class AccessCode:
    """Check of the access code. After a wrong code, every code is refused for `LOCKED_TICKS` seconds without being
    checked. `tick` must be called once per second."""

    def __init__(self, code: int | None) -> None:
        self._code = None if code is None else code.to_bytes(4)
        self._locked = 0

    @property
    def is_set(self) -> bool:
        return self._code is not None

    @property
    def locked(self) -> bool:
        return self._locked > 0

    def fits(self, code: int) -> bool:
        if self._code is not None and hmac.compare_digest(self._code, code.to_bytes(4)):
            return True
        self._locked = LOCKED_TICKS
        return False

    def tick(self) -> None:
        self._locked = max(0, self._locked - 1)
