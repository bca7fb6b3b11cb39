"""The section `[opcua]`: where the OPC UA server listens and whom it trusts."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from twin.formats.toml_reading import Strict


def _address(text: str) -> str:
    return str(ip_address(text))


class OpcUaSettings(Strict):
    """`trusted_clients`: directory with the certificates of the clients (DER or PEM); by default ``opcua/trusted``
    under the state directory. `anonymous_reading`: such a client may also read, hold and abort without a token."""

    enabled: bool = False
    host: Annotated[str, AfterValidator(_address)] = "127.0.0.1"
    port: int = Field(default=4840, ge=1, le=65535)
    trusted_clients: Path | None = None
    anonymous_reading: bool = False

    def resolved(self, base: Path) -> OpcUaSettings:
        """The same with every path made absolute, starting from `base`."""
        if self.trusted_clients is None:
            return self
        return self.model_copy(update={"trusted_clients": (base / self.trusted_clients).resolve()})
