"""Computation of the volumetric error inside and outside the measured region from an estimate."""

from __future__ import annotations

import numpy as np

from agent.results.travel_parts import Limits, TravelPart, TravelParts
from twin.arrays import Array
from twin.compensation.table import MeasuredRegion
from twin.identification import Estimate, expected_rms, regional_forms
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.volumetric_distribution import regional_limits
from twin.units import UM_PER_MM


def travel_parts(estimate: Estimate, tool_offset: Array, measured: Array) -> TravelParts:
    """Return the volumetric error inside and outside the region around the measured axis positions `measured` (n, 3) in
    mm, for a tool offset (3,) in mm.

    The region is the one outside which nodes of the compensation table count as extrapolated: the convex hull of the
    measured positions with a margin of half a ball pitch. The grid is that of the volumetric error.
    """
    grid = evaluation_grid(estimate.model.ranges_mm)
    inside = MeasuredRegion.around(measured).contains(grid)
    forms = regional_forms(estimate, grid, inside, tool_offset)
    share = float(inside.mean())
    known = [(form, part) for form, part in zip(forms, (share, 1.0 - share), strict=True) if form is not None]
    limits = iter(regional_limits(estimate, [form for form, _ in known]))
    parts = iter([_travel_part(estimate, form, part, *next(limits)) for form, part in known])
    first, second = (None if form is None else next(parts) for form in forms)
    return TravelParts(first, second)


def _travel_part(estimate: Estimate, form: Array, share: float, ve_mm: Limits, vce_mm: Limits) -> TravelPart:
    size = estimate.model.size
    square = float(estimate.parameters @ form[:size, :size] @ estimate.parameters)
    return TravelPart(
        share=share,
        estimated_ve_um=UM_PER_MM * float(np.sqrt(max(square, 0.0))),
        estimated_ve_limits_um=_in_um(ve_mm),
        predicted_vce_um=UM_PER_MM * expected_rms(estimate, form),
        predicted_vce_limits_um=_in_um(vce_mm),
    )


def _in_um(limits_mm: Limits) -> Limits:
    lower, upper = limits_mm
    return UM_PER_MM * lower, UM_PER_MM * upper
