"""Trial `make linuxcnc`: `volcal calibrate` on a real, running stock LinuxCNC, reached over volcal's LinuxCNC bridge
and CAN.

Everything runs faster than real time, in its own Linux namespaces. The simulated machine behind LinuxCNC knows its true
errors. The trial reports the true volumetric error without a compensation table and with the table that is active at
the end. It also reports the difference between that table and the correction that LinuxCNC applies. The output ends
with one line of JSON. The exit code is 0 only if the new table was accepted and the true error decreased.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.clock import ScaledClock, wall_seconds
from drivers.linuxcnc.bridge_link import BridgeLink
from drivers.linuxcnc.device import LinuxCnc
from drivers.linuxcnc.settings import LinuxCncSettings
from drivers.registry import DeviceContext
from drivers.roles import TableImage
from simulators.linuxcnc.namespaces import unavailable_reason
from simulators.linuxcnc.process import LinuxCncProcess
from simulators.scenario import read_scenario
from simulators.world.field import TableField
from simulators.world.world import World

ROOT = Path(__file__).resolve().parent.parent
CONFIGURATION = ROOT / "config" / "linuxcnc"
SCENARIO = ROOT / "config" / "simulators" / "case-study.toml"
COMPONENTS = ROOT / "drivers" / "linuxcnc" / "components"
VOLCAL = Path(sys.executable).parent / "volcal"
RUN_TIMEOUT_S = 3600.0
POINTS = 20
ANSWER_WITHIN_S = 60.0
"""Time allowed for an answer in s, the longest that the driver accepts; the computer may be busy."""
MOTORS = tuple(f"joint.{number}.motor-pos-cmd" for number in range(3))
EXIT_NOT_RUN = 77


@dataclass(frozen=True)
class LinuxCncTrial:
    """One trial of `volcal calibrate` on a running LinuxCNC.

    `changes` maps texts in the settings of the shipped example to the texts that replace them. `scenario_changes` maps
    texts in the scenario of the example in the same way. `arguments` are passed on to `volcal calibrate`.
    """

    work: Path
    speed: float = 10.0
    arguments: tuple[str, ...] = ()
    changes: dict[str, str] = field(default_factory=dict)
    scenario_changes: dict[str, str] = field(default_factory=dict)


def run_calibration(trial: LinuxCncTrial) -> dict[str, Any]:
    """Run the trial, and return the outcome of `volcal calibrate` together with the true errors known to
    the simulator.
    """
    began_s = wall_seconds()
    trial.work.mkdir(parents=True, exist_ok=True)
    scenario = _write_changed_copy(SCENARIO, trial.work / "scenario.toml", trial.scenario_changes)
    settings = _write_changed_copy(
        CONFIGURATION / "volcal.toml",
        trial.work / "volcal.toml",
        {"factor = 10.0": f"factor = {trial.speed!r}", **trial.changes},
    )
    with LinuxCncProcess(
        scenario=scenario,
        configuration=CONFIGURATION,
        components=COMPONENTS,
        work=trial.work,
        speed=trial.speed,
    ) as machine:
        command = [str(VOLCAL), "calibrate", "--config", str(settings), "--json", *trial.arguments]
        done = subprocess.run(  # noqa: S603  our own program
            machine.inside(*command), stdout=subprocess.PIPE, text=True, timeout=RUN_TIMEOUT_S, check=False
        )
        outcome = json.loads(done.stdout) if done.stdout else {"state": "nothing said"}
        return {
            "exit_code": done.returncode,
            "state": outcome["state"],
            "reason": outcome.get("reason"),
            "touches": outcome.get("touches"),
            "balls": outcome.get("balls"),
            "machine_minutes": outcome.get("machine_minutes"),
            "estimated_ve_um": outcome.get("estimated_ve_um"),
            "chi2_normalised": outcome.get("chi2_normalised"),
            "verification": outcome.get("verification"),
            "collisions": machine.ask("collisions")["count"],
            **true_errors(trial, scenario, machine),
            "speed": trial.speed,
            "wall_seconds": round(wall_seconds() - began_s, 1),
        }


def true_errors(trial: LinuxCncTrial, scenario: Path, machine: LinuxCncProcess) -> dict[str, Any]:
    """Return the true volumetric errors in µm without a compensation table and with the active table.

    The best-fitting rigid motion is removed from both errors. The result also contains the largest difference between
    the active table and the correction that LinuxCNC applies.
    """
    world = World(read_scenario(scenario))
    options = LinuxCncSettings.model_validate(
        {
            "bridge_command": machine.bridge_command,
            "motion_margin_s": 120.0,
            "response_timeout_s": ANSWER_WITHIN_S,
            "heartbeat_timeout_s": 60.0,
            "compensation": {"method": "external-offsets", "directory": str(trial.work / "tables")},
        }
    )
    device = LinuxCnc(options, DeviceContext("cnc", ScaledClock(trial.speed), trial.work))
    device.open()
    try:
        bank = device.active_bank()
        image = device.read_table(bank) if bank else None
        worst_um = largest_applied_difference_um(device, machine, image)
        latency = next(finding.text for finding in device.diagnose() if finding.subject == "latency")
    finally:
        device.close()
    if image is not None:
        world.controller.write_bank(bank, image)
    before_um, after_um = (world.truth.true_volumetric_error(which)[1] for which in (0, bank))
    return {
        "table_bank": bank,
        "true_ve_before_um": round(before_um, 3),
        "true_ve_after_um": round(after_um, 3),
        "applied_worst_um": round(worst_um, 4),
        "latency": latency,
    }


def largest_applied_difference_um(device: LinuxCnc, machine: LinuxCncProcess, image: TableImage | None) -> float:
    """Return the largest difference in µm between the correction that LinuxCNC applies to the motors and the
    compensation table `image`.

    If `image` is None, the applied correction is compared with zero. The difference is measured at random points at the
    lower end of the Y travel, where no artefact stands.
    """
    table = None if image is None else TableField(image)
    limits = device.limits()
    rng = np.random.default_rng(5)
    worst = 0.0
    link = BridgeLink(
        machine.bridge_command,
        response_timeout_s=5.0,
        watchdog_timeout_s=0.0,
        heartbeat_timeout_s=60.0,
        device="motors",
    )
    link.open()
    try:
        for x in rng.uniform(limits.lower_mm[0] + 1.0, limits.upper_mm[0] - 1.0, POINTS):
            place = np.array(
                [x, limits.lower_mm[1] + 1.0, rng.uniform(limits.lower_mm[2] + 1.0, limits.upper_mm[2] - 1.0)]
            )
            device.move_to(place, feed_mm_per_s=None, guarded=True)
            motors = np.array(link.get_all(MOTORS), dtype=np.float64)
            asked = np.zeros(3) if table is None else table.at_many(place[None])[0]
            worst = max(worst, float(np.abs(motors - place - asked).max()))
    finally:
        link.close()
    return 1e3 * worst


def _write_changed_copy(example: Path, path: Path, changes: dict[str, str]) -> Path:
    """Write a copy of an example's file with absolute paths and the given changes."""
    text = example.read_text(encoding="utf-8").replace('"../', f'"{example.parent.parent}/')
    for old, new in changes.items():
        if old not in text:
            raise ValueError(f"no {old!r} in {example}")
        text = text.replace(old, new)
    path.write_text(text, encoding="utf-8")
    return path


SHORT_CHANGES = {
    # other tests may keep the computer busy
    "motion_margin_s = 120.0": f"motion_margin_s = 600.0\nresponse_timeout_s = {ANSWER_WITHIN_S}",
    "heartbeat_timeout_s = 5.0": "heartbeat_timeout_s = 60.0",
    "watchdog_timeout_s = 2.0": "watchdog_timeout_s = 20.0",
    # one touch per point, at the feed of the search
    "touch_stages = 2": "touch_stages = 1",
    "touch_feed_mm_per_min = 60.0": "touch_feed_mm_per_min = 180.0",
    "stations = [1, 4]": "stations = [1]\npositions_deg = [[30.0, 30.0]]",
    "limit_um = 3.5": "limit_um = 5.0",
    "[probe_check]": "[reversal]\nenabled = false\n\n[probe_check]",
}
"""Changes of the settings that make the run short enough to be repeated after every change of the source."""
SHORT_SCENARIO = {
    "[truth]": "[ageing]\nnight = 1\ncollision_night = 1\ncollision = { B0Z = 80.0, A0Z = -80.0, C0Y = 60.0 }\n[truth]"
}
"""Changes of the scenario for the short run.

From a few positions at one end of the travel only part of the error can be identified. To make that part large, this
machine has also had a collision, which added squareness errors (in µrad).
"""


def short_trial(work: Path, speed: float) -> LinuxCncTrial:
    """Return a trial with few artefact positions at one station."""
    positions = str(CONFIGURATION / "few-positions.csv")
    arguments = ("--stations", "1", "--position-set", positions)
    return LinuxCncTrial(work, speed, arguments, SHORT_CHANGES, SHORT_SCENARIO)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=10.0, help="speed as a multiple of real time")
    parser.add_argument("--short", action="store_true", help="one station, few positions")
    parser.add_argument("--position-set", help="passed to volcal calibrate")
    parser.add_argument("--stations", help="passed to volcal calibrate")
    parser.add_argument("--work", type=Path, help="working directory, not deleted; default: a temporary directory")
    options = parser.parse_args()
    reason = unavailable_reason()
    if reason:
        print(json.dumps({"not_run": reason}))
        raise SystemExit(EXIT_NOT_RUN)
    with tempfile.TemporaryDirectory(prefix="volcal-linuxcnc-") as temporary:
        work = (options.work or Path(temporary) / "work").resolve()
        trial = (
            short_trial(work, options.speed)
            if options.short
            else LinuxCncTrial(work, options.speed, arguments=_calibrate_arguments(options))
        )
        result = run_calibration(trial)
    print(json.dumps(result))
    proved = result["exit_code"] == 0 and result["true_ve_after_um"] < result["true_ve_before_um"]
    raise SystemExit(0 if proved else 1)


def _calibrate_arguments(options: argparse.Namespace) -> tuple[str, ...]:
    named = {"--position-set": options.position_set, "--stations": options.stations}
    return tuple(word for name, value in named.items() if value for word in (name, value))


if __name__ == "__main__":
    main()
