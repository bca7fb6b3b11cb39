"""Reversal of the axes told by the probe: a machine with its own errors, backlash of its own in each axis that grows
along the travel, scattering axes and probe. What is true is reckoned here from the scenario alone."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nights import SCENARIO, document

from agent.errors import MeasurementFault
from agent.execution import steps as s
from agent.execution.device_assembly import assemble
from agent.execution.engine import Engine
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.probing.reversal import Reversal
from agent.runs.kinds.calibrate import preflight_of
from agent.settings.schema import Settings
from drivers.clock import VirtualClock

GROWTH_UM_PER_M = (1.5, -2.0, 3.0)


def with_backlash(state: Path, backlash_um: list[float], seed: int = 1, **sections: Any) -> Job:
    scenario = tomllib.loads(SCENARIO.read_text())
    scenario |= {name: str(SCENARIO.parent / scenario[name]) for name in ("machine", "artefact")}
    scenario["axes"] = {
        "repeatability_um": 0.3,
        "backlash_um": backlash_um,
        "backlash_growth_um_per_m": list(GROWTH_UM_PER_M),
    }
    scenario["seed"] = seed
    devices = {"twin": {"driver": "simulated", "options": scenario}}
    return prepare_job(Settings.model_validate(document(state, devices=devices, **sections)), Path.cwd())


def told(job: Job) -> tuple[Reversal, list[s.Step]]:
    rig = assemble(job.settings, VirtualClock(), Path.cwd())
    rig.open()
    seen: list[s.Step] = []
    prepared = Engine(rig.actions(), observer=lambda step, _: seen.append(step)).run(job.preparation_plan())
    assert rig.devices["twin"].world.collisions == []  # type: ignore[attr-defined]
    assert prepared.reversal is not None
    return prepared.reversal, seen


def true_um(backlash_um: list[float], at_mm: tuple[float, float, float]) -> np.ndarray:
    return np.array([b + g * at / 1e3 for b, g, at in zip(backlash_um, GROWTH_UM_PER_M, at_mm, strict=True)])


def test_each_axis_is_told_within_its_stated_uncertainty(state: Path) -> None:
    """Over 8 machines the errors in units of the stated σ: none beyond 3, and their rms about one or less."""
    pulls = []
    for seed in range(8):
        backlash_um = [3.0 + seed, 9.0 - seed, 6.0]
        found, _ = told(with_backlash(state, backlash_um, seed))
        lost = np.array([one.lost_um for one in found.axes])
        sigma = np.array([one.sigma_um for one in found.axes])
        assert (sigma < 2.0).all()
        pulls.append((lost - true_um(backlash_um, found.at_mm)) / sigma)
    assert np.abs(pulls).max() < 3.0
    assert 0.2 < math.sqrt(np.square(pulls).mean()) < 1.3


def test_above_the_limit_is_an_event_and_a_warning_and_the_run_goes_on(state: Path) -> None:
    found, seen = told(with_backlash(state, [0.0, 25.0, 0.0]))
    assert [one.verdict for one in found.axes] == ["within", "beyond", "within"]
    assert len(found.warnings) == 1
    assert "axis Y" in found.warnings[0]
    events = [dict(x.payload) for x in seen if isinstance(x, s.Record) and x.key.endswith("reversal/Y/reversal")]
    assert events == [{"reason": found.warnings[0]}]
    decided = [dict(x.payload) for x in seen if isinstance(x, s.Record) and x.key.endswith("/reversal/reversal")]
    assert [axis["axis"] for axis in decided[0]["axes"]] == ["X", "Y", "Z"]
    assert "not seen" in found.text


def test_surely_above_the_limit_ends_the_run_where_the_settings_say_so(state: Path) -> None:
    job = with_backlash(state, [0.0, 0.0, 25.0], reversal={"on_excess": "stop"})
    with pytest.raises(MeasurementFault, match=r"Z .* beyond"):
        told(job)


def test_the_touches_are_those_that_the_plan_says_and_its_time_is_foreseen(state: Path) -> None:
    job = with_backlash(state, [0.0, 0.0, 0.0])
    _, seen = told(job)
    touches = [x for x in seen if isinstance(x, s.TouchTowards) and "/reversal/" in x.key]
    assert len(touches) == 3 * 2 * 2 * job.settings.reversal.touches
    keys = [x.key for x in seen]
    assert len(set(keys)) == len(keys)
    assert any("/reversal/" in key for key in preflight_of(job).timeline)


def test_preloading_moves_one_axis_alone_right_before_the_touch(state: Path) -> None:
    _, seen = told(with_backlash(state, [0.0, 0.0, 0.0]))
    acts = [x for x in seen if isinstance(x, (s.MoveTo, s.TouchTowards)) and "/reversal/" in x.key]
    for before, start, touch in zip(acts, acts[1:], acts[2:], strict=False):
        if not isinstance(touch, s.TouchTowards):
            continue
        axis = "XYZ".index(touch.key.split("/reversal/")[1][0])
        preload = np.array(start.target_mm) - np.array(before.target_mm)
        way = np.array(touch.target_mm) - np.array(start.target_mm)
        assert np.flatnonzero(np.abs(preload) > 1e-9).tolist() == [axis]
        assert way[axis] == 0.0
        assert np.count_nonzero(way) == 1
