"""Tests of banks in files, and of their effect on a machine without tables of its own."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from serial_rig import rig

from drivers.errors import ChecksumMismatch, CommandRejected, StoreError
from drivers.roles import TableImage, Touch
from drivers.serial_cnc.store import MAX_SLOPE, Correction
from simulators.world.field import TableField

SHAPE = (5, 3, 4)
STEP = (1000.0, 650.0, 500.0)


def table(seed: int = 1, largest: int = 500) -> TableImage:
    """Return a table with corrections of up to 50 µm over the whole travel."""
    counts = np.random.default_rng(seed).integers(-largest, largest, (*SHAPE, 3)).astype(np.int32)
    return TableImage((0.0, 0.0, 0.0), STEP, 1e-4, counts)


positions = st.tuples(st.floats(-500.0, 5000.0), st.floats(-500.0, 2000.0), st.floats(-500.0, 2500.0))


class TestCorrection:
    @given(positions, st.integers(0, 50))
    def test_is_what_a_controller_with_the_table_adds(self, place: tuple[float, float, float], seed: int) -> None:
        expected = TableField(table(seed)).at_many(np.array([place]))[0]
        assert Correction(table(seed)).at(np.array(place)) == pytest.approx(expected, abs=1e-12)

    @given(positions, st.integers(0, 50))
    def test_is_removed_exactly(self, place: tuple[float, float, float], seed: int) -> None:
        correction = Correction(table(seed))
        displayed = np.array(place)
        assert correction.remove(correction.apply(displayed)) == pytest.approx(displayed, abs=1e-9)

    @settings(max_examples=20)
    @given(positions, st.integers(0, 20))
    def test_is_removed_at_the_largest_accepted_slope(self, place: tuple[float, float, float], seed: int) -> None:
        steep = TableImage((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1e-4, table(seed, round(MAX_SLOPE / 2e-4)).counts)
        correction = Correction(steep)
        assert correction.remove(correction.apply(np.array(place))) == pytest.approx(np.array(place), abs=1e-4)

    def test_single_plane_and_single_node(self) -> None:
        flat = TableImage((0.0, 0.0, 0.0), STEP, 1e-4, np.full((3, 1, 1, 3), 7, dtype=np.int32))
        assert Correction(flat).at(np.array([123.0, 50.0, -3.0])) == pytest.approx([7e-4] * 3)

    def test_without_a_table_nothing_is_added(self) -> None:
        assert not np.any(Correction(None).at(np.array([1.0, 2.0, 3.0])))


class TestActiveBank:
    def test_axes_move_and_the_displayed_position_does_not(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            grbl.device.stage(1, table())
            target = np.array([1234.5, 432.1, 765.4])
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=False)
            bare = grbl.world.controller.displayed_position()
            grbl.device.activate(1)
            grbl.device.move_to(target, feed_mm_per_s=None, guarded=False)
            moved = grbl.world.controller.displayed_position() - bare
            assert moved == pytest.approx(TableField(table()).at_many(np.array([target]))[0], abs=1.1e-3)
            assert grbl.device.position() == pytest.approx(target, abs=1.1e-3)

    def test_latch_is_displayed_as_for_a_corrected_program(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            centre = grbl.before()
            touched = grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
            grbl.device.move_to(centre - np.array([0.0, 25.0, 0.0]), feed_mm_per_s=None, guarded=True)
            grbl.device.stage(1, table())
            grbl.device.activate(1)
            corrected = grbl.device.touch_towards(centre, feed_mm_per_s=5.0)
            assert isinstance(touched, Touch)
            assert isinstance(corrected, Touch)
            sent = np.array(corrected.position_mm) + Correction(table()).at(np.array(corrected.position_mm))
            # The correction shifts the touch sideways, which does not change the touch along the normal of the ball.
            assert sent[1] == pytest.approx(touched.position_mm[1], abs=2e-3)
            assert abs(corrected.position_mm[1] - touched.position_mm[1]) > 5e-3

    def test_correction_never_leads_beyond_the_travel(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            outwards = np.full((*SHAPE, 3), -500, dtype=np.int32)
            grbl.device.stage(1, TableImage((0.0, 0.0, 0.0), STEP, 1e-4, outwards))
            grbl.device.activate(1)
            grbl.device.move_to(np.array([0.0, 0.0, 0.0]), feed_mm_per_s=None, guarded=True)
            assert grbl.world.controller.displayed_position() == pytest.approx([0.0, 0.0, 0.0])

    def test_is_active_again_after_a_restart(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            grbl.device.stage(2, table())
            grbl.device.activate(2)
        with rig(tmp_path) as grbl:
            grbl.device.open()
            assert grbl.device.active_bank() == 2
            grbl.device.move_to(np.array([1000.0, 650.0, 500.0]), feed_mm_per_s=None, guarded=False)
            node = table().counts[1, 1, 1] * 1e-4
            assert grbl.world.controller.displayed_position() == pytest.approx(
                np.array([1000.0, 650.0, 500.0]) + node, abs=1.1e-3
            )

    def test_does_not_change_in_motion(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            grbl.device.stage(1, table())
            refused: list[CommandRejected] = []

            def activate() -> None:
                try:
                    grbl.device.activate(1)
                except CommandRejected as error:
                    refused.append(error)

            grbl.at(2.0, activate)
            grbl.device.move_to(np.array([1000.0, 0.0, 0.0]), feed_mm_per_s=50.0, guarded=False)
            assert "during a motion" in refused[0].message
            assert grbl.device.active_bank() == 0
            assert grbl.device.position() == pytest.approx([1000.0, 0.0, 0.0])


class TestFiles:
    def staged(self, base: Path) -> Path:
        with rig(base) as grbl:
            grbl.device.open()
            grbl.device.stage(1, table())
            grbl.device.activate(1)
        return base / "banks"

    @pytest.mark.parametrize("keep", [0, 10, 200, 500])
    def test_cut_file_of_the_active_bank_is_refused_and_nothing_moves(self, tmp_path: Path, keep: int) -> None:
        path = self.staged(tmp_path) / "bank1.table"
        path.write_bytes(path.read_bytes()[:keep])
        with rig(tmp_path) as grbl, pytest.raises(StoreError):
            grbl.device.open()

    def test_exchanged_file_is_detected(self, tmp_path: Path) -> None:
        banks = self.staged(tmp_path)
        with rig(tmp_path) as grbl:
            grbl.device.open()
            grbl.device.stage(2, table(2))
        (banks / "bank2.table").replace(banks / "bank1.table")
        with rig(tmp_path) as grbl, pytest.raises(ChecksumMismatch, match="bank 1 is active"):
            grbl.device.open()

    def test_lost_file_is_detected(self, tmp_path: Path) -> None:
        (self.staged(tmp_path) / "bank1.table").unlink()
        with rig(tmp_path) as grbl, pytest.raises(StoreError, match="its file is missing"):
            grbl.device.open()

    def test_invalid_file_of_the_active_bank(self, tmp_path: Path) -> None:
        (self.staged(tmp_path) / "active").write_text("1")
        with rig(tmp_path) as grbl, pytest.raises(StoreError, match="names the active bank"):
            grbl.device.open()

    def test_power_cut_before_the_rename_leaves_the_old_table(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            grbl.device.stage(1, table())

            def cut(*_: object) -> None:
                raise OSError(5, "input/output error")

            with monkeypatch.context() as patched:
                patched.setattr(os, "fsync", cut)
                with pytest.raises(StoreError, match="cannot write"):
                    grbl.device.stage(1, table(2))
            read = grbl.device.read_table(1)
            assert read is not None
            assert read.same_as(table())

    def test_directory_that_cannot_be_created(self, tmp_path: Path) -> None:
        (tmp_path / "banks").write_text("a file")
        with rig(tmp_path) as grbl, pytest.raises(StoreError):
            grbl.device.open()
            grbl.device.stage(1, table())

    def test_steep_table_is_refused(self, tmp_path: Path) -> None:
        with rig(tmp_path) as grbl:
            grbl.device.open()
            with pytest.raises(StoreError, match="mm per mm"):
                grbl.device.stage(1, TableImage((0.0, 0.0, 0.0), (0.1, 0.1, 0.1), 1e-4, table().counts))
