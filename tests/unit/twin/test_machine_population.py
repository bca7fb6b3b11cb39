import numpy as np
import pytest

from twin.errors import ModelError
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import Family, family_from_amplitudes

MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), ((0.0, 1.0),) * 3, 4)


def width(family, name):
    return family.half_widths[family.model.index(name)]


def test_lists_start_at_the_lowest_order_and_decay_goes_on_beyond_them():
    family = family_from_amplitudes(
        MODEL,
        {
            "positioning_um": [8.0, 4.0],
            "straightness_um": [6.0, 3.0],
            "rotation_urad": 5.0,
            "squareness_urad": 9.0,
            "cross_displacement_um": 2.0,
            "cross_rotation_urad": 1.0,
            "decay": 0.5,
        },
    )
    assert [width(family, f"EYY[{k}]") for k in (1, 2, 3, 4)] == pytest.approx([8e-3, 4e-3, 2e-3, 1e-3])
    assert [width(family, f"EZY[{k}]") for k in (2, 3, 4)] == pytest.approx([6e-3, 3e-3, 1.5e-3])
    assert [width(family, f"EBX[{k}]") for k in (1, 2, 3, 4)] == pytest.approx([5e-6, 2.5e-6, 1.25e-6, 0.625e-6])
    assert width(family, "B0Z") == pytest.approx(9e-6)
    assert width(family, "CROSS[b2]") == pytest.approx(2e-3)
    assert width(family, "CROSS[c1]") == pytest.approx(1e-6)


def test_a_kind_left_out_is_zero():
    family = family_from_amplitudes(MODEL, {"squareness_urad": 9.0})
    assert np.count_nonzero(family.half_widths) == 3


def test_draws_are_uniform_and_reproducible():
    family = family_from_amplitudes(MODEL, {"positioning_um": 3.0, "rotation_urad": [2.0]})
    draws = family.draw(np.random.default_rng(1), 20_000)
    assert draws.shape == (20_000, MODEL.size)
    assert (np.abs(draws) <= family.half_widths).all()
    np.testing.assert_allclose(draws.std(axis=0), family.prior_standard_deviation, rtol=0.02)
    np.testing.assert_array_equal(draws, family.draw(np.random.default_rng(1), 20_000))


@pytest.mark.parametrize(
    ("amplitudes", "says"),
    [
        ({"positioning": 1.0}, "unknown family amplitude 'positioning'"),
        ({"positioning_um": -1.0}, "at least zero"),
        ({"rotation_urad": [1.0, float("nan")]}, "finite"),
        ({"rotation_urad": []}, "finite"),
        ({"squareness_urad": [1.0, 2.0]}, "one value, got 2"),
    ],
)
def test_wrong_amplitudes(amplitudes, says):
    with pytest.raises(ModelError, match=says):
        family_from_amplitudes(MODEL, amplitudes)


def test_a_negative_half_width_is_named():
    widths = np.ones(MODEL.size)
    widths[MODEL.index("EXY[3]")] = -1.0
    with pytest.raises(ModelError, match="negative") as caught:
        Family(MODEL, widths)
    assert caught.value.where["parameter"] == "EXY[3]"
