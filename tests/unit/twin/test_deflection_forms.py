"""Random deflection fields: their size, and that no misfit mode represents them entirely."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from measured_set import RANGES, case_study

from twin.identification.misfit import misfit_modes
from twin.machine.deflection import DeflectionGrid
from twin.machine.forward_model import deviation_basis
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import evaluation_grid, rms
from twin.uncertainty import random_machines

FORMS = [
    random_machines.portal_deflection,
    random_machines.rail_deflection,
    random_machines.thermal_deflection,
    random_machines.smooth_random_deflection,
]
POINTS = evaluation_grid(RANGES, (16, 9, 9))
Form = Callable[..., DeflectionGrid]


@pytest.mark.parametrize("form", FORMS)
def test_a_few_micrometres_over_the_whole_travel_and_never_the_same_twice(form: Form) -> None:
    rng = np.random.default_rng(3)
    fields = [form(RANGES, rng).at(POINTS) for _ in range(12)]
    sizes_um = [1e3 * rms(field) for field in fields]
    assert 0.3 < min(sizes_um) < max(sizes_um) < 8.0
    assert np.ptp(sizes_um) > 0.1
    assert np.array_equal(form(RANGES, np.random.default_rng(5)).values, form(RANGES, np.random.default_rng(5)).values)


@pytest.mark.parametrize("form", FORMS)
def test_neither_model_nor_modes_hold_it_entirely(form: Form) -> None:
    model, _ = case_study(5)
    tool = (0.0, 250.0, 0.0)
    known = np.concatenate(
        (
            deviation_basis(model, POINTS, np.array(tool)),
            misfit_modes(model, tool).at(POINTS),
            rigid_fields(POINTS, POINTS.mean(axis=0), 1000.0),
        ),
        axis=2,
    ).reshape(3 * len(POINTS), -1)
    field = form(RANGES, np.random.default_rng(6)).at(POINTS).reshape(-1)
    left = field - known @ np.linalg.lstsq(known, field, rcond=1e-10)[0]
    assert rms(left.reshape(-1, 3)) > 1e-5
