"""Parameters whose lever arms began at the zeros of the axes mean the same field when converted."""

from __future__ import annotations

import numpy as np
import pytest
from former_levers import former_deviation

from twin.errors import ModelError
from twin.machine.deviation_basis import linear_deviation
from twin.machine.error_model import ERROR_MOTIONS, ErrorModel
from twin.machine.kinematic_chain import parse_chain
from twin.machine.lever_origin import from_levers_at_axis_zeros
from twin.machine.rigid_motion import rigid_fields

RANGES = ((-1000.0, 3000.0), (200.0, 1500.0), (-1500.0, 0.0))
TOOL = np.array([30.0, 250.0, -120.0])
COLUMN = "tool-Y-Z-X-bed-workpiece"
DEFAULT = ("b1", "b2", "c1")


def model_of(chain: str, cross_effect: tuple[str, ...], order: int = 4) -> ErrorModel:
    return ErrorModel.uniform(parse_chain(chain), RANGES, order, cross_effect)


def beside_rigid(field: np.ndarray, points: np.ndarray) -> np.ndarray:
    motions = rigid_fields(points, points.mean(axis=0), 4000.0).reshape(-1, 6)
    return np.asarray(field.ravel() - motions @ np.linalg.lstsq(motions, field.ravel(), rcond=None)[0])


@pytest.mark.parametrize(
    ("chain", "cross_effect"),
    [
        (COLUMN, DEFAULT),
        (COLUMN, ("b0", "b1", "b2", "c0", "c1")),
        (COLUMN, ("c0", "c1")),
        ("tool-Z-Y-X-bed-workpiece", DEFAULT),
        ("tool-Z-bed-X-Y-workpiece", DEFAULT),
        ("tool-X-Y-bed-Z-workpiece", ("b0", "c0")),
        ("tool-bed-Z-X-Y-workpiece", ("b1", "c1")),
        ("tool-bed-Z-X-Y-workpiece", ("c0",)),
        ("tool-bed-Y-X-Z-workpiece", ()),
    ],
)
def test_the_field_stays_the_same_but_for_a_rigid_motion(chain: str, cross_effect: tuple[str, ...]) -> None:
    model, rng = model_of(chain, cross_effect), np.random.default_rng(4)
    unit = [1e-3 if parameter.unit == "mm" else 1e-6 for parameter in model.parameters]
    former = rng.normal(0.0, 5.0, model.size) * unit
    low, high = np.array(RANGES).T
    points = rng.uniform(low, high, (300, 3))
    before = former_deviation(model, points, TOOL, former)
    converted = from_levers_at_axis_zeros(model, TOOL) @ former
    after = linear_deviation(model, points, TOOL, converted)
    assert np.abs(beside_rigid(after - before, points)).max() < 1e-12 * np.abs(before).max()
    assert np.abs(beside_rigid(linear_deviation(model, points, TOOL, former) - before, points)).max() > 1e-3


def test_ranges_that_begin_at_zero_change_nothing() -> None:
    model = ErrorModel.uniform(parse_chain(COLUMN), ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0)))
    assert (from_levers_at_axis_zeros(model, TOOL) == np.eye(model.size)).all()


@pytest.mark.parametrize(
    ("chain", "orders", "cross_effect", "words"),
    [
        (COLUMN, {"EZX": 2, "EYX": 2}, DEFAULT, r"the change of EAX\[3\] needs EYX\[3\]"),
        (COLUMN, {"EAZ": 0}, DEFAULT, r"the change of CROSS\[c1\] needs EAZ\[1\]"),
        ("tool-bed-Z-X-Y-workpiece", {}, ("c1",), r"the change of CROSS\[c1\] needs CROSS\[b1\]"),
        ("tool-Y-bed-Z-X-workpiece", {}, DEFAULT, r"CROSS\[c1\] cannot be represented if Z carries the workpiece"),
    ],
)
def test_what_the_model_cannot_represent_is_named(
    chain: str, orders: dict[str, int], cross_effect: tuple[str, ...], words: str
) -> None:
    every = dict.fromkeys(ERROR_MOTIONS, 4) | orders
    with pytest.raises(ModelError, match=words):
        from_levers_at_axis_zeros(ErrorModel(parse_chain(chain), RANGES, every, cross_effect), TOOL)
