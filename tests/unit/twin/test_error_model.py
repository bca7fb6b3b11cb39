import numpy as np
import pytest
from numpy.polynomial import legendre

from twin.errors import ModelError
from twin.machine.error_model import CROSS_TERMS, ErrorModel
from twin.machine.kinematic_chain import parse_chain
from twin.machine.legendre import legendre_values, normalise_positions, to_power_series

CHAIN = parse_chain("tool-Y-Z-X-bed-workpiece")
RANGES = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))


@pytest.mark.parametrize(
    ("order", "terms", "size"),
    [
        (4, CROSS_TERMS, 3 * 4 + 6 * 3 + 9 * 4 + 3 + 5),
        (5, CROSS_TERMS, 92),
        (5, ("b1", "b2", "c1"), 90),
        (5, (), 87),
    ],
)
def test_number_of_parameters(order, terms, size):
    model = ErrorModel.uniform(CHAIN, RANGES, order, terms)
    assert model.size == size == len(set(model.names))
    assert [model.index(name) for name in model.names] == list(range(size))


def test_names_orders_and_units():
    model = ErrorModel.uniform(CHAIN, RANGES, 3)
    assert model.names[:9] == (
        "EXX[1]", "EXX[2]", "EXX[3]", "EYX[2]", "EYX[3]", "EZX[2]", "EZX[3]", "EAX[1]", "EAX[2]",
    )  # fmt: skip
    assert model.names[-6:] == ("A0Z", "B0Z", "C0Y", "CROSS[b1]", "CROSS[b2]", "CROSS[c1]")
    units = {parameter.name: parameter.unit for parameter in model.parameters}
    assert units["EYX[2]"] == units["CROSS[b2]"] == "mm"
    assert units["ECZ[3]"] == units["B0Z"] == units["CROSS[c1]"] == "rad"


def test_orders_may_differ_and_may_be_zero():
    orders = dict.fromkeys(ErrorModel.uniform(CHAIN, RANGES).orders, 2)
    model = ErrorModel(CHAIN, RANGES, orders | {"EXX": 7, "EBY": 0, "EZX": 1}, ())
    assert model.block["EXX"] == slice(0, 7)
    assert not [name for name in model.names if name.startswith(("EBY", "EZX"))]


@pytest.mark.parametrize(
    ("ranges", "says"),
    [
        (((4000.0, 0.0), (0.0, 1.0), (0.0, 1.0)), "reversed"),
        (((0.0, 1.0), (5.0, 5.0), (0.0, 1.0)), "empty"),
        (((0.0, 1.0), (0.0, 1.0), (0.0, float("nan"))), "not finite"),
    ],
)
def test_wrong_ranges(ranges, says):
    with pytest.raises(ModelError, match=says):
        ErrorModel.uniform(CHAIN, ranges)


def test_wrong_orders_terms_and_names():
    good = dict(ErrorModel.uniform(CHAIN, RANGES).orders)
    for orders, terms, says in (
        (good | {"EXQ": 2}, (), "'EXQ' is not an error motion"),
        ({"EXX": 2}, (), "no Legendre order"),
        (good | {"EXX": -1}, (), "outside"),
        (good, ("b7",), "unknown cross-effect term"),
        (good, ("b1", "b1"), "twice"),
    ):
        with pytest.raises(ModelError, match=says):
            ErrorModel(CHAIN, RANGES, orders, terms)
    with pytest.raises(ModelError, match=r"no parameter 'EXX\[9\]'"):
        ErrorModel.uniform(CHAIN, RANGES).index("EXX[9]")


def test_legendre_values_against_numpy_and_by_hand():
    x = np.linspace(-1.0, 1.0, 7)
    np.testing.assert_allclose(legendre_values(x, 9), legendre.legvander(x, 9).T, atol=1e-14)
    np.testing.assert_allclose(legendre_values(np.array([0.5]), 3)[:, 0], [1.0, 0.5, -0.125, -0.4375], atol=1e-15)
    np.testing.assert_allclose(normalise_positions(np.array([100.0, 200.0, 500.0]), (100.0, 500.0)), [-1.0, -0.5, 1.0])


def test_power_series_keeps_twelve_digits_at_the_highest_order():
    rng = np.random.default_rng(3)
    coefficients = 0.02 * rng.uniform(-1.0, 1.0, (4, 16))
    x = np.linspace(-1.0, 1.0, 101)
    powers = to_power_series(coefficients) @ np.vander(x, 16, increasing=True).T
    assert np.abs(powers - legendre.legval(x, coefficients.T)).max() < 1e-12
