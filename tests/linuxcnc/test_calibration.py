"""Short form of `make linuxcnc`: calibration of a stock LinuxCNC by the real command, one station, few positions."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from requirements import requires_linuxcnc

from campaigns.linuxcnc import EXIT_NOT_RUN, run_calibration, short_trial


@requires_linuxcnc
def test_stock_linuxcnc_is_calibrated_end_to_end(tmp_path: Path) -> None:
    result = run_calibration(short_trial(tmp_path / "work", speed=15.0))
    assert result["exit_code"] == 0, result
    assert result["state"] == "complete"
    assert result["table_bank"] == 1
    assert result["collisions"] == 0
    assert result["applied_worst_um"] < 0.1
    assert result["verification"]["after_um"] < 0.5 * result["verification"]["before_um"]
    assert result["true_ve_after_um"] < 0.8 * result["true_ve_before_um"], result


def test_benchmark_reports_that_linuxcnc_cannot_run(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "campaigns.linuxcnc"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=600.0,
        check=False,
    )
    assert done.returncode == EXIT_NOT_RUN
    assert "linuxcnc-uspace" in json.loads(done.stdout.splitlines()[-1])["not_run"]
