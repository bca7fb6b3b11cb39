"""Predicted figures of acceptance tests, compared with a virtual laser interferometer and ballbar.

Machines of the two generators of `campaigns.foreign` are drawn, measured in the set S3 at four stations and identified.
Then the instruments measure them, without and with the table of the estimate. In front of the instruments a machine has
what no identification knows: backlash, repeatability, and a spindle and scales that warm up in the shop. The figures of
each machine are compared by the E_n score of ISO 13528.

    python -m campaigns.instruments --machines 20 [--generator sines] [--worse-laser]

With `--worse-laser` the air sensor of the laser is wrong by eight kelvin, which it does not state: this must show. The
output ends with one line of JSON; the exit code is 1 unless at least 95 % of the figures agree, or if a wrong laser
does not show.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from agent.results.table_image import image_of
from agent.workpiece.instrument_comparison import ComparedFigure, InstrumentComparison, compare_with_instruments
from agent.workpiece.predicted_tests import PredictedTests
from campaigns.foreign.calibrated_machine import calibrated_machine
from campaigns.foreign.machine import RANGES, TOOL, DrawnMachine
from campaigns.instruments.trial_options import read_options
from simulators.instruments.machine_under_test import MachineUnderTest
from simulators.scenario import AxisBehaviour, StoreSettings
from simulators.wire.instrument_requests import answer_of
from simulators.world.field import TableField
from simulators.world.tables import TableBanks
from twin.compensation.table import CompensationTable
from twin.workpiece.acceptance import acceptance_tests, predict_tests
from twin.workpiece.agreement import EN_LIMIT
from twin.workpiece.positioning import AxisRepeats, predict_positioning

REQUIRED_SHARE = 0.95
_SEED = 31
_TOOL = np.asarray(TOOL, dtype=np.float64)
_RADIUS_MM = 150.0
_MARGIN_MM = 200.0
_TABLE_BANK = 1
_CONTROLLER = TableBanks(StoreSettings()).limits
_S_PER_H = 3600.0


@dataclass(frozen=True)
class ShopFloor:
    """Conditions in front of an instrument that a calibration does not meet: lost motion, and a machine that warms up.

    It warms up by `warming_k_per_h`. `growth_um_per_k` (3,) displaces the tip, and `scale_um_per_m_k` (3,) stretches
    the scales.
    """

    axes: AxisBehaviour
    warming_k_per_h: float
    growth_um_per_k: np.ndarray
    scale_um_per_m_k: np.ndarray


def shop_floor(rng: np.random.Generator) -> ShopFloor:
    """Draw the conditions of one machine."""
    x, y, z = rng.uniform(0.0, 6.0, 3).tolist()
    growth = rng.uniform(-1.0, 1.0, 3).tolist()
    return ShopFloor(
        AxisBehaviour(
            repeatability_um=float(rng.uniform(0.1, 0.6)),
            backlash_um=(x, y, z),
            backlash_growth_um_per_m=(growth[0], growth[1], growth[2]),
        ),
        float(rng.uniform(-0.1, 0.1)),
        rng.uniform(-6.0, 6.0, 3),
        rng.uniform(0.0, 11.0, 3),
    )


def in_front_of_instruments(
    machine: DrawnMachine, table: CompensationTable | None, floor: ShopFloor, seed: int, wrong_scale: float = 0.0
) -> MachineUnderTest:
    """Return the machine as the instruments see it, with the table as a controller applies it. A `wrong_scale` is the
    relative error of all distances that an instrument shows but does not state."""
    field = None if table is None else TableField(image_of(table, _CONTROLLER))

    def displaced(path_mm: np.ndarray, at_s: np.ndarray) -> np.ndarray:
        correction = np.zeros_like(path_mm) if field is None else field.at_many(path_mm)
        warmed_k = floor.warming_k_per_h * at_s[:, None] / _S_PER_H
        bare = path_mm + correction
        thermal = warmed_k * (1e-3 * floor.growth_um_per_k + 1e-6 * floor.scale_um_per_m_k * bare)
        return np.asarray(correction + machine.deviation(bare) + thermal + wrong_scale * path_mm)

    return MachineUnderTest(
        displaced, floor.axes, lambda at_s: 21.0 + floor.warming_k_per_h * at_s / _S_PER_H, 0.0, seed
    )


def touched_repeats(floor: ShopFloor, number: int) -> dict[str, AxisRepeats]:
    """Return what a run would measure of lost motion and repeatability, at one place and with a probe that scatters.

    Each axis is touched eight times from each side at two points; the scatter is that of two axes and the probe.
    """
    rng = np.random.default_rng([number, _SEED, 2])
    touches, freedom = 32, 29
    scatter_um = float(np.hypot(np.sqrt(2.0) * floor.axes.repeatability_um, rng.uniform(0.1, 0.5)))
    found = {}
    for name, travel, backlash_um, growth in zip(
        "XYZ", RANGES, floor.axes.backlash_of_axes_um, floor.axes.backlash_growth_um_per_m, strict=True
    ):
        at_mm = float(rng.uniform(*travel))
        lost_um = max(backlash_um + 1e-3 * growth * at_mm, 0.0)
        sigma_um = 2.0 * scatter_um / np.sqrt(touches)
        found[name] = AxisRepeats(
            scatter_mm=1e-3 * scatter_um * float(np.sqrt(rng.chisquare(freedom) / freedom)),
            freedom=freedom,
            lost_mm=1e-3 * float(lost_um + sigma_um * rng.standard_normal()),
            lost_sigma_mm=1e-3 * sigma_um,
            at_mm=at_mm,
        )
    return found


def one_machine(generator: str, number: int, wrong_scale: float = 0.0) -> InstrumentComparison:
    """Return the comparison for machine `number` of a generator."""
    rng = np.random.default_rng([number, _SEED])
    found = calibrated_machine(generator, rng)
    machine, estimate, table = found.machine, found.estimate, found.table
    low, high = np.array(machine.ranges).T
    centre = rng.uniform(low + _MARGIN_MM, high - _MARGIN_MM)
    tests = acceptance_tests(estimate.model.ranges_mm, _TOOL, centre, (_RADIUS_MM,))
    floor, base = shop_floor(rng), int(rng.integers(2**31))
    positioning = predict_positioning(estimate, tests, touched_repeats(floor, number), _TOOL, table)
    predicted = PredictedTests(
        predict_tests(estimate, tests, _TOOL, table), centre, _TOOL, None, positioning=positioning
    )

    def ask(request: Mapping[str, Any]) -> Mapping[str, Any]:
        active = table if request["bank"] == _TABLE_BANK else None
        seed = base + int(request["seed"])
        laser = request["do"] == "interferometer"
        stand = in_front_of_instruments(machine, active, floor, seed, wrong_scale if laser else 0.0)
        return answer_of(stand, {**request, "seed": seed})

    return compare_with_instruments(predicted, ask, _TABLE_BANK)


def summary(figures: Sequence[ComparedFigure]) -> dict[str, float]:
    """Return the share of agreeing figures in per cent, the rms score, and the mean expanded uncertainties in µm."""
    scores = np.array([figure.en for figure in figures])
    return {
        "figures": len(figures),
        "agreeing_percent": round(100.0 * float(np.mean(np.abs(scores) <= EN_LIMIT)), 1),
        "en_rms": round(float(np.sqrt(np.mean(scores**2))), 2),
        "largest_en": round(float(np.abs(scores).max()), 2),
        "predicted_expanded_um": round(1e3 * float(np.mean([figure.predicted.expanded_mm for figure in figures])), 2),
        "measured_expanded_um": round(float(np.mean([figure.measured.expanded_um for figure in figures])), 2),
    }


def main() -> int:
    """Carry out the trials of the command line."""
    given = read_options("campaigns.instruments", "Compare predictions with a virtual laser and ballbar.", 20)
    every: list[ComparedFigure] = []
    result: dict[str, object] = {}
    for generator in given.generators:
        work = partial(one_machine, generator, wrong_scale=given.wrong_scale)
        figures = [figure for number in range(given.machines) for figure in work(number).figures]
        every += figures
        groups = _groups(figures)
        for name, found in groups.items():
            sys.stdout.write(f"{generator}, {name}: {json.dumps(found)}\n")
        result[generator] = {"all": summary(figures), **groups}
    lines = [figure for figure in every if figure.test.test.standard in ("ISO 230-2", "ISO 230-6")]
    share = summary(every)["agreeing_percent"] / 100.0
    result["all"] = summary(every)
    sys.stdout.write(json.dumps(result) + "\n")
    if given.worse_laser:
        return 0 if summary(lines)["agreeing_percent"] < 100.0 * REQUIRED_SHARE else 1
    return 0 if share >= REQUIRED_SHARE else 1


def _groups(figures: Sequence[ComparedFigure]) -> dict[str, dict[str, float]]:
    found = {}
    names = dict.fromkeys(_group(figure) for figure in figures)
    for name in names:
        for active in (False, True):
            chosen = [figure for figure in figures if _group(figure) == name and figure.with_table is active]
            found[f"{name}, {'with' if active else 'without'} table"] = summary(chosen)
    return found


def _group(figure: ComparedFigure) -> str:
    test = figure.test.test
    first = test.feature.name.split()[0]
    return f"{test.standard} {first}" if first in ("squareness", "A", "E", "R", "B") else test.standard
