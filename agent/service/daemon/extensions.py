"""What the service consists of besides the owner and HTTP: further doors, and what HTTP serves besides its endpoints.

What an optional extra is needed for imports it when it opens.
"""

from __future__ import annotations

from collections.abc import Sequence

from agent.service.daemon.endpoints import Door
from agent.service.gateway.endpoint import GatewayDoor
from agent.service.http.app import Extension
from agent.service.http.metrics import mount_metrics
from agent.service.opcua.endpoint import OpcUaDoor
from agent.service.page.static_files import mount_page
from agent.service.token import read_token, token_path
from agent.settings.schema import Settings


def further_doors(settings: Settings) -> Sequence[Door]:
    """Those that the settings ask for, in the order in which they open."""
    doors: list[Door] = []
    if settings.opcua.enabled:
        doors.append(OpcUaDoor(settings.opcua, settings.state_directory, read_token(token_path(settings))))
    if settings.gateway.enabled:
        doors.append(GatewayDoor(settings.gateway, settings.state_directory))
    return doors


def http_extensions(_: Settings) -> Sequence[Extension]:
    """Pages and routers behind the guard of the HTTP door."""
    return (mount_page, mount_metrics)
