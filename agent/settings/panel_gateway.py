"""Section `[gateway]` of the settings file: access to the Modbus server for panels, and the reaction to the loss of a
panel's heartbeat."""

from __future__ import annotations

from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from twin.formats.toml_reading import StrictModel


def _network(text: str) -> str:
    return str(ip_network(text))


def _address(text: str) -> str:
    return str(ip_address(text))


Network = Annotated[str, AfterValidator(_network)]
Address = Annotated[str, AfterValidator(_address)]


class GatewaySettings(StrictModel):
    """Settings of the panel gateway.

    `clients` are the permitted addresses or networks; connections from other addresses are closed. If
    `access_code_file` is not set, panels may only read, hold and abort.
    """

    enabled: bool = False
    host: Address = "127.0.0.1"
    port: int = Field(default=5020, ge=0, le=65535)
    clients: list[Network] = Field(default=["127.0.0.0/8", "::1/128"], min_length=1)
    access_code_file: Path | None = None
    max_clients: int = Field(default=8, ge=1, le=64)
    idle_timeout_s: float = Field(default=60.0, ge=1.0, le=3600.0)
    panel_timeout_s: int = Field(default=5, ge=2, le=600)
    on_panel_timeout: Literal["note", "hold"] = "note"

    def resolved(self, base: Path) -> GatewaySettings:
        """Return these settings with relative paths resolved against the directory `base`."""
        if self.access_code_file is None:
            return self
        return self.model_copy(update={"access_code_file": (base / self.access_code_file).resolve()})
