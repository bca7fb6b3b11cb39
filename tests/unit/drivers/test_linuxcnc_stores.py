"""Tests of the LinuxCNC stores with a faulty loader and faulty signals; tests/linuxcnc uses a real LinuxCNC."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drivers.clock import VirtualClock
from drivers.errors import ChecksumMismatch, CommandRejected, DeadlineExpired, LinkLost, StoreError
from drivers.linuxcnc.compensation import CompensationSettings, LinuxCncStore, create_store
from drivers.linuxcnc.compensation.comp_files import own_axis_part
from drivers.linuxcnc.pins import PinValue
from drivers.roles import TableImage
from drivers.tables.text import counts_crc32, parse_table

TABLE = TableImage((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 1e-4, np.arange(24, dtype=np.int32).reshape(2, 2, 2, 3))


class Loader:
    """Loader `volcal_tables` with the pins documented on its page. `faults` change single answers."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.pins: dict[str, PinValue] = dict.fromkeys(
            ("load-done", "arm-done", "load-result", "arm-result", "bank", "acting-bank", "acting-crc"), 0
        )
        self.pins |= {"acting-fault": 0, "armed-bank": 0, "armed-nonce": 0, "bank1-state": 0, "bank2-state": 0}
        self.pins |= {
            "bank1-crc": 0,
            "bank2-crc": 0,
            "settled": True,
            "acting": True,
            "table-lost": False,
            "limited": False,
        }
        self.pins |= {"age": 0.0, "beat": 0}
        self.spoilt: dict[str, PinValue] = {}
        self.beats = True
        self.gone = False

    def get(self, name: str) -> PinValue:
        if self.gone:
            raise LinkLost("LinuxCNC has ended")
        pin = name.removeprefix("volcal-tables.")
        if pin not in self.pins:
            raise CommandRejected("no such pin", pin=name)
        if pin == "beat" and self.beats:
            self.pins["beat"] = int(self.pins["beat"]) + 1
        return self.spoilt.get(pin, self.pins[pin])

    def set(self, name: str, value: PinValue) -> None:
        pin = name.removeprefix("volcal-tables.")
        self.pins[pin] = value
        if pin == "load-sequence":
            self._load(int(self.pins["load-bank"]))
            self.pins["load-done"] = value
        elif pin == "arm-sequence":
            self.pins |= {"armed-bank": self.pins["arm-bank"], "armed-nonce": 77, "arm-done": value}
        elif pin == "confirm-nonce" and value == self.pins["armed-nonce"]:
            self.pins |= {"bank": self.pins["armed-bank"], "acting-bank": self.pins["armed-bank"], "armed-nonce": 0}

    def _load(self, bank: int) -> None:
        table = parse_table((self.directory / f"bank{bank}.table").read_text())
        self.pins |= {f"bank{bank}-state": 1, f"bank{bank}-crc": counts_crc32(table.counts)}


@pytest.fixture
def loader(tmp_path: Path) -> Loader:
    return Loader(tmp_path)


@pytest.fixture
def store(loader: Loader, tmp_path: Path) -> LinuxCncStore:
    settings = CompensationSettings(method="kinematics", directory=Path())
    return create_store(settings, loader, VirtualClock(), base_path=tmp_path, device="cnc")


def test_table_is_staged_activated_and_deactivated(store: LinuxCncStore) -> None:
    store.stage(1, TABLE)
    store.activate(1)
    assert store.active_bank() == 1
    store.activate(0)
    assert store.active_bank() == 0


def test_missing_component_is_reported_with_a_hint(loader: Loader, store: LinuxCncStore) -> None:
    del loader.pins["acting-fault"]
    with pytest.raises(StoreError, match=r"volcal-tables\.acting-fault.*HAL file"):
        store.active_bank()


def test_lost_link_stays_a_lost_link(loader: Loader, store: LinuxCncStore) -> None:
    loader.gone = True
    with pytest.raises(LinkLost):
        store.activate(0)


@pytest.mark.parametrize(
    ("spoilt", "error"),
    [
        ({"load-result": 6}, StoreError),
        ({"load-result": 5}, ChecksumMismatch),
        ({"load-result": 99}, StoreError),
        ({"load-done": 12345}, DeadlineExpired),
        ({"bank1-crc": 1}, ChecksumMismatch),
        ({"bank1-state": 2}, ChecksumMismatch),
        ({"bank1-state": 0}, StoreError),
    ],
)
def test_loader_with_another_table_is_detected(
    loader: Loader, store: LinuxCncStore, spoilt: dict[str, PinValue], error: type[Exception]
) -> None:
    loader.spoilt = spoilt
    with pytest.raises(error):
        store.stage(1, TABLE)


@pytest.mark.parametrize(
    ("spoilt", "error"),
    [
        ({"arm-result": 7}, StoreError),
        ({"arm-result": 5}, ChecksumMismatch),
        ({"armed-nonce": 0}, StoreError),
        ({"armed-bank": 2}, StoreError),
        ({"bank": 0}, DeadlineExpired),
        ({"acting-bank": 0}, DeadlineExpired),
        ({"settled": False}, DeadlineExpired),
        ({"acting-fault": 3}, StoreError),
        ({"acting-fault": 1}, StoreError),
    ],
)
def test_activation_without_effect_is_an_error(
    loader: Loader, store: LinuxCncStore, spoilt: dict[str, PinValue], error: type[Exception]
) -> None:
    store.stage(1, TABLE)
    loader.spoilt = spoilt
    with pytest.raises(error):
        store.activate(1)


def test_bank_is_active_though_the_machine_is_off(loader: Loader, store: LinuxCncStore) -> None:
    store.stage(1, TABLE)
    loader.spoilt = {"settled": False, "acting": False}
    store.activate(1)
    assert "not applied" in store.diagnose()[0].text


def test_selected_bank_is_not_written(loader: Loader, store: LinuxCncStore) -> None:
    loader.spoilt = {"bank": 2}
    with pytest.raises(StoreError, match="active"):
        store.stage(2, TABLE)
    assert not (loader.directory / "bank2.table").exists()


def test_held_correction_is_not_a_bank(loader: Loader, store: LinuxCncStore) -> None:
    loader.spoilt = {"acting-fault": 3}
    with pytest.raises(StoreError, match="held"):
        store.active_bank()
    assert [finding.ok for finding in store.diagnose()] == [False]


class Signals:
    """Pins with the two signals of `bank.hal`."""

    def __init__(self) -> None:
        self.values: dict[str, PinValue] = {"volcal-comp-bank": 0, "volcal-comp-crc": 0}

    def get(self, name: str) -> PinValue:
        if name not in self.values:
            raise CommandRejected("no such signal", pin=name)
        return self.values[name]

    def set(self, name: str, value: PinValue) -> None:
        raise AssertionError(f"a store of files sets {name} to {value}")


@pytest.fixture
def signals() -> Signals:
    return Signals()


@pytest.fixture
def files(signals: Signals, tmp_path: Path) -> LinuxCncStore:
    settings = CompensationSettings(method="comp-files", directory=tmp_path, accepted_loss_um=10.0)
    return create_store(settings, signals, VirtualClock(), base_path=tmp_path, device="cnc")


def test_unprepared_directory_is_reported(files: LinuxCncStore, signals: Signals, tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="no link"):
        files.pending_bank()
    (tmp_path / "acting").symlink_to("elsewhere")
    with pytest.raises(StoreError, match="not a bank"):
        files.pending_bank()
    (tmp_path / "acting").unlink()
    (tmp_path / "acting").symlink_to("bank1")
    with pytest.raises(StoreError, match="bank0"):
        files.activate(0)
    signals.values.clear()
    with pytest.raises(StoreError, match="volcal-comp-bank"):
        files.active_bank()
    assert [finding.ok for finding in files.diagnose()] == [False]


def test_unknown_or_empty_bank_is_refused(files: LinuxCncStore, tmp_path: Path) -> None:
    (tmp_path / "acting").symlink_to("bank0")
    for bank in (1, 9):
        with pytest.raises(StoreError):
            files.activate(bank)
    with pytest.raises(StoreError):
        files.stage(0, TABLE)


def test_files_hold_nominal_minus_correction(files: LinuxCncStore, tmp_path: Path) -> None:
    """LinuxCNC adds nominal minus position. A single node along X gives two rows, as LinuxCNC needs an interval."""
    (tmp_path / "acting").symlink_to("bank0")
    counts = np.array([[[[50, -20, 7]], [[50, 30, 7]]]], dtype=np.int32)
    files.stage(1, TableImage((5.0, 1.0, 2.0), (1.0, 4.0, 1.0), 1e-4, counts))
    rows = {axis: (tmp_path / "bank1" / f"{axis}.comp").read_text().split("\n") for axis in "xy"}
    assert rows["x"][:2] == ["5.000000000 4.995000000 4.995000000", "6.000000000 5.995000000 5.995000000"]
    assert rows["y"][:2] == ["1.000000000 1.002000000 1.002000000", "5.000000000 4.997000000 4.997000000"]


def test_what_is_read_of_the_active_bank_is_what_linuxcnc_adds(
    files: LinuxCncStore, signals: Signals, tmp_path: Path
) -> None:
    """A run subtracts from its measurements what it has read."""
    (tmp_path / "acting").symlink_to("bank0")
    counts = np.random.default_rng(1).integers(-40, 40, (4, 3, 2, 3)).astype(np.int32)
    whole = TableImage((5.0, 1.0, 2.0), (10.0, 4.0, 7.0), 1e-4, counts)
    files.stage(1, whole)
    held = files.read_table(1)
    assert held is not None and held.same_as(whole)  # what was staged, until it is active
    signals.values |= {"volcal-comp-bank": 1, "volcal-comp-crc": counts_crc32(counts)}
    active = files.read_table(1)
    assert active is not None and active.origin_mm == whole.origin_mm
    for axis, name in enumerate("xyz"):
        nominal, position, _ = np.loadtxt(tmp_path / "bank1" / f"{name}.comp").T
        added = np.moveaxis(1e-4 * active.counts[..., axis], axis, -1)
        assert np.abs(added - (nominal - position)).max() <= 0.5e-4 + 1e-9
    assert np.abs(active.counts - counts).max() > 10
    assert any("have no effect" in finding.text for finding in files.diagnose())


def test_loss_is_the_largest_remainder_of_the_mean() -> None:
    counts = np.zeros((2, 3, 1, 3), dtype=np.int32)
    counts[1, :, 0, 0] = [10, 20, 60]
    part = own_axis_part(TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-3, counts))
    assert part.correction_mm[0] == pytest.approx([0.0, 0.030])
    assert part.lost_mm == pytest.approx(0.030)
