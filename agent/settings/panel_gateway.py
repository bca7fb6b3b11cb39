"""The section `[gateway]`: who may reach the Modbus server for panels, and what becomes of a silent one."""

from __future__ import annotations

from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from twin.formats.toml_reading import Strict


def _network(text: str) -> str:
    return str(ip_network(text))


def _address(text: str) -> str:
    return str(ip_address(text))


Network = Annotated[str, AfterValidator(_network)]
Address = Annotated[str, AfterValidator(_address)]


class GatewaySettings(Strict):
    """`clients`: addresses, or networks without host bits; anybody else is hung up on. Without `access_code_file`
    panels may only read, hold and abort."""

    enabled: bool = False
    host: Address = "127.0.0.1"
    port: int = Field(default=5020, ge=0, le=65535)
    clients: list[Network] = Field(default=["127.0.0.0/8", "::1/128"], min_length=1)
    access_code_file: Path | None = None
    most_clients: int = Field(default=8, ge=1, le=64)
    idle_s: float = Field(default=60.0, ge=1.0, le=3600.0)
    silence_s: int = Field(default=5, ge=2, le=600)
    on_silence: Literal["note", "hold"] = "note"

    def resolved(self, base: Path) -> GatewaySettings:
        """The same with every path made absolute, starting from `base`."""
        if self.access_code_file is None:
            return self
        return self.model_copy(update={"access_code_file": (base / self.access_code_file).resolve()})
