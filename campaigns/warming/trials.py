"""Calibrations while machine and ball bar (the artefact) warm by 3 K, compared with calibrations at constant
temperature.

Whole calibrations are carried out on the simulated case study, in this process and on virtual time. In the calibration
with warming (the warm run), the air in the hall becomes warmer at the start, and bar and machine follow with a lag. The
scales, the spindle and the ram of the machine expand. The column bends with an additional lag behind the machine's
thermometer, and the bar bows. The thermometers have noise, lag and offsets.

The results are true volumetric errors with the compensation table that the run has written; the best-fitting rigid
motion is removed. The errors are evaluated for the machine as it was at the measurement of the last ball of the
position set, because the estimate describes this state. The same machine and bar are also calibrated at constant
temperature, once at 20 °C and once at 23 °C. At 23 °C the expansion of the bar is as uncertain as in the warm run. From
the ball centres of the warm run, the machine errors are identified two more times. Both identifications assume that the
machine does not drift thermally. The second also assumes that the bar is at 20 °C.

    python -m campaigns.warming --seeds 3 [--figure warming.png] [--csv warming.csv]

The output ends with one line of JSON. The exit code is 0 only if three claims hold. First, the rms error over the
machines is at most a fifth larger in the warm runs than at 23 °C. Second, every machine and bar has warmed by about
3 K. Third, for every machine the error more than doubles if the identification omits the drift.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # must be set before numpy is imported

import numpy as np

from agent.execution.device_assembly import Devices
from agent.execution.journal_reader import open_journal
from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.results.estimation import identification_options
from agent.results.table_image import image_of
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.run_context import RunHooks
from agent.runs.session import RunResult, carry_out
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from benchmarks.places import memory_directory, write_csv
from campaigns.nights.play import build_rig
from campaigns.nights.season import calibrated_table, true_vce_with_table
from campaigns.warming.figure import WarmingTrace, draw
from campaigns.warming.row import WarmingRow
from drivers.clock import VirtualClock
from simulators.scenario import ArtefactTruthSettings, Scenario, TruthSettings, read_scenario
from simulators.temperatures import ThermalSettings
from simulators.world.world import World
from twin.artefact.observations import Observations

LARGEST_RISE = 1.2
WARMER_K = 3.0
STILL = ThermalSettings(sensor_noise_k=0.01, sensor_offset_k={"artefact": 0.01})
SETTLED = STILL.model_copy(update={"artefact_c": 20.0 + WARMER_K, "machine_c": 20.0 + WARMER_K})
WARMING = ThermalSettings(
    ambient_rise_k=3.65,
    artefact_time_constant_h=0.35,
    machine_time_constant_h=0.45,
    growth_um_per_k=(2.0, 8.0, 5.0),
    scale_um_per_m_k=(8.0, 8.5, 10.0),
    bend_um_per_k=5.0,
    bend_time_constant_h=0.5,
    artefact_bow_um_per_k=0.3,
    sensor_noise_k=0.01,
    sensor_offset_k={"artefact": 0.01},
    sensor_lag_s=20.0,
)
THERMOMETER_K = 0.02


@dataclass(frozen=True, eq=False)
class WarmingRun:
    """One calibration of the warming trial. `records` are the journal records of its balls, without the balls of the
    verification.
    """

    world: World
    job: Job
    ended: RunResult
    records: Sequence[Mapping[str, Any]]

    @property
    def true_um(self) -> float:
        """True volumetric error in µm with the active compensation table, for the present state of the machine.

        The best-fitting rigid motion is removed.
        """
        return self.world.truth.true_volumetric_error(self.world.controller.active_bank)[1]


def compare_runs(seed: int, *, constant: bool = True) -> tuple[WarmingRow, WarmingTrace]:
    """Carry out the three calibrations of the random machine that `seed` gives: at 20 °C, at 23 °C, and while the
    machine warms. Without `constant` that at 20 °C is left out, and the figures of it are NaN.

    Raises RuntimeError if a calibration fails or leaves no compensation table active.
    """
    still = run_calibration(seed, STILL) if constant else None
    settled, warm = (run_calibration(seed, temperatures) for temperatures in (SETTLED, WARMING))
    world, records = warm.world, warm.records
    late_um, bare_um = warm.true_um, world.truth.true_volumetric_error(None)[1]
    world.now = records[-1]["instant_s"]  # nothing moves any more: only the truth is read
    true_um = warm.true_um
    machine = [record["machine_c"] for record in records]
    artefact = [record["temperature_c"] for record in records]
    undrifted = _vce_without_drift(warm, told=True)
    row = WarmingRow(
        seed=seed,
        minutes=warm.ended.outcome.machine_minutes,
        machine_k=machine[-1] - machine[0],
        artefact_k=artefact[-1] - artefact[0],
        bare=bare_um,
        constant=np.nan if still is None else still.true_um,
        settled=settled.true_um,
        warm=true_um,
        late=late_um,
        ratio=true_um / settled.true_um,
        undrifted=undrifted,
        untold=_vce_without_drift(warm, told=False),
        predicted_constant=np.nan if still is None else _predicted_um(still),
        predicted_settled=_predicted_um(settled),
        predicted_warm=_predicted_um(warm),
    )
    return row, WarmingTrace(tuple(r["instant_s"] / 60.0 for r in records), tuple(machine), tuple(artefact))


def _predicted_um(run: WarmingRun) -> float:
    estimation = run.ended.outcome.estimation
    return np.nan if estimation is None else estimation.volumetric.after_aligned.value_um


def run_calibration(seed: int, temperatures: ThermalSettings) -> WarmingRun:
    """Carry out one calibration at the simulated `temperatures`. At the start the controller has no compensation table.

    Raises RuntimeError if the calibration fails or leaves no compensation table active.
    """
    with memory_directory("warming") as directory:
        state = Path(directory) / "state"
        world, job = World(_scenario(seed, temperatures)), prepare_job(_settings(state), SHIPPED_CONFIGURATION)
        devices = Devices(lambda _, clock, __: build_rig(world, clock, job), lambda _: VirtualClock())
        hooks = RunHooks(devices=devices, write_files=False)
        ended = carry_out(job, FullCalibration(), SHIPPED_CONFIGURATION, hooks)
        if ended.error is not None or world.collisions or not world.controller.active_bank:
            raise RuntimeError(f"seed {seed}: {ended.error or ended.outcome.proof or world.collisions}")
        with open_journal(state) as reader:
            balls = reader.balls(reader.require_run(ended.outcome.run_id).run)
        records = [ball.record for ball in balls if not ball.record["key"].startswith("verify")]
    return WarmingRun(world, job, ended, records)


def _settings(state: Path) -> Settings:
    settings = load_settings(CASE_STUDY).model_copy(update={"state_directory": state})
    warmth = settings.temperature.model_copy(update={"standard_uncertainty_k": THERMOMETER_K})
    return settings.model_copy(update={"temperature": warmth})


def _scenario(seed: int, temperatures: ThermalSettings) -> Scenario:
    shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
    settings = shipped.settings.model_copy(
        update={
            "seed": seed,
            "truth": TruthSettings(seed=100 + seed, legendre_order=7),
            "artefact_truth": ArtefactTruthSettings(seed=200 + seed),
            "temperatures": temperatures,
        }
    )
    return replace(shipped, settings=settings)


def _vce_without_drift(run: WarmingRun, *, told: bool) -> float:
    """Return the true VCE in µm with a table identified from the ball centres of `run` without a drift of the machine.

    With `told` the bar's measured temperatures are used; otherwise 20 °C is assumed.
    """
    job, settings = run.job, run.job.settings
    held = {(p.station, p.azimuth_deg, p.elevation_deg) for p in job.held_out}
    kept = [
        record
        for record in run.records
        if record["key"].startswith("measure/")
        and (record["station"], record["azimuth_deg"], record["elevation_deg"]) not in held
    ]
    numbers = {number: place for place, number in enumerate(dict.fromkeys(record["position"] for record in kept))}
    observations = Observations(
        position=np.array([numbers[record["position"]] for record in kept]),
        ball=np.array([record["ball"] for record in kept]),
        tool=np.zeros(len(kept), dtype=np.int64),
        axis_positions=np.array([record["centre_mm"] for record in kept]),
        covariance=np.array([record["covariance_mm2"] for record in kept]),
        temperature_c=np.array([record["temperature_c"] if told else 20.0 for record in kept]),
        elevation_rad=np.radians([record["elevation_deg"] for record in kept]),
        tool_offsets=job.tool_offset_mm.reshape(1, 3),
    )
    options = identification_options(settings.identification, settings.temperature, None)
    table = calibrated_table(job, observations, options)
    return true_vce_with_table(run.world, image_of(table, run.world.controller.store_limits))


def verdict(rows: Sequence[WarmingRow]) -> dict[str, object]:
    """Return the three claims of the trial and the figures on which they are based.

    The value of a claim is True if the claim holds.
    """
    worst = max(rows, key=lambda row: row.ratio)
    constant, settled, warm = (_rms([getattr(row, name) for row in rows]) for name in ("constant", "settled", "warm"))
    warmed = min(min(row.machine_k, row.artefact_k) for row in rows)
    claims = {
        "rise_within": warm <= LARGEST_RISE * settled,
        "warmed_by_3_k": warmed >= WARMER_K - 0.1,
        "correction_matters": all(row.undrifted > 2.0 * row.warm for row in rows),
    }
    return {
        "passed": all(claims.values()),
        **claims,
        "seeds": len(rows),
        "rise": round(warm / settled, 3),
        "rise_over_20_c": round(warm / constant, 3),
        "rms_constant_um": round(constant, 3),
        "rms_settled_um": round(settled, 3),
        "rms_warm_um": round(warm, 3),
        "rms_late_um": round(_rms([row.late for row in rows]), 3),
        "rms_undrifted_um": round(_rms([row.undrifted for row in rows]), 3),
        "rms_untold_um": round(_rms([row.untold for row in rows]), 3),
        "worst_ratio": round(worst.ratio, 3),
        "worst_seed": worst.seed,
        "per_seed": [{name: round(value, 3) for name, value in asdict(row).items()} for row in rows],
    }


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _line(row: WarmingRow) -> str:
    parts = (
        f"{row.seed:2d}: {row.minutes:5.1f} min, machine {row.machine_k:+.2f} K, bar {row.artefact_k:+.2f} K",
        f"true VCE at 20 °C {row.constant:.2f}, settled {row.settled:.2f}, warming {row.warm:.2f} µm (ratio "
        f"{row.ratio:.2f}), late {row.late:.2f}",
        f"without drift {row.undrifted:.2f}, untold {row.untold:.2f}, no table {row.bare:.1f}",
        f"predicted {row.predicted_constant:.2f}, {row.predicted_settled:.2f}, {row.predicted_warm:.2f}",
    )
    return " | ".join(parts)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="number of machines")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--csv", type=Path)
    given = parser.parse_args(arguments)
    began = perf_counter()
    rows: list[WarmingRow] = []
    traces: list[WarmingTrace] = []
    with ProcessPoolExecutor(2) as pool:
        for row, trace in pool.map(compare_runs, range(given.first, given.first + given.seeds)):
            rows.append(row)
            traces.append(trace)
            print(_line(row), flush=True)
    if given.csv is not None:
        write_csv([asdict(row) for row in rows], given.csv)
    if given.figure is not None:
        draw(rows, traces[0], given.figure)
    result = {**verdict(rows), "wall_seconds": round(perf_counter() - began, 1)}
    print(json.dumps(result, allow_nan=False))
    return 0 if result["passed"] else 1
