"""Contract tests of the device roles `CompensationStore` and `Thermometer`.

Every driver of such a role must pass them. Each test uses the fixture `rig`, a `ContractRig` with the device under
test.
"""
# ruff: noqa: S101  contract tests assert

from __future__ import annotations

import numpy as np
import pytest

from drivers.contract.rig import ContractRig
from drivers.errors import StoreError
from drivers.roles import CompensationStore, TableImage, Thermometer


class CompensationStoreContract:
    """Contract tests, which every driver of a compensation store must pass.

    The store must activate tables immediately, and its banks must be empty at the start of each test.
    """

    def test_implements_the_role(self, rig: ContractRig) -> None:
        assert isinstance(rig.store, CompensationStore)
        assert set(rig.store.store_limits().banks) >= {1, 2}

    def test_staged_table_reads_back_and_is_not_active(self, rig: ContractRig) -> None:
        assert rig.store.active_bank() == 0
        assert rig.store.read_table(1) is None
        rig.store.stage(1, rig.table())
        self._require_stored(rig, 1, rig.table())
        assert rig.store.active_bank() == 0

    def test_activation_reads_back_and_can_be_undone(self, rig: ContractRig) -> None:
        rig.store.stage(2, rig.table())
        rig.store.activate(2)
        assert rig.store.active_bank() == 2
        rig.store.activate(0)
        assert rig.store.active_bank() == 0

    def test_active_bank_is_not_written(self, rig: ContractRig) -> None:
        rig.store.stage(1, rig.table())
        rig.store.activate(1)
        with pytest.raises(StoreError):
            rig.store.stage(1, rig.table(2))
        self._require_stored(rig, 1, rig.table())

    def test_empty_or_missing_bank_cannot_be_activated(self, rig: ContractRig) -> None:
        for bank in (2, 9):
            with pytest.raises(StoreError):
                rig.store.activate(bank)
        assert rig.store.active_bank() == 0

    @pytest.mark.parametrize("bank", [0, 9])
    def test_unknown_bank_is_not_written(self, rig: ContractRig, bank: int) -> None:
        with pytest.raises(StoreError):
            rig.store.stage(bank, rig.table())

    def test_table_beyond_the_limits_is_refused_and_the_bank_keeps_its_own(self, rig: ContractRig) -> None:
        rig.store.stage(1, rig.table())
        limits = rig.store.store_limits()
        own = rig.table()
        too_much = np.full_like(own.counts, round(1.5 * limits.max_correction_mm / limits.resolution_mm))
        with pytest.raises(StoreError):
            rig.store.stage(1, TableImage(own.origin_mm, own.step_mm, own.resolution_mm, too_much))
        read = rig.store.read_table(1)
        assert read is None or read.same_as(own)

    def _require_stored(self, rig: ContractRig, bank: int, table: TableImage) -> None:
        read = rig.store.read_table(bank)
        assert read is not None
        assert read.same_as(table)


class ThermometerContract:
    def test_temperatures_have_their_names(self, rig: ContractRig) -> None:
        assert isinstance(rig.thermometer, Thermometer)
        temperatures = rig.thermometer.temperatures_c()
        assert -20.0 < temperatures["artefact"] < 60.0
