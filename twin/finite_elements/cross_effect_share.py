"""Comparison of a deflection grid with an error model: what single axes explain, and what only the cross-effect does.

This is the step of the published method between the finite element model and equations 5 and 6: deflections that
depend on one axis alone are error motions like any other; the rest calls for terms that depend on two axes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np

from twin.arrays import Array
from twin.errors import DataError
from twin.finite_elements.tool_displacements import check_covers
from twin.machine.deflection import DeflectionGrid
from twin.machine.deviation_basis import deviation_basis
from twin.machine.error_model import ErrorModel
from twin.machine.machine_description import MachineDescription
from twin.machine.rigid_motion import rigid_fields
from twin.machine.volumetric import align_rigidly, evaluation_grid, rms
from twin.units import MICRO_UNITS, UM_PER_MM

POINTS = (13, 11, 11)
_CUT_OFF = 1e-9


@dataclass(frozen=True)
class CrossEffectShare:
    """Parts of a deflection in the workspace of a machine.

    `largest_um` (3,) is the largest displacement along each axis, and `raw_um` the rms length, both relative to the
    middle. `aligned_um` is the rms length without the best rigid motion, `without_series_um` without the series of the
    single axes too, and `rest_um` without the cross-effect either. `terms` contains the fitted terms of the
    cross-effect in µm or µrad, as `units` says.
    """

    largest_um: tuple[float, float, float]
    raw_um: float
    aligned_um: float
    without_series_um: float
    rest_um: float
    terms: Mapping[str, float]
    units: Mapping[str, str]

    def as_json(self) -> dict[str, object]:
        """Return the figures for a JSON document."""
        return {**asdict(self), "terms": dict(self.terms), "units": dict(self.units)}


def cross_effect_share(grid: DeflectionGrid, machine: MachineDescription) -> CrossEffectShare:
    """Return what the error model of a machine explains of a deflection grid, by least squares over its workspace, for
    the end of the ram (tool offset zero). Raises DataError if the grid does not cover the workspace, or if the machine
    has no cross-effect."""
    model = machine.model
    if not model.cross_terms:
        raise DataError(f"the model of {machine.name} has no cross-effect", hint="Name a machine file that has one")
    check_covers(grid, model.ranges_mm, machine.name)
    points = evaluation_grid(model.ranges_mm, POINTS)
    middle = np.array([0.5 * (low + high) for low, high in model.ranges_mm])
    field = grid.at(points) - grid.at(middle)
    plain = replace(model, cross_effect=(), structure=())
    without, _ = _rest(plain, points, field)
    whole, coefficients = _rest(model, points, field)
    fitted = coefficients[model.size - len(model.cross_terms) : model.size].tolist()
    terms = {
        term.name: MICRO_UNITS[term.unit][1] * value for term, value in zip(model.cross_terms, fitted, strict=True)
    }
    x, y, z = (UM_PER_MM * float(value) for value in np.abs(field).max(axis=0))
    return CrossEffectShare(
        largest_um=(x, y, z),
        raw_um=UM_PER_MM * rms(field),
        aligned_um=UM_PER_MM * rms(align_rigidly(points, field)),
        without_series_um=UM_PER_MM * rms(without),
        rest_um=UM_PER_MM * rms(whole),
        terms=terms,
        units={term.name: MICRO_UNITS[term.unit][0] for term in model.cross_terms},
    )


def _rest(model: ErrorModel, points: Array, field: Array) -> tuple[Array, Array]:
    """Return the part (n, 3) of a field that a model and a rigid motion leave, and the parameters of the fit."""
    columns = deviation_basis(model, points, np.zeros(3)).reshape(field.size, -1)
    size = float(np.ptp(points, axis=0).max())
    rigid = rigid_fields(points, points.mean(axis=0), size).reshape(field.size, 6)
    design = np.concatenate((columns, rigid), axis=1)
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    scale[scale < 1e-12 * scale.max()] = np.inf
    fitted = np.linalg.lstsq(design / scale, field.reshape(-1), rcond=_CUT_OFF)[0]
    rest = field.reshape(-1) - (design / scale) @ fitted
    return rest.reshape(field.shape), fitted / scale
