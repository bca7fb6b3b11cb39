"""Gates that a new table must pass before it is written, with those of its gain and its proof. All functions are free
of side effects."""

from __future__ import annotations

import numpy as np

from agent.results.gates.gate import Gate, gate_below, share_of
from agent.results.gates.gate_rules import PROOF
from agent.results.table_replacement import ExpectedGain
from agent.results.travel_parts import TravelParts
from agent.settings.schema import GateSettings
from drivers.roles import StoreLimits
from twin.artefact.effect_test import REQUIRED_POWER
from twin.compensation.table import CompensationTable
from twin.units import UM_PER_MM


def table_gates(
    table: CompensationTable, travel: TravelParts, store: StoreLimits, limits: GateSettings
) -> tuple[Gate, ...]:
    """Return the gates (limits) that `table` must pass before it is written to the controller. `travel` contains the
    volumetric error with and without the table outside the measured region."""
    part = travel.unmeasured
    return (
        *shape_gates(table, store, limits),
        extrapolation_gate(float(np.mean(table.extrapolated)), limits),
        unmeasured_gate(*((0.0, 0.0) if part is None else (part.table_ve_um, part.predicted_vce_um)), limits),
    )


def shape_gates(table: CompensationTable, store: StoreLimits, limits: GateSettings) -> tuple[Gate, ...]:
    """Return the two gates (limits) for the values of the table: one limits the largest correction, the other the
    steepest slope."""
    largest_um = float(np.abs(table.corrections).max()) * UM_PER_MM
    return (
        correction_gate(largest_um, store.max_correction_mm * UM_PER_MM, limits),
        slope_gate(_largest_slope_um_per_mm(table), limits),
    )


def correction_gate(largest_um: float, store_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the largest correction. `store_um` is the largest correction that the controller
    accepts."""
    allowed_um = min(limits.max_correction_um, store_um)
    return gate_below("correction", largest_um, allowed_um, "largest correction of one axis in µm")


def slope_gate(slope_um_per_mm: float, limits: GateSettings) -> Gate:
    return gate_below(
        "slope", slope_um_per_mm, limits.max_slope_um_per_mm, "steepest change between neighbouring nodes in µm/mm"
    )


def extrapolation_gate(outside: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the fraction `outside` of the table's nodes that lie outside the measured region."""
    return gate_below(
        "extrapolation",
        outside,
        1.0 if limits.allow_extrapolation else 0.0,
        "share of nodes outside the measured region, where only the prior and the polynomials speak",
    )


def unmeasured_gate(before_um: float, after_um: float, limits: GateSettings) -> Gate:
    """Return the gate (limit) for the predicted VCE `after_um` outside the measured region as a share of the VE
    `before_um` that the table corrects there. Both are 0 if the whole travel was measured."""
    return gate_below(
        "unmeasured",
        0.0 if after_um == 0.0 else share_of(after_um, before_um),
        limits.max_unmeasured_fraction,
        f"outside the measured region, predicted VCE {after_um:.2f} µm as a share of the VE {before_um:.2f} µm that "
        "the table corrects there: the corrections must be larger than their uncertainty",
    )


def gain_gate(gain: ExpectedGain, min_gain: float) -> Gate:
    """Return the gate (limit) for the relative decrease of the VE that is expected with the new table."""
    return Gate(
        "gain",
        gain.reaches(min_gain),
        gain.fraction,
        min_gain,
        f"relative decrease of the expected VE from {gain.kept_um:.2f} to {gain.new_um:.2f} µm by the new table "
        "(aligned): the improvement must stand out of its uncertainty",
    )


def proof_gate(power: float) -> Gate:
    """Return the gate (limit) for the probability `power` that the proof accepts a table that works."""
    return Gate(
        PROOF,
        power >= REQUIRED_POWER,
        power,
        REQUIRED_POWER,
        "probability that held-out positions prove a table that works; one without effect passes with 5 % at most",
    )


def _largest_slope_um_per_mm(table: CompensationTable) -> float:
    steepest = 0.0
    for axis, nodes in enumerate((table.x, table.y, table.z)):
        change = np.abs(np.diff(table.corrections, axis=axis))
        spacing = np.diff(nodes).reshape([-1 if i == axis else 1 for i in range(4)])
        steepest = max(steepest, float((change / spacing).max(initial=0.0)))
    return steepest * UM_PER_MM
