"""The same machine described by another model."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from twin.errors import ModelError
from twin.formats.machine_file import parse_machine

FILE = Path(__file__).parents[3] / "config" / "machines" / "case-study.toml"
MACHINE = parse_machine(FILE.read_text(), FILE.name, lambda name: (FILE.parent / name).read_text())


def test_another_order_goes_on_with_the_amplitudes_of_the_file() -> None:
    seven = MACHINE.with_order(7)
    assert set(seven.model.orders.values()) == {7}
    assert seven.model.size == 126
    assert seven.model.cross_effect == MACHINE.model.cross_effect
    width = dict(zip(seven.model.names, seven.family.half_widths.tolist(), strict=True))
    assert width["EXX[1]"] == pytest.approx(8e-3)
    assert width["EXX[7]"] == pytest.approx(1.1e-3 * 0.6**2)
    assert width["EAZ[6]"] == pytest.approx(0.6e-6 * 0.6)
    assert (seven.limits, seven.name, seven.deflection) == (MACHINE.limits, MACHINE.name, MACHINE.deflection)


def test_the_order_of_the_file_gives_the_family_of_the_file() -> None:
    same = MACHINE.with_order(5)
    assert same.model == MACHINE.model
    assert same.family.half_widths.tolist() == MACHINE.family.half_widths.tolist()


def test_a_model_of_other_axes_is_refused() -> None:
    ranges = ((0.0, 3990.0), *MACHINE.model.ranges_mm[1:])
    with pytest.raises(ModelError, match="not belong to the machine case-study"):
        MACHINE.with_model(dataclasses.replace(MACHINE.model, ranges_mm=ranges))
