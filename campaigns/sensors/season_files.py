"""Season of a foreign machine in a warm hall as files: settings, machine, artefact, history and estimates, as the
program would have left them, and balls measured at an hour of the last day."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from agent.history.database_url import database_address
from agent.history.run_row import RunRows
from agent.history.store import HistoryStore
from agent.settings.load import read_settings
from campaigns.foreign.artefact import S3, STATIONS_MM, measure
from campaigns.foreign.files import artefact_text, ball_text, machine_text, rows_of
from campaigns.sensors.hall_climate import BODIES, Array
from campaigns.sensors.measured_season import MeasuredSeason, measured_season
from twin.formats.estimate_file import format_estimate
from twin.identification import Estimate
from twin.units import MICRO_UNITS

START = datetime(2026, 2, 2, 3, 0, tzinfo=UTC)
_SETTINGS = """machine = "machine.toml"
artefact = "bar.toml"
tool = "probe"
state_directory = "state"

[devices.twin]
driver = "simulated"

[roles]
machine = "twin"
probe = "twin"
store = "twin"
thermometer = "twin"
mount = "twin"
operator = "twin"

[stations]
places_mm = [[560.0, 900.0, 750.0]]

[nightly]  # the walk with which the nights of the season were fused
drift_um = 0.5
scale_drift_um_per_m = 0.0
"""


@dataclass(frozen=True, eq=False)
class SeasonFiles:
    """Files of a season in `folder`, with the season itself."""

    folder: Path
    season: MeasuredSeason

    @property
    def settings(self) -> Path:
        return self.folder / "volcal.toml"

    def at(self, hours: int) -> datetime:
        """Return the time so many hours after the last night."""
        return START + timedelta(days=len(self.season.estimates) - 1, hours=hours)

    def temperatures_c(self, hours: int) -> dict[str, float]:
        """Return the readings so many hours after the last night."""
        row = self.season.readings_c[self.season.last_hour + hours]
        return dict(zip(BODIES, row.round(3).tolist(), strict=True))

    def write_balls(self, hours: int, positions: int = 2) -> Path:
        """Measure positions so many hours after the last night, and return their ball file."""
        rng = np.random.default_rng([31, hours])
        machine = self.season.machine_at(hours)
        seen = measure(machine, self.season.bar, S3[:positions], rng, stations=[STATIONS_MM[1]]).seen
        path = self.folder / f"balls-{hours}.csv"
        path.write_text(ball_text(rows_of(seen)), encoding="utf-8")
        return path


def write_season(folder: Path, number: int, nights: int) -> SeasonFiles:
    """Write the files of season `number` with so many nights into `folder`."""
    season = measured_season(number, nights)
    (folder / "machine.toml").write_text(machine_text(), encoding="utf-8")
    (folder / "bar.toml").write_text(artefact_text(season.bar), encoding="utf-8")
    (folder / "volcal.toml").write_text(_SETTINGS, encoding="utf-8")
    settings = read_settings(folder / "volcal.toml")
    settings.state_directory.mkdir()
    with closing(HistoryStore(database_address(settings))) as store:
        for night, estimate in enumerate(season.estimates):
            rows = _rows(store.address.machine, night, estimate, season.readings_c[season.hour_of(night)])
            store.put(rows)
            run = settings.state_directory / str(rows.run["run_id"])
            run.mkdir()
            text = format_estimate(estimate, {"run_id": run.name})
            (run / "estimate.json").write_text(text, encoding="utf-8")
    return SeasonFiles(folder, season)


def run_id(night: int) -> str:
    """Return the identity of the run of a night."""
    return f"{START + timedelta(days=night):%Y%m%dT%H%M%SZ}-0000"


def _rows(machine: str, night: int, estimate: Estimate, readings_c: Array) -> RunRows:
    started = START + timedelta(days=night)
    parameters = []
    sigmas = estimate.standard_uncertainty.tolist()
    for place, (parameter, value, sigma) in enumerate(
        zip(estimate.model.parameters, estimate.parameters.tolist(), sigmas, strict=True)
    ):
        unit, factor = MICRO_UNITS[parameter.unit]
        parameters.append(
            {
                "name": parameter.name,
                "place": place,
                "value": factor * value,
                "standard_uncertainty": factor * sigma,
                "unit": unit,
            }
        )
    temperatures = [
        {"sensor": name, "lowest": value - 0.05, "mean": value, "highest": value + 0.05}
        for name, value in zip((*BODIES, "artefact"), (*readings_c.tolist(), 20.0), strict=True)
    ]
    run = dict.fromkeys(("predicted_minutes", "ve_before_um", "ve_before_sigma_um", "ve_after_um", "ve_after_sigma_um"))
    run |= dict.fromkeys(("ve_now_um", "acting_um", "held_out_before_um", "held_out_after_um", "held_out_predicted_um"))
    run |= dict.fromkeys(("accepted", "night", "since", "nights", "table_bank", "table_crc32"))
    known = {
        "machine": machine,
        "run_id": run_id(night),
        "kind": "nightly" if night else "calibrate",
        "started": started.isoformat(),
        "ended": (started + timedelta(minutes=15)).isoformat(),
        "state": "complete",
        "reason": "",
        "software": "campaign",
        "started_by": "campaign",
        "artefact": "foreign",
        "position_set": "S3",
        "balls": 55,
        "touches": 275,
        "machine_minutes": 15.0,
        "chi2_normalised": estimate.chi2_normalised,
        "rank": estimate.rank,
        "settings_sha256": "0" * 64,
        **({"since": run_id(night - 1), "nights": 1.0} if night else {}),
    }
    return RunRows(run | known, tuple(parameters), tuple(temperatures), ())
