"""Tests of external offsets and of our kinematics in a running stock LinuxCNC, by the commands to the motors."""

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

ONE, TWO = smooth_table(1), smooth_table(2)
REST_MM = {"external-offsets": 1e-6, "kinematics": 1e-9}
MOTION_MM = {"external-offsets": 8e-5, "kinematics": 4e-6}
"""Largest distance in mm of the path from the programmed line after removing the correction, at 30 m/min."""
JUMP_MM_PER_S = 0.5
PLACE = (93.0, 64.0, 53.0)

pytestmark = skip_if_missing(unavailable_reason())


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compile_components(tmp_path_factory.mktemp("components"))


def store_in(work: Path, controller: Controller, way: str) -> LinuxCncStore:
    settings = CompensationSettings.model_validate({"method": way, "directory": "tables"})
    return create_store(settings, controller, RealClock(), base_path=work, device="linuxcnc")


class Rig:
    """LinuxCNC with one compensation method, which can be stopped and started again."""

    def __init__(self, work: Path, way: str) -> None:
        self.way = way
        self.work = work
        self.start()

    def start(self) -> None:
        self.controller = Controller(self.work)
        self.store = store_in(self.work, self.controller, self.way)
        self.controller.ready()

    def cut_power(self) -> None:
        self.controller.kill()

    def shift(self) -> np.ndarray:
        """Return the correction presently added to the commanded position."""
        return self.controller.motor() - self.controller.displayed()

    def settle(self) -> None:
        """Wait until the bank is active and settled, and LinuxCNC's planner of the offset has finished too."""
        assert self.controller("wait", "volcal-tables.settled", True)
        assert self.controller("mdi", "G4 P0.03")


@pytest.fixture(scope="module", params=["external-offsets", "kinematics"])
def rig(request: pytest.FixtureRequest, build: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Rig]:
    made = Rig(machine(tmp_path_factory.mktemp("machine") / "work", build, request.param), request.param)
    yield made
    made.controller.kill()


@pytest.fixture
def fresh(rig: Rig) -> Rig:
    """Rig with the machine on and homed, ONE in bank 1, TWO in bank 2, and no active bank."""
    rig.controller.ready()
    rig.store.activate(0)
    rig.store.stage(1, ONE)
    rig.store.stage(2, TWO)
    return rig


def expected(table: TableImage, *positions_mm: tuple[float, float, float]) -> np.ndarray:
    return trilinear(table, np.array(positions_mm))


def test_it_is_a_store_with_two_banks(fresh: Rig) -> None:
    assert isinstance(fresh.store, CompensationStore)
    limits = fresh.store.store_limits()
    assert (limits.banks, limits.activation) == ((1, 2), Activation.IMMEDIATE)
    read = fresh.store.read_table(2)
    assert read is not None
    assert read.same_as(TWO)
    assert (fresh.store.active_bank(), fresh.store.pending_bank(), fresh.store.read_table(0)) == (0, None, None)
    assert all(finding.ok for finding in fresh.store.diagnose())


def test_motors_are_at_the_commanded_position_plus_table(fresh: Rig) -> None:
    """Corrections are added, with the right sign: inside cells, on nodes, at the border and beyond it."""
    places = [PLACE, (160.0, 80.0, 80.0), (131.0, 0.5, 119.0), (-20.0, 99.0, -20.0)]
    fresh.store.activate(1)
    for place in places:
        fresh.controller.at(*place)
        assert fresh.controller.displayed() == pytest.approx(place, abs=1e-9)
        assert fresh.shift() == pytest.approx(expected(ONE, place)[0], abs=REST_MM[fresh.way])
    fresh.store.activate(0)
    fresh.settle()
    assert fresh.shift() == pytest.approx(np.zeros(3), abs=REST_MM[fresh.way])


def test_path_is_a_line_after_removing_the_table(fresh: Rig) -> None:
    start, end = np.array([0.5, 199.0, 5.0]), np.array([360.0, 20.0, 140.0])
    fresh.store.activate(1)
    fresh.controller.at(*start)
    fresh.controller.start_sampling()
    assert fresh.controller("mdi", "G53 G1 F30000 X360 Y20 Z140")
    motor = fresh.controller.samples()[:, :3]
    assert np.linalg.norm(np.diff(motor, axis=0), axis=1).max() > 0.49
    nominal = motor.copy()
    for _ in range(8):
        nominal = motor - trilinear(ONE, nominal)
    along = (end - start) / np.linalg.norm(end - start)
    assert off_line(nominal - start, along) < MOTION_MM[fresh.way]
    assert off_line(motor - start, along) > 0.001


def off_line(points: np.ndarray, along: np.ndarray) -> float:
    return float(np.linalg.norm(points - (points @ along)[:, None] * along, axis=1).max())


def test_banks_are_switched_live_and_no_faster_than_the_jump_rate(fresh: Rig) -> None:
    fresh.controller.at(*PLACE)
    fresh.store.activate(1)
    fresh.controller.start_sampling()
    fresh.store.activate(2)
    fresh.settle()
    assert fresh.shift() == pytest.approx(expected(TWO, PLACE)[0], abs=REST_MM[fresh.way])
    speed = np.abs(np.diff(fresh.controller.samples()[:, :3], axis=0)).max() / 1e-3
    assert 0.01 < speed < JUMP_MM_PER_S * 1.05


def test_bank_switched_in_motion_does_not_disturb_it(fresh: Rig) -> None:
    fresh.controller.at(10.0, 10.0, 10.0)
    fresh.controller("start", "G53 G1 F15000 X260 Y160 Z130")
    fresh.store.activate(1)
    assert fresh.controller("wait", "motion.in-position", True)
    fresh.settle()
    assert fresh.controller.displayed() == pytest.approx([260.0, 160.0, 130.0], abs=1e-9)
    assert fresh.shift() == pytest.approx(expected(ONE, (260.0, 160.0, 130.0))[0], abs=REST_MM[fresh.way])
    assert fresh.controller("messages") == []


@pytest.mark.parametrize("how", ["off", "estop"])
def test_machine_off_and_on_never_jumps_and_corrects_again(fresh: Rig, how: str) -> None:
    fresh.controller.at(*PLACE)
    fresh.store.activate(1)
    fresh.settle()
    before = fresh.controller.motor()
    fresh.controller.start_sampling()
    fresh.controller(how)
    assert fresh.controller.motor() == pytest.approx(before, abs=1e-6)
    assert fresh.store.active_bank() == 1
    assert fresh.controller("on")
    fresh.settle()
    fastest = np.abs(np.diff(fresh.controller.samples()[:, :3], axis=0)).max() / 1e-3
    assert fastest < JUMP_MM_PER_S * 1.05
    assert fresh.shift() == pytest.approx(trilinear(ONE, fresh.controller.displayed()[None])[0], abs=REST_MM[fresh.way])


def test_offset_cut_off_at_an_axis_limit_is_reported_and_restored(fresh: Rig) -> None:
    """LinuxCNC cuts off external offsets at a soft limit; it does not check our kinematics."""
    outward = TableImage((0.0, 0.0, 0.0), (1000.0,) * 3, 1e-4, np.full((2, 2, 2, 3), -150, dtype=np.int32))
    fresh.store.stage(2, outward)
    fresh.controller.at(-100.0, 10.0, 10.0)
    fresh.store.activate(2)
    fresh.settle()
    cut_off = fresh.way == "external-offsets"
    assert fresh.shift() == pytest.approx([0.0 if cut_off else -0.015, -0.015, -0.015], abs=REST_MM[fresh.way])
    assert all(finding.ok for finding in fresh.store.diagnose()) is not cut_off
    fresh.controller.at(-90.0, 10.0, 10.0)
    assert fresh.shift() == pytest.approx([-0.015] * 3, abs=REST_MM[fresh.way])
    assert all(finding.ok for finding in fresh.store.diagnose())


def test_active_bank_is_not_written(fresh: Rig) -> None:
    fresh.store.activate(1)
    with pytest.raises(StoreError, match="active"):
        fresh.store.stage(1, TWO)
    load(fresh, 1)
    assert fresh.controller("wait", "volcal-tables.load-result", 2)
    read = fresh.store.read_table(1)
    assert read is not None
    assert read.same_as(ONE)


def test_confirmation_without_the_nonce_changes_nothing(fresh: Rig) -> None:
    fresh.store.activate(1)
    fresh.controller.set("volcal-tables.arm-bank", 2)
    fresh.controller.set("volcal-tables.arm-crc", fresh.controller.get("volcal-tables.bank2-crc"))
    fresh.controller.set("volcal-tables.arm-sequence", fresh.controller.get("volcal-tables.arm-done") + 1)
    assert fresh.controller("wait", "volcal-tables.armed-bank", 2)
    fresh.controller.set("volcal-tables.confirm-nonce", fresh.controller.get("volcal-tables.armed-nonce") ^ 2)
    fresh.controller.at(60.0, 60.0, 60.0)
    assert fresh.store.active_bank() == 1


def test_arming_with_another_crc_is_refused(fresh: Rig) -> None:
    """The file changed after it was loaded: neither the file nor the table in memory becomes active."""
    other = (fresh.work / "tables" / "bank1.table").read_text()
    (fresh.work / "tables" / "bank2.table").write_text(other)
    with pytest.raises(ChecksumMismatch):
        fresh.store.activate(2)
    assert fresh.store.active_bank() == 0


def cut(text: str) -> str:
    return text[: len(text) // 2]


def flipped(text: str) -> str:
    at = text.index("\n", len(text) // 2) - 1
    return text[:at] + str((int(text[at]) + 1) % 10) + text[at + 1 :]


def test_wrong_file_empties_its_bank_and_keeps_the_active_one(fresh: Rig) -> None:
    fresh.store.activate(1)
    file = fresh.work / "tables" / "bank2.table"
    good = file.read_text()
    for spoilt in (cut(good), flipped(good), "", good.replace("nodes 11", "nodes 12")):
        file.write_text(spoilt)
        load(fresh, 2)
        assert fresh.controller("wait", "volcal-tables.bank2-state", 0)
        assert fresh.store.read_table(2) is None
        with pytest.raises(StoreError):
            fresh.store.activate(2)
        fresh.store.stage(2, TWO)
    assert fresh.store.active_bank() == 1
    fresh.settle()
    place = fresh.controller.displayed()[None]
    assert fresh.shift() == pytest.approx(trilinear(ONE, place)[0], abs=REST_MM[fresh.way])


def load(rig: Rig, bank: int) -> None:
    """Request a load directly from the loader, without the store."""
    rig.controller.set("volcal-tables.load-bank", bank)
    rig.controller.set("volcal-tables.load-sequence", rig.controller.get("volcal-tables.load-done") + 1)


def test_table_damaged_in_memory_holds_its_last_correction_and_stops_the_feed(fresh: Rig) -> None:
    fresh.controller.at(*PLACE)
    fresh.store.activate(1)
    fresh.settle()
    held = fresh.shift()
    fresh.controller("damage_table", 1, 100)
    assert fresh.controller("wait", "volcal-tables.acting-fault", 3, "motion.feed-inhibit", True)
    assert fresh.shift() == pytest.approx(held, abs=REST_MM[fresh.way])
    with pytest.raises(StoreError, match="damaged"):
        fresh.store.active_bank()
    assert not all(finding.ok for finding in fresh.store.diagnose())
    fresh.store.activate(0)
    assert fresh.store.active_bank() == 0
    fresh.settle()
    assert fresh.shift() == pytest.approx(np.zeros(3), abs=REST_MM[fresh.way])


def test_active_bank_is_restored_after_a_power_cut(fresh: Rig) -> None:
    """Meanwhile the other bank's file is half-written, both under its own name and under its temporary name."""
    fresh.store.activate(1)
    assert fresh.controller("wait", "volcal-tables.settled", True)
    tables = fresh.work / "tables"
    await_text(fresh, tables / "active-bank", "bank 1\n")
    without_loader(fresh)
    half = cut((tables / "bank2.table").read_text())
    fresh.cut_power()
    (tables / "bank2.table.part").write_text(half)
    (tables / "bank2.table").write_text(half)
    (tables / "active-bank.part").write_text("volcal-act")
    fresh.start()
    fresh.controller.at(*PLACE)
    assert fresh.store.active_bank() == 1
    assert fresh.store.read_table(2) is None
    assert fresh.shift() == pytest.approx(expected(ONE, PLACE)[0], abs=REST_MM[fresh.way])


def without_loader(rig: Rig) -> None:
    """Kill the loader: the active table stays active and cannot be changed, and the store reports that."""
    rig.controller("run", "pkill", "-KILL", "-x", "volcal_tables")
    rig.controller.at(*PLACE)
    assert rig.shift() == pytest.approx(expected(ONE, PLACE)[0], abs=REST_MM[rig.way])
    settings = CompensationSettings.model_validate({"method": rig.way, "directory": "tables", "timeout_s": 0.3})
    store = create_store(settings, rig.controller, RealClock(), base_path=rig.work, device="linuxcnc")
    assert [finding.ok for finding in store.diagnose()] == [False]
    with pytest.raises(StoreError, match="no longer runs"):
        store.activate(0)


def test_lost_active_table_is_reported(fresh: Rig) -> None:
    fresh.store.activate(2)
    tables = fresh.work / "tables"
    await_text(fresh, tables / "active-bank", "bank 2\n")
    fresh.cut_power()
    (tables / "bank2.table").write_text((tables / "bank1.table").read_text())
    fresh.start()
    assert fresh.store.active_bank() == 0
    assert [finding.ok for finding in fresh.store.diagnose()] == [True, False]
    fresh.store.activate(1)
    assert all(finding.ok for finding in fresh.store.diagnose())


def await_text(rig: Rig, file: Path, text: str) -> None:
    """Wait for the text in a file; the loader writes the active bank within a few of its polls."""
    for _ in range(200):
        if file.is_file() and text in file.read_text():
            return
        rig.controller.get("volcal-tables.beat")
    raise AssertionError(f"{file.name} never said {text!r}")
