"""Section `[opcua]` of the settings file: listening address of the OPC UA server, and its trusted clients."""

from __future__ import annotations

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from twin.formats.toml_reading import StrictModel

Text = Annotated[str, Field(min_length=1, max_length=200)]


def _address(text: str) -> str:
    return str(ip_address(text))


class IdentificationPlate(StrictModel):
    """Content of the plate of the machine. OPC UA clients find it as the identification of the machine (OPC 40001-1);
    what is not given is not shown. `product_instance_uri` is the manufacturer's worldwide unique name of this machine.
    """

    manufacturer: Text | None = None
    model: Text | None = None
    serial_number: Text | None = None
    product_instance_uri: Text | None = None
    location: Text | None = None
    year_of_construction: int | None = Field(default=None, ge=1900, le=2200)


class ProbePlate(StrictModel):
    """Plate of the touch probe. OPC UA clients find it if the node set of OPC 40210 or OPC 40505 is loaded; what is not
    given is not shown."""

    manufacturer: Text | None = None
    model: Text | None = None
    serial_number: Text | None = None


class OpcUaSettings(StrictModel):
    """Settings of the OPC UA server.

    `trusted_clients` is the directory of the client certificates (DER or PEM); by default it is ``opcua/trusted`` in
    the state directory. If `anonymous_reading` is true, anonymous clients may read, hold and abort. `node_sets` is the
    directory of the node sets of the companion specifications; by default those shipped with volcal are loaded.
    `further_node_sets` are files of node sets that are loaded in addition, such as that of OPC 40210.
    `calibration_interval_days` is the time in days after which the operator of the machine wants a new calibration; it
    is shown only if the node set of OPC 40210 is loaded.
    """

    enabled: bool = False
    host: Annotated[str, AfterValidator(_address)] = "127.0.0.1"
    port: int = Field(default=4840, ge=1, le=65535)
    trusted_clients: Path | None = None
    anonymous_reading: bool = False
    node_sets: Path | None = None
    further_node_sets: tuple[Path, ...] = ()
    calibration_interval_days: float | None = Field(default=None, gt=0, le=3650)
    identification: IdentificationPlate = IdentificationPlate()
    probe: ProbePlate = ProbePlate()

    def resolved(self, base: Path) -> OpcUaSettings:
        """Return these settings with relative paths resolved against the directory `base`."""
        paths = {"trusted_clients": self.trusted_clients, "node_sets": self.node_sets}
        resolved = {name: (base / path).resolve() for name, path in paths.items() if path is not None}
        further = tuple((base / path).resolve() for path in self.further_node_sets)
        return self.model_copy(update={**resolved, "further_node_sets": further})
