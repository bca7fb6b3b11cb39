"""What the service consists of besides the owner and HTTP: further doors, and what HTTP serves besides its endpoints.

Each is imported only where the settings ask for it.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.service.doors import Door
from agent.service.http.app import Extension
from agent.settings import Settings


def further_doors(_: Settings) -> Sequence[Door]:
    """Those that the settings ask for, in the order in which they open."""
    return ()


def http_extensions(_: Settings) -> Sequence[Extension]:
    """Pages and routers behind the guard of the HTTP door."""
    return ()
