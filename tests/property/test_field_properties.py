"""Properties of the field for every chain, range, tool and machine of the family."""

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.family import AMPLITUDES, RANGES
from twin.machine.error_model import CROSS_TERMS, ErrorModel
from twin.machine.forward_model import exact_deviation, linear_deviation
from twin.machine.kinematic_chain import Chain, parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.volumetric import QuadraticForm, align_rigidly, evaluation_grid, rms, volumetric_error

chains = st.builds(
    lambda order, bed: Chain(tuple(order[:bed]), tuple(order[bed:])),
    st.sampled_from(list(itertools.permutations("XYZ"))),
    st.integers(0, 3),
)
tools = st.tuples(*(st.floats(-400.0, 400.0) for _ in range(3)))
seeds = st.integers(0, 2**32 - 1)


@given(chains)
def test_a_chain_survives_its_text(chain):
    assert parse_chain(str(chain)) == chain


@settings(max_examples=100, deadline=None)
@given(chains, tools, st.integers(1, 6), seeds)
def test_exact_and_linear_agree_within_five_nanometres_for_the_family(chain, tool, order, seed):
    """Set every coefficient to the border of the family with random signs, the largest machines possible.

    The axes are on either side of the bed, in any order. The difference is largest at the corners, with the longest
    levers and travels.
    """
    rng = np.random.default_rng(seed)
    model = ErrorModel.uniform(chain, RANGES, order, CROSS_TERMS)
    largest = family_from_amplitudes(model, AMPLITUDES).half_widths * rng.choice([-1.0, 1.0], model.size)
    corners = np.array(list(itertools.product(*RANGES)))
    points = np.vstack((corners, evaluation_grid(RANGES, (9, 5, 5))))
    exact = exact_deviation(model, points, tool, largest)
    linear = linear_deviation(model, points, tool, largest)
    assert np.linalg.norm(exact - linear, axis=1).max() < 5e-6


@settings(max_examples=30, deadline=None)
@given(chains, tools, seeds)
def test_what_linearisation_leaves_is_of_second_order(chain, tool, seed):
    rng = np.random.default_rng(seed)
    model = ErrorModel.uniform(chain, RANGES, 4)
    errors = rng.uniform(-1.0, 1.0, model.size) * [0.05 if p.unit == "mm" else 5e-5 for p in model.parameters]
    low, high = np.array(RANGES).T
    points = rng.uniform(low, high, (20, 3))
    left = [
        exact_deviation(model, points, tool, scale * errors) - linear_deviation(model, points, tool, scale * errors)
        for scale in (1.0, 0.5)
    ]
    np.testing.assert_allclose(left[0], 4.0 * left[1], rtol=0, atol=0.002 * np.abs(left[0]).max() + 1e-11)


@settings(max_examples=25, deadline=None)
@given(chains, tools, seeds)
def test_the_quadratic_form_is_the_grid(chain, tool, seed):
    rng = np.random.default_rng(seed)
    model = ErrorModel.uniform(chain, RANGES, 3, CROSS_TERMS)
    errors = rng.uniform(-1.0, 1.0, model.size) * [1e-2 if p.unit == "mm" else 1e-5 for p in model.parameters]
    grid = evaluation_grid(RANGES, (9, 7, 8))  # more points than the quadrature of the form uses
    field = rng.normal(0.0, 3e-3, grid.shape)
    form = QuadraticForm.build(model, grid, tool)
    for value, fixed in ((form.value(errors), 0.0), (form.value(errors, field), field)):
        direct = volumetric_error(grid + tool, linear_deviation(model, grid, tool, errors) + fixed)
        assert abs(value.raw_mm - direct.raw_mm) <= 1e-9 * direct.raw_mm
        assert abs(value.aligned_mm - direct.aligned_mm) <= 1e-9 * direct.raw_mm


@settings(max_examples=40, deadline=None)
@given(st.tuples(*(st.floats(-1.0, 1.0) for _ in range(6))), seeds)
def test_alignment_takes_any_small_rigid_motion_and_does_it_once(motion, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2000.0, 2000.0, (25, 3))
    rigid = 1e-2 * np.array(motion[:3]) + np.cross(1e-5 * np.array(motion[3:]), points)
    field = rng.normal(0.0, 1e-2, points.shape)
    aligned = align_rigidly(points, field)
    np.testing.assert_allclose(align_rigidly(points, field + rigid), aligned, atol=1e-12)
    np.testing.assert_allclose(align_rigidly(points, aligned), aligned, atol=1e-14)
    assert rms(aligned) <= rms(field)
