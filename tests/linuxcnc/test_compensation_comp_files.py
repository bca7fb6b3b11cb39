"""Tests of screw-compensation files in a running stock LinuxCNC, which is restarted to activate a bank."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from compensation_rig import Controller, compile_components, machine, smooth_table, trilinear, unavailable_reason
from requirements import skip_if_missing

from drivers.clock import RealClock
from drivers.errors import ChecksumMismatch, StoreError
from drivers.linuxcnc.compensation import CompensationSettings, LinuxCncStore, create_store
from drivers.roles import Activation, CompensationStore, TableImage

pytestmark = skip_if_missing(unavailable_reason())

WHOLE = smooth_table(3)
ACCEPTED_UM = 100.0


def own_axis_table() -> TableImage:
    """Return a table in which the correction of each axis depends only on its own position."""
    counts = np.zeros((9, 6, 5, 3), dtype=np.int32)
    for axis, along in enumerate(([40, -10, 25, 60, 0, -33, 12, 90, 7], [5, 80, -60, 11, 0, 43], [9, 3, -70, 44, 1])):
        shape = [1, 1, 1]
        shape[axis] = -1
        counts[..., axis] = np.array(along).reshape(shape)
    return TableImage((0.0, 0.0, 0.0), (100.0, 80.0, 80.0), 1e-4, counts)


OWN = own_axis_table()


class Rig:
    """LinuxCNC that can be restarted."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self.start()

    def start(self) -> None:
        self.controller = Controller(self.work)
        self.store = self.store_accepting(0.0)
        self.controller.ready()

    def restart(self) -> None:
        self.controller.kill()
        self.start()

    def store_accepting(self, loss_um: float) -> LinuxCncStore:
        settings = CompensationSettings(method="comp-files", directory=Path("tables"), accepted_loss_um=loss_um)
        return create_store(settings, self.controller, RealClock(), base_path=self.work, device="linuxcnc")

    def shift_at(self, *place_mm: float) -> np.ndarray:
        """Move there, and return the correction added to the motors at rest."""
        self.controller.at(*place_mm)
        return self.controller.motor() - np.array([self.controller.get(f"joint.{n}.pos-cmd") for n in range(3)])


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    work = machine(
        tmp_path_factory.mktemp("machine") / "work",
        compile_components(tmp_path_factory.mktemp("components")),
        "comp-files",
    )
    made = Rig(work)
    yield made
    made.controller.kill()


def test_table_is_active_from_the_next_start_with_its_sign(rig: Rig) -> None:
    """Checked on nodes, between nodes, and beyond the ends, where the last value holds."""
    assert isinstance(rig.store, CompensationStore)
    assert rig.store.store_limits().activation is Activation.POWER_CYCLE
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (0, None)
    rig.store.stage(1, OWN)
    rig.store.activate(1)
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (0, 1)
    assert rig.shift_at(293.0, 164.0, 133.0) == pytest.approx(np.zeros(3), abs=1e-9)
    rig.restart()
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (1, None)
    for place in [(293.0, 164.0, 133.0), (100.0, 240.0, 80.0), (799.0, 399.0, 319.0), (-20.0, -30.0, -40.0)]:
        assert rig.shift_at(*place) == pytest.approx(trilinear(OWN, np.array([place]))[0], abs=1e-8)
    read = rig.store.read_table(1)
    assert read is not None
    assert read.same_as(OWN)
    assert all(finding.ok for finding in rig.store.diagnose())


def test_table_with_too_large_a_loss_is_refused(rig: Rig) -> None:
    with pytest.raises(StoreError, match=r"\d\d\.\d µm of this table would be lost"):
        rig.store.stage(2, WHOLE)
    assert rig.store.read_table(2) is None


def test_accepted_loss_leaves_the_mean_along_each_axis(rig: Rig) -> None:
    store = rig.store_accepting(ACCEPTED_UM)
    store.stage(2, WHOLE)
    read = store.read_table(2)
    assert read is not None
    assert read.same_as(WHOLE)
    store.activate(2)
    rig.restart()
    values = WHOLE.counts * 1e-4
    place = (240.0, 160.0, 80.0)  # node 3, 2, 1
    mean = [values[3, :, :, 0].mean(), values[:, 2, :, 1].mean(), values[:, :, 1, 2].mean()]
    assert rig.shift_at(*place) == pytest.approx(mean, abs=1e-8)
    assert any("have no effect" in finding.text for finding in rig.store.diagnose())


def test_active_and_pending_banks_are_not_written(rig: Rig) -> None:
    """After the previous test bank 2 is active; here bank 1 becomes pending."""
    rig.store.activate(1)
    for bank in (1, 2):
        with pytest.raises(StoreError, match="active"):
            rig.store.stage(bank, OWN)
    rig.store.activate(2)
    assert rig.store.pending_bank() is None


@pytest.mark.parametrize("name", ["x.comp", "z.comp", "bank.hal", "../bank1.table"])
def test_bank_with_a_half_written_file_is_not_activated(rig: Rig, name: str) -> None:
    rig.store.stage(1, OWN)
    file = rig.work / "tables" / "bank1" / name
    file.write_text(file.read_text()[:-20])
    with pytest.raises(StoreError):
        rig.store.activate(1)
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (2, None)


def test_exchanged_active_table_is_detected(rig: Rig) -> None:
    tables = rig.work / "tables"
    rig.store.stage(1, OWN)
    whole = (tables / "bank2.table").read_text()
    (tables / "bank2.table").write_text((tables / "bank1.table").read_text())
    with pytest.raises(ChecksumMismatch):
        rig.store.read_table(2)
    assert [finding.ok for finding in rig.store.diagnose()] == [False]
    (tables / "bank2.table").write_text(whole)


def test_power_cut_between_the_files_leaves_the_former_bank(rig: Rig) -> None:
    """Only the link `acting` selects the bank; a new link not yet renamed to that name has no effect."""
    tables = rig.work / "tables"
    (tables / "bank1" / "x.comp").write_text("0 0")
    (tables / "acting.part").unlink(missing_ok=True)
    (tables / "acting.part").symlink_to("bank1")
    rig.restart()
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (2, None)
    rig.store.activate(0)
    assert (rig.store.active_bank(), rig.store.pending_bank()) == (2, 0)
