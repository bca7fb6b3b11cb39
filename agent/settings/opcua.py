"""Section `[opcua]` of the settings file: listening address of the OPC UA server, and its trusted clients."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from twin.formats.toml_reading import StrictModel


def _address(text: str) -> str:
    return str(ip_address(text))


class OpcUaSettings(StrictModel):
    """Settings of the OPC UA server.

    `trusted_clients` is the directory of the client certificates (DER or PEM); by default it is ``opcua/trusted`` in
    the state directory. If `anonymous_reading` is true, anonymous clients may read, hold and abort.
    """

    enabled: bool = False
    host: Annotated[str, AfterValidator(_address)] = "127.0.0.1"
    port: int = Field(default=4840, ge=1, le=65535)
    trusted_clients: Path | None = None
    anonymous_reading: bool = False

    def resolved(self, base: Path) -> OpcUaSettings:
        """Return these settings with relative paths resolved against the directory `base`."""
        if self.trusted_clients is None:
            return self
        return self.model_copy(update={"trusted_clients": (base / self.trusted_clients).resolve()})
