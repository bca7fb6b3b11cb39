"""Documents that only the page requests, compared with independent arithmetic."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from journaled import journaled, run_id
from service_house import settings_document

from agent.history import cached_trends
from agent.history.cached_trends import CachedTrends
from agent.history.kept_documents import KeptDocuments
from agent.history.metrics import CachedMetrics
from agent.history.schema import StoredRun
from agent.history.trends import Trend
from agent.planning.design.set_valuation import valuation_of
from agent.planning.job import Job
from agent.planning.job_preparation import prepare_job
from agent.results.table_difference import table_difference
from agent.service.page.endpoints import set_value_document, table_csv
from agent.service.page.result_cache import ResultCache
from agent.service.page.trends import TrendCache
from agent.settings.history import HistorySettings
from agent.settings.schema import Settings
from drivers.errors import InputError
from drivers.roles import TableImage
from twin.artefact.position_set import Position

SHAPE = (4, 3, 2)
PLACES = (Position(1, 0.0, 45.0), Position(1, 45.0, 0.0), Position(2, -45.0, 0.0))


def image(seed: int, resolution_mm: float = 1e-4) -> TableImage:
    counts = np.random.default_rng(seed).integers(-900, 900, (*SHAPE, 3), dtype=np.int32)
    return TableImage((0.0, 10.0, 20.0), (100.0, 50.0, 25.0), resolution_mm, counts)


def test_the_difference_of_two_tables_is_found_node_by_node() -> None:
    one, other = image(1), image(2, resolution_mm=2e-4)
    found = table_difference(one, other).as_json()
    assert (found["same"], found["nodes"]) == (False, 24)
    for axis, row in enumerate(found["axes"]):
        changes = {}
        for node in np.ndindex(*SHAPE):
            um = 1e3 * (2e-4 * float(other.counts[node][axis]) - 1e-4 * float(one.counts[node][axis]))
            changes[(0.0 + 100.0 * node[0], 10.0 + 50.0 * node[1], 20.0 + 25.0 * node[2])] = um
        assert row["axis"] == "XYZ"[axis]
        assert row["largest_um"] == pytest.approx(max(changes.values(), key=abs))
        assert changes[tuple(row["at_mm"])] == pytest.approx(row["largest_um"])
        assert row["rms_um"] == pytest.approx((sum(um**2 for um in changes.values()) / 24) ** 0.5)


def test_no_compensation_is_a_table_of_zeros_and_nothing_differs_from_itself() -> None:
    table = image(3)
    found = table_difference(None, table).as_json()
    assert found["axes"][0]["largest_um"] == pytest.approx(0.1 * max(table.counts[..., 0].ravel().tolist(), key=abs))
    assert table_difference(table, None).as_json()["axes"][1]["largest_um"] == pytest.approx(
        -found["axes"][1]["largest_um"]
    )
    assert table_difference(table, image(3)).as_json()["same"]
    assert table_difference(None, None).as_json()["same"]
    assert found["crc32"][0] is None


def test_tables_on_different_grids_are_not_compared() -> None:
    with pytest.raises(InputError, match="different grids"):
        table_difference(image(1), replace(image(1), step_mm=(100.0, 50.0, 20.0)))


def test_a_kept_table_as_a_file() -> None:
    table = image(4)
    rows = list(csv.reader(io.StringIO(table_csv(table, np.zeros(3), "run", "backup"))))
    assert rows[0] == ["x_mm", "y_mm", "z_mm", "dx_um", "dy_um", "dz_um"]
    assert len(rows) == 1 + 24
    assert [float(value) for value in rows[1][:3]] == [0.0, 10.0, 20.0]
    assert [float(value) for value in rows[2][3:]] == pytest.approx([0.1 * n for n in table.counts[0, 0, 1].tolist()])
    with pytest.raises(InputError, match="stored no table as backup"):
        table_csv(None, np.zeros(3), "run", "backup")


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    state = tmp_path_factory.mktemp("state")
    prepared = prepare_job(Settings.model_validate(settings_document(state)), state)
    return replace(prepared, positions=PLACES)


def test_what_a_position_is_worth_is_what_the_set_without_it_leaves(job: Job) -> None:
    found = set_value_document(job)
    whole = valuation_of(job, PLACES)
    assert found["after_um"] == pytest.approx(whole.after.aligned_um, rel=1e-6)
    assert found["before_um"] == pytest.approx(whole.before.aligned_um, rel=1e-6)
    assert found["percent"] == pytest.approx(whole.percent, rel=1e-5)
    assert len(found["positions"]) == len(PLACES)
    for row in found["positions"]:
        place = Position(row["station"], row["azimuth_deg"], row["elevation_deg"])
        without = valuation_of(job, [other for other in PLACES if other != place])
        assert row["lost_um"] == pytest.approx(without.after.aligned_um - whole.after.aligned_um, rel=1e-4)
        assert row["lost_um"] > 0.0
    assert found["out_of_reach"] == []


def test_before_the_first_run_there_are_no_trends_and_no_results(tmp_path: Path) -> None:
    settings = Settings.model_validate(settings_document(tmp_path))
    assert TrendCache(CachedTrends()).document(settings, None) == {"trends": [], "alarms": [], "marks": [], "runs": {}}
    with pytest.raises(InputError, match="no journal"):
        ResultCache().curves(tmp_path, "20260101T000000Z-0000")


def test_trends_have_the_line_and_the_band_that_are_drawn(tmp_path: Path) -> None:
    """4.8 µm growing by 0.4 a night; a run that comes later is seen."""
    for night in range(10):
        journaled(tmp_path, night, 4.8 + 0.4 * night, machine="mine")
    chosen = {"machine": "mine", "parameter_tolerances": {"EXX[1]": 12.0}}
    trends, settings = TrendCache(CachedTrends()), Settings.model_validate(settings_document(tmp_path, history=chosen))
    [slope, bow] = trends.document(settings, "EXX")["trends"]
    assert (slope["name"], bow["name"]) == ("EXX[1]", "EXX[2]")
    assert slope["fitted"] == pytest.approx([4.8 + 0.4 * night for night in range(10)])
    assert len(slope["fitted_half_width"]) == 10
    assert all(half > 0.0 for half in slope["fitted_half_width"])
    assert slope["tolerance"] == 12.0
    assert slope["two_sided"]
    whole = trends.document(settings, None)
    assert {"ve_bare", "EXX"} <= {trend["name"] for trend in whole["trends"]}
    assert len(whole["runs"]) == 10
    assert slope["started"][:2] == ["2026-11-01T02:00:00Z", "2026-11-02T02:00:00Z"]
    assert [(mark["night"], mark["kind"]) for mark in whole["marks"]] == [(night, "accepted") for night in range(10)]
    assert whole["marks"][3]["started"] == "2026-11-04T02:00:00Z"
    assert whole["runs"][run_id(3)]["started"].startswith("2026-11-04T02:00:00")
    journaled(tmp_path, 10, 8.8, machine="mine")
    assert len(trends.document(settings, "EXX")["trends"][0]["values"]) == 11


def test_after_a_restart_nothing_is_fitted_again_until_a_run_or_a_setting_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for night in range(3):
        journaled(tmp_path, night, 4.8, machine="mine")
    settings = Settings.model_validate(settings_document(tmp_path, history={"machine": "mine"}))
    made, metrics = TrendCache(CachedTrends()).document(settings, None), CachedMetrics(CachedTrends()).text(settings)
    fitted: list[int] = []

    def trends_of(runs: Sequence[StoredRun], _: HistorySettings, __: Sequence[Trend]) -> tuple[Trend, ...]:
        fitted.append(len(runs))
        return ()

    monkeypatch.setattr(cached_trends, "trends_of", trends_of)
    assert TrendCache(CachedTrends()).document(settings, None) == made
    assert CachedMetrics(CachedTrends()).text(settings) == metrics
    assert metrics[0] == "mine"
    assert "volcal_runs{" in metrics[1]
    assert fitted == []
    tolerant = Settings.model_validate(settings_document(tmp_path, history={"machine": "mine", "warn_nights": 3.0}))
    TrendCache(CachedTrends()).document(tolerant, None)
    assert fitted == [3]
    journaled(tmp_path, 3, 4.8, machine="mine")
    shared = CachedTrends()  # as in the service: the page and the metrics show the same trends
    TrendCache(shared).document(settings, None)
    CachedMetrics(shared).text(settings)
    assert fitted == [3, 4]
    (settings.state_directory / "trends.json").write_text("[]")
    TrendCache(CachedTrends()).document(settings, None)
    assert fitted == [3, 4, 4]


def test_a_name_that_is_no_error_is_not_kept_and_changes_nothing(tmp_path: Path) -> None:
    journaled(tmp_path, 0, 4.8, machine="mine")
    settings = Settings.model_validate(settings_document(tmp_path, history={"machine": "mine"}))
    trends = TrendCache(CachedTrends())
    for name in ("overview", "EX", "EXX[1]", "x" * 20):
        assert trends.document(settings, name)["trends"] == []
    assert not (settings.state_directory / "trends.json").exists()
    assert trends.document(settings, None)["trends"]
    assert trends.document(settings, "") == trends.document(settings, None)
    trends.document(settings, "EXX")
    kept = json.loads((settings.state_directory / "trends.json").read_text())
    assert set(kept["documents"]) == {"", "EXX"}


@pytest.mark.parametrize("content", ["[]", '{"": []}', '[["a", "b"]]', "1", "[" * 100_000, "{"])
def test_kept_documents_of_another_form_are_made_again(tmp_path: Path, content: str) -> None:
    kept = KeptDocuments(tmp_path / "trends.json")
    kept.write("history", {"": {"trends": []}})
    good = kept.path.read_text()
    assert kept.read("history", dict) == {"": {"trends": []}}
    assert kept.read("history", str) == {}
    assert kept.read("another", dict) == {}
    kept.path.write_text(good[: good.index('{"": ')] + content + "}")
    assert kept.read("history", dict) == {}
