"""Reader of a drive's electronic data sheet, the EDS file of CiA 306.

The file is optional. The reader takes the identity of the drive from the file and checks that all required objects are
listed.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from canopen.objectdictionary import INTEGER_TYPES, ObjectDictionary, import_od

from drivers.canopen_mount.objects import READ, WRITTEN, WRITTEN_FOR_HOMING, DriveObject
from drivers.canopen_mount.settings import AxisSettings
from drivers.errors import ConfigurationError


@dataclass(frozen=True)
class DriveDescription:
    """Contents of the EDS file of a drive; they are empty if the settings name no file."""

    dictionary: ObjectDictionary
    vendor_id: int | None = None
    product_code: int | None = None

    def with_identity(self, settings: AxisSettings) -> AxisSettings:
        """Return a copy of `settings` in which a missing vendor id or product code is taken from the EDS file."""
        found = {"vendor_id": self.vendor_id, "product_code": self.product_code}
        missing = {name: value for name, value in found.items() if value and getattr(settings, name) is None}
        return settings.model_copy(update=missing)


def load_description(settings: AxisSettings, base_path: Path) -> DriveDescription:
    """Load the EDS file that the settings name; return an empty description if they name none.

    Raises ConfigurationError if the file cannot be read, or if a required object is missing, is not writable although
    the driver writes it, or has a different size. The error names the file and the object.
    """
    if settings.eds is None:
        return DriveDescription(ObjectDictionary())  # type: ignore[no-untyped-call]
    path = base_path / settings.eds
    try:
        dictionary = import_od(str(path), settings.node_id)
    except Exception as error:  # a broken file may cause configparser, struct, key or value errors
        raise ConfigurationError(
            f"the EDS file cannot be read: {error}",
            file=str(path),
            hint="use the EDS file from the drive's manufacturer",
        ) from error
    _require_objects(dictionary, settings, path)
    identity = dictionary.device_information
    return DriveDescription(dictionary, identity.vendor_number, identity.product_number)


def _require_objects(dictionary: ObjectDictionary, settings: AxisSettings, path: Path) -> None:
    written = WRITTEN if settings.homing is None else (*WRITTEN, *WRITTEN_FOR_HOMING)
    for entry in (*READ, *written):
        variable = dictionary.get_variable(entry.index, entry.subindex)
        if variable is None:
            raise _unusable("the EDS file does not list", entry, path)
        if entry in written and not variable.writable:
            raise _unusable(f"the EDS file lists as {variable.access_type} what must be written:", entry, path)
        if variable.data_type in INTEGER_TYPES and len(variable) != 8 * entry.size:
            raise _unusable(f"the EDS file gives {len(variable)} bits to", entry, path)


def _unusable(what: str, entry: DriveObject, path: Path) -> ConfigurationError:
    return ConfigurationError(
        f"{what} {entry}",
        file=str(path),
        object=f"0x{entry.index:04X}:{entry.subindex:02X}",
        hint="use the EDS file of this drive, which must support profile position mode, and homing if configured",
    )
