"""The optional EDS file of a drive (CiA 306): its identity, and proof that it has the objects needed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from canopen.objectdictionary import ObjectDictionary, import_od

from drivers.canopen_mount.objects import NEEDED
from drivers.canopen_mount.settings import AxisSettings
from drivers.errors import ConfigurationError


@dataclass(frozen=True)
class DriveDescription:
    """What the EDS says, or nothing at all when there is none."""

    dictionary: ObjectDictionary
    vendor_id: int | None = None
    product_code: int | None = None

    def completed(self, settings: AxisSettings) -> AxisSettings:
        """The settings with the identity of the EDS where they state none."""
        found = {"vendor_id": self.vendor_id, "product_code": self.product_code}
        missing = {name: value for name, value in found.items() if value and getattr(settings, name) is None}
        return settings.model_copy(update=missing)


def load_description(settings: AxisSettings, base_path: Path) -> DriveDescription:
    """Raises ConfigurationError naming the file when it cannot be read or lacks a needed object."""
    if settings.eds is None:
        return DriveDescription(ObjectDictionary())  # type: ignore[no-untyped-call]
    path = base_path / settings.eds
    try:
        dictionary = import_od(str(path), settings.node_id)
    except Exception as error:  # configparser, struct, key and value errors: whatever a broken file provokes
        raise ConfigurationError(
            f"the EDS file cannot be read: {error}",
            file=str(path),
            hint="take the EDS file of the drive's maker",
        ) from error
    missing = [str(entry) for entry in NEEDED if dictionary.get_variable(entry.index, entry.subindex) is None]
    if missing:
        raise ConfigurationError(
            f"the EDS file lists no {', '.join(missing)}",
            file=str(path),
            hint="the drive must support CiA 402 profile position mode",
        )
    identity = dictionary.device_information
    return DriveDescription(dictionary, identity.vendor_number, identity.product_number)
