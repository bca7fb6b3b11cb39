"""Tests of the options of driver plugins: renamed keys are refused in files and translated in stored documents."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import ClassVar

import pytest
from pydantic import BaseModel, Field

from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.runs.origin import read_origin
from drivers.canopen_mount.settings import CanopenMountSettings
from drivers.clock import VirtualClock
from drivers.console_operator.plugin import ConsoleOperatorSettings
from drivers.errors import ConfigurationError
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.modbus_cnc.settings import ModbusCncSettings
from drivers.options import DriverOptions, find_former_key, rename_former_keys
from drivers.registry import check_options, current_options
from drivers.serial_cnc.settings import SerialCncSettings
from simulators.operator import SimulatedOperatorSettings

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "settings.md"
DRIVERS: dict[str, type[DriverOptions]] = {
    "modbus-cnc": ModbusCncSettings,
    "serial-cnc": SerialCncSettings,
    "linuxcnc": LinuxCncSettings,
    "canopen-mount": CanopenMountSettings,
    "console-operator": ConsoleOperatorSettings,
    "simulated-operator": SimulatedOperatorSettings,
}


class Inner(DriverOptions):
    former_keys: ClassVar[Mapping[str, str]] = {"way": "method"}
    method: str = "a"


class Outer(DriverOptions):
    former_keys: ClassVar[Mapping[str, str]] = {"largest": "maximum"}
    maximum: float = 1.0
    inner: Inner | None = None
    named: dict[str, float] = Field(default_factory=dict)


def renamed(kind: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield every former key of `kind` and its sections, with its current key."""
    if not issubclass(kind, DriverOptions):
        return
    for former, current in kind.former_keys.items():
        assert former not in kind.model_fields
        assert current in kind.model_fields
        yield f"{prefix}{former}", f"{prefix}{current}"
    for name, field in kind.model_fields.items():
        for annotation in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(annotation, type) and issubclass(annotation, BaseModel):
                yield from renamed(annotation, f"{prefix}{name}.")


def test_former_keys_are_replaced_at_every_depth_and_other_keys_are_left() -> None:
    stored = {"largest": 2.0, "inner": {"way": "b"}, "named": {"way": 1.0}}
    assert rename_former_keys(stored, Outer) == {"maximum": 2.0, "inner": {"method": "b"}, "named": {"way": 1.0}}


def test_the_first_former_key_is_found_with_its_path() -> None:
    assert find_former_key({"inner": {"way": "b"}}, Outer) == (("inner", "way"), "method")
    assert find_former_key({"maximum": 2.0, "inner": None, "named": {"way": 1.0}}, Outer) is None


@pytest.mark.parametrize(
    ("driver", "former", "current"),
    [(driver, *keys) for driver, kind in DRIVERS.items() for keys in renamed(kind)],
)
def test_a_former_key_is_refused_with_its_new_name(driver: str, former: str, current: str) -> None:
    *sections, key = former.split(".")
    options: dict[str, object] = {key: 1}
    for section in reversed(sections):
        options = {section: options}
    with pytest.raises(ConfigurationError, match=f"'{key}' has been renamed") as caught:
        check_options(driver, options, "cnc")
    assert caught.value.where["key"] == f"devices.cnc.options.{former}"
    assert f"write '{current.rpartition('.')[2]}' instead" in caught.value.hint


def test_the_settings_page_lists_every_renamed_option() -> None:
    text = PAGE.read_text(encoding="utf-8").split("\n## Renamed options of drivers\n", 1)[1]
    rows = [[cell.strip(" `") for cell in line.strip("|").split("|")] for line in text.splitlines() if "| `" in line]
    assert sorted(map(tuple, rows)) == sorted(
        (driver, *keys) for driver, kind in DRIVERS.items() for keys in renamed(kind)
    )


def test_options_of_a_driver_that_is_not_installed_are_left_as_stored() -> None:
    assert current_options("no-such-driver", {"watch_s": 1.0}) == {"watch_s": 1.0}


def test_a_run_stored_by_an_earlier_version_is_read_with_its_driver_options(tmp_path: Path) -> None:
    role = dict.fromkeys(("machine", "probe", "store", "thermometer", "mount", "operator"), "cnc")
    stored = {
        "machine": "machine.toml",
        "artefact": "bar.toml",
        "stations": {"places_mm": [[0.0, 0.0, 0.0]]},
        "roles": role,
        "gates": {"largest_chi2": 3.0},
        "devices": {
            "cnc": {"driver": "linuxcnc", "options": {"watch_s": 1.0, "compensation": {"way": "comp-files"}}},
            "operator": {"driver": "console-operator"},
        },
    }
    journal = Journal(tmp_path)
    run = journal.start_run("run-1", "verify", stored, "1.0", VirtualClock())
    start = {"at": "2026-01-01T00:00:00+00:00", "start_mm": [0.0, 0.0, 0.0]}
    run.origin({"kind": "verify", "options": {}, "base": str(tmp_path), "files": {}, **start})
    run.begun()
    journal.close()
    with open_journal(tmp_path) as reader:
        settings = read_origin(reader, 1).settings
    assert settings.gates.max_chi2 == 3.0
    assert settings.devices["cnc"].options == {"watchdog_timeout_s": 1.0, "compensation": {"method": "comp-files"}}
    assert settings.devices["operator"].options == {}
