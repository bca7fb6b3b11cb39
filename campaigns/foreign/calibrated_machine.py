"""Drawn machine that was measured in the set S3 at four stations and identified, with the table of its estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from campaigns.foreign.artefact import measure_at, tilted_bar
from campaigns.foreign.machine import TOOL, DrawnMachine
from campaigns.foreign.score import family_of
from campaigns.foreign.trials import GENERATORS, places_of
from twin.compensation.table import CompensationTable, MeasuredRegion, build_table, regular_nodes
from twin.identification import Estimate, identify_by_evidence
from twin.machine.anchor import Anchor


@dataclass(frozen=True, eq=False)
class CalibratedMachine:
    """Machine with its estimate and the compensation table of this estimate for the tool `TOOL`."""

    machine: DrawnMachine
    estimate: Estimate
    table: CompensationTable


def calibrated_machine(generator: str, rng: np.random.Generator) -> CalibratedMachine:
    """Draw a machine of the generator `generator`, and calibrate it."""
    machine, bar = GENERATORS[generator](rng), tilted_bar(rng)
    seen = measure_at(machine, bar, places_of("S3"), rng).seen
    estimate = identify_by_evidence(family_of, seen, bar.artefact)
    ranges = estimate.model.ranges_mm
    region, anchor = MeasuredRegion.around(seen.axis_positions), Anchor(np.mean(ranges, axis=1))
    tool = np.asarray(TOOL, dtype=np.float64)
    table = build_table(estimate.model, estimate.parameters, regular_nodes(ranges), tool, anchor, region)
    return CalibratedMachine(machine, estimate, table)
