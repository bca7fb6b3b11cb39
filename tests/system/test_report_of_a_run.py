"""Reports of whole runs from their journal: complete, refused and aborted; reproducible; as PDF."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from dcc_structure import complaints
from lxml import etree
from nights import Night, short_document
from signers import identity
from volcal_command import volcal, volcal_json

from agent.certificates.xml_signature import Trust, check_signature
from agent.execution.journal_compaction import packed_record, store_packed
from agent.execution.journal_copy import copy_journal
from agent.execution.run_record import read_record, run_heads
from agent.execution.run_state import Announcement
from agent.execution.states import RunState
from agent.execution.supervisor import Supervisor
from agent.reports.page.pdf import render_pdf
from agent.reports.render_from_journal import render_from_journal
from agent.reports.run_comparison import compared_run, comparison_of
from agent.reports.run_report import report_of
from agent.runs.kinds.verify import Verification
from agent.runs.session import RunResult
from agent.service.http.problems import RequestRefused
from agent.service.page.part_prediction import PartBody, PartPredictions
from agent.service.page.result_cache import comparison_document
from drivers.errors import InputError
from twin.formats.estimate_file import parse_estimate
from twin.machine.volumetric import QuadraticForm, evaluation_grid


@dataclass
class Season:
    """A calibration, a verification, and a calibration that somebody aborts at its second ball."""

    state: Path
    document: dict[str, object]
    calibrated: RunResult
    verified: RunResult
    aborted: RunResult


@pytest.fixture(scope="module")
def season() -> Iterator[Season]:
    with TemporaryDirectory() as directory:
        state = Path(directory) / "state"
        night, document = Night(), short_document(state)
        document["nightly"] = {"check_positions": 1, "max_chi2": 4.0, "max_ve_growth": 20.0, "step_evidence": 30.0}
        document["report"] = {**document.get("report", {}), "measured_by": "A"}  # persons are those of the run
        calibrated = night.run(document)
        verified = night.run(document, kind=Verification(station=1, nights=1.0))
        asked: list[Supervisor] = []
        night.heard.clear()

        def abort_when_measuring(supervisor: Supervisor) -> None:
            asked.append(supervisor)

        heard = night.heard

        class Listening(list[Announcement]):
            def append(self, announcement: Announcement) -> None:
                heard.append(announcement)
                if announcement.kind == "progress" and announcement.data["fraction"] > 0.0 and asked:
                    asked[0].request_abort("somebody pressed abort")

        night.heard = Listening()
        aborted = night.run(document, abort_when_measuring)
        yield Season(state, document, calibrated, verified, aborted)


def page(season: Season, ended: RunResult) -> str:
    """As it was written at the run's end; that the same can be made again is a test of its own."""
    assert ended.outcome.report is not None
    return ended.outcome.report.read_text(encoding="utf-8")


def minimal_config(tmp_path: Path, season: Season) -> Path:
    """Settings with the state directory of the season."""
    config = tmp_path / "volcal.toml"
    listed = Path(str(season.document["machine"]))
    roles = "\n".join(f'{role} = "twin"' for role in ("machine", "probe", "store", "thermometer", "operator", "mount"))
    config.write_text(
        f'machine = "{listed}"\nartefact = "{season.document["artefact"]}"\nstate_directory = "{season.state}"\n'
        f'[devices.twin]\ndriver = "simulated"\n[devices.twin.options]\n'
        f'scenario = "{listed.parents[1] / "simulators" / "case-study.toml"}"\n'
        f"[roles]\n{roles}\n[stations]\nplaces_mm = [[700.0, 1000.0, 750.0]]\n"
    )
    return config


class TestPredictedPart:
    FEATURES = (
        "name,kind,x_mm,y_mm,z_mm,to_x_mm,to_y_mm,to_z_mm\nD,datum,0,0,0,,,\nE,datum,300,0,0,,,\nF,datum,0,200,0,,,\n"
        "A,distance,0,0,0,300,0,0\nB,position,150,200,0,,,\n"
    )
    PART = PartBody(file="part.csv", features=FEATURES, origin_mm=(700.0, 400.0, 300.0))

    def test_the_page_predicts_what_the_command_predicts(self, season: Season, tmp_path: Path) -> None:
        """The command reads the result files of the run, whose table is not rounded to the unit of the controller."""
        run_id = season.calibrated.outcome.run_id
        found = PartPredictions().document(season.state, run_id, self.PART)
        features = tmp_path / "part.csv"
        features.write_text(self.FEATURES)
        told = volcal_json("predict", features, "--estimate", season.state / run_id, "--at", "700,400,300")
        assert (found["table"], found["rule"]) == ("staged", told["rule"])
        for one, other in zip(found["features"], told["features"], strict=True):
            assert one["without_table"] == other["without_table"]
            assert one["with_table"] == pytest.approx(other["with_table"], abs=0.1)
        assert np.shape(found["places"]["largest"]) == (len(found["places"]["x_mm"]), len(found["places"]["y_mm"]))
        best = PartPredictions().document(season.state, run_id, self.PART.model_copy(update={"origin_mm": None}))
        assert best["origin_mm"] == best["places"]["best_mm"]

    def test_what_cannot_be_predicted_is_said(self, season: Season) -> None:
        predictions, run_id = PartPredictions(), season.calibrated.outcome.run_id
        for run, changed, words in (
            (season.verified.outcome.run_id, {}, "has no estimate"),
            (run_id, {"features": "name,kind\n"}, "column"),
            (run_id, {"features": self.FEATURES.replace("A,distance,0", "A,distance,none")}, "none"),
            (run_id, {"origin_mm": (9e4, 0.0, 0.0)}, "reach|travel|identified"),
        ):
            with pytest.raises(InputError, match=words):
                predictions.document(season.state, run, self.PART.model_copy(update=changed))
        with predictions.busy, pytest.raises(RequestRefused, match="another prediction"):
            predictions.document(season.state, run_id, self.PART)
        assert predictions.document(season.state, run_id, self.PART)["features"]


class TestCompared:
    def test_errors_field_and_table_differ_by_what_was_changed(self, season: Season) -> None:
        """The second run is the first one with 3 µm more slope of EXX, 2 µrad more squareness and one node changed."""
        one = compared_run(season.state, season.calibrated.outcome.run_id)
        assert one.estimate is not None
        assert one.table is not None
        assert one.tool_offset_mm is not None
        model, parameters = one.estimate.model, one.estimate.parameters.copy()
        parameters[model.index("EXX[1]")] += 3e-3
        parameters[model.index("C0Y")] += 2e-6
        counts = one.table.counts.copy()
        counts[1, 2, 1] += [3, 0, -4]
        estimate = replace(one.estimate, parameters=parameters)
        found = comparison_of(one, replace(one, estimate=estimate, table=replace(one.table, counts=counts)))
        document = found.as_json()
        errors = {row["name"]: row for row in document["identified"]["errors"]}
        assert len(errors) == 21
        x_mm = model.ranges_mm[0]
        assert abs(errors["EXX"]["largest"]) == pytest.approx(3.0)
        assert errors["EXX"]["largest"] == pytest.approx(-3.0 if errors["EXX"]["at_mm"] == x_mm[0] else 3.0)
        assert errors["EXX"]["at_mm"] in x_mm
        sigma = one.estimate.standard_uncertainty[model.index("C0Y")]
        assert (errors["C0Y"]["largest"], errors["C0Y"]["at_mm"]) == (pytest.approx(2.0), None)
        assert errors["C0Y"]["expanded_uncertainty"] == pytest.approx(2e6 * 2**0.5 * sigma)
        assert {name for name, row in errors.items() if row["largest"]} == {"EXX", "C0Y"}
        form = QuadraticForm.build(model, evaluation_grid(model.ranges_mm), one.tool_offset_mm)
        expected_um = form.value(parameters - one.estimate.parameters).aligned_um
        assert document["identified"]["field"]["rms_um"] == pytest.approx(expected_um, rel=1e-3)
        axes = {row["axis"]: row for row in document["tables"]["axes"]}
        unit_um = 1e3 * one.table.resolution_mm
        node = [o + s * n for o, s, n in zip(one.table.origin_mm, one.table.step_mm, (1, 2, 1), strict=True)]
        assert (axes["X"]["largest_um"], axes["X"]["at_mm"]) == (pytest.approx(3 * unit_um), pytest.approx(node))
        assert (axes["Z"]["largest_um"], axes["Y"]["largest_um"]) == (pytest.approx(-4 * unit_um), 0.0)
        drawn = comparison_document(found)
        assert max(max(row) for row in drawn["identified"]["field"]["planes"][2]["length_um"]) > 0.0
        assert sum(value > 0.0 for p in drawn["tables"]["planes"] for row in p["length_um"] for value in row) <= 1

    def test_the_command_says_what_cannot_be_compared(self, season: Season, tmp_path: Path) -> None:
        runs = [season.calibrated.outcome.run_id, season.verified.outcome.run_id]
        config = minimal_config(tmp_path, season)
        printed = volcal("history", "compare", *runs, "--config", config)
        assert all(run in printed.stdout for run in runs)
        assert f"not both runs identified errors: {runs[1]} did not" in " ".join(printed.stdout.split())
        stated = volcal_json("history", "compare", *runs, "--config", config)
        assert [run["run_id"] for run in stated["runs"]] == runs
        assert (stated["identified"]["reason"], stated["tables"]["reason"]) == ("no-estimate", "no-table")
        assert stated["runs"][0]["verdict"]["name"] == "accepted"
        changed = volcal("history", "compare", runs[0], runs[0], "--config", config)
        assert "EXX" in changed.stdout
        refused = volcal("history", "compare", runs[0], "none", "--config", config, exit_code=2)
        assert "the journal has no run none" in refused.stderr


class TestRebuilt:
    def test_the_page_is_that_of_the_runs_end(self, season: Season) -> None:
        for ended in (season.calibrated, season.verified, season.aborted):
            again = render_from_journal(season.state, ended.outcome.run_id, pdf=False)
            assert again == {"report.html": page(season, ended)}

    def test_the_page_of_a_compacted_run_is_the_same(self, season: Season, tmp_path: Path) -> None:
        state = tmp_path / "state"
        shutil.copytree(season.state, state)
        for row in run_heads(state):
            record = packed_record(state, row.row.run)
            assert record is not None
            store_packed(state, record)
            assert record.after_bytes < record.before_bytes / 2
        for ended in (season.calibrated, season.verified, season.aborted):
            again = render_from_journal(state, ended.outcome.run_id, pdf=False)
            assert again == {"report.html": page(season, ended)}

    def test_the_estimate_is_that_of_the_run(self, season: Season) -> None:
        """Residuals and volumetric error against what stands in the estimate file: VE by its own quadratic form."""
        outcome = season.calibrated.outcome
        found = report_of(read_record(season.state, outcome.run_id)).identification
        assert found is not None
        assert outcome.report is not None
        stored = parse_estimate(outcome.report.with_name("estimate.json").read_text(encoding="utf-8"), "estimate.json")
        assert np.array_equal(found.estimate.parameters, stored.parameters)
        grid = evaluation_grid(stored.model.ranges_mm)
        form = QuadraticForm.build(stored.model, grid, stored.tool_offsets[0])
        assert found.volumetric.table_ve_um == pytest.approx(form.value(stored.parameters).aligned_um)
        assert len(found.residuals_mm) == outcome.balls == found.observations.size

    def test_it_does_not_need_the_files_any_more(self, season: Season, tmp_path: Path) -> None:
        """The journal alone, its settings naming files that are gone."""
        gone = {"machine": "/nowhere/machine.toml", "artefact": "/nowhere/bar.toml"}
        copy_journal(season.state, tmp_path, lambda settings: settings | gone)
        text = str(render_from_journal(tmp_path, season.calibrated.outcome.run_id, pdf=False)["report.html"])
        assert "example calibration, 11 balls" in text
        assert "case-study-deflection.csv" in text

    def test_what_an_auditor_asks_for(self, season: Season) -> None:
        text = page(season, season.calibrated)
        record = read_record(season.state, season.calibrated.outcome.run_id)
        staged = record.table("staged")
        assert staged is not None
        assert staged.crc32 is not None
        wanted = (
            "k = 2",
            "Started by",
            "command line",
            "SHA-256",
            f"{staged.crc32:08x}",
            "no compensation",
            "Undetermined parameter combinations",
            "Verification by new measurements",
            "az 20°, el 25°",
            "Measured by",
        )
        for one in wanted:
            assert one in text, one

    def test_the_page_lists_the_acceptance_tests_that_the_command_predicts(self, season: Season) -> None:
        run_id = season.calibrated.outcome.run_id
        stated = volcal_json("acceptance", "--estimate", season.state / run_id)
        found = report_of(read_record(season.state, run_id)).identification
        assert found is not None
        assert found.acceptance is not None
        assert list(found.acceptance.not_measured) == stated["not_measured"]
        listed = {one.test.feature.name: one.figure for one in found.acceptance.all_tests}
        assert list(listed) == [one["figure"] for one in stated["tests"]]
        for one in stated["tests"]:
            figure = listed[one["figure"]]
            assert one["without_table"]["expected_um"] == pytest.approx(
                1e3 * figure.without_table.expected_mm, abs=1e-3
            )
            assert figure.with_table is not None
            # the table of the file has the resolution of the controller
            assert one["with_table"]["expected_um"] == pytest.approx(1e3 * figure.with_table.expected_mm, abs=0.2)
        assert 'id="acceptance"' in page(season, season.calibrated)

    def test_a_verification_has_a_report_of_its_own(self, season: Season) -> None:
        assert season.verified.error is None
        text = page(season, season.verified)
        assert "Result of the night" in text
        assert season.calibrated.outcome.run_id in text
        assert "The 21 geometric errors" not in text

    def test_a_run_that_was_aborted_has_one_too(self, season: Season) -> None:
        assert season.aborted.outcome.state is RunState.ABORTED
        text = page(season, season.aborted)
        assert "somebody pressed abort" in text
        assert "This run has no estimate" in text

    def test_an_unknown_run_is_refused(self, season: Season) -> None:
        with pytest.raises(InputError, match="the last ones are"):
            render_from_journal(season.state, "20200101T000000Z-0000", pdf=False)


class TestPaper:
    def test_the_same_page_gives_the_same_bytes(self, season: Season) -> None:
        text = page(season, season.aborted)
        first = render_pdf(text)
        assert first.startswith(b"%PDF-")
        assert first == render_pdf(text)

    def test_every_figure_is_drawn(self, season: Season) -> None:
        """A part that cannot be drawn would raise."""
        assert len(render_pdf(page(season, season.calibrated))) > 100_000

    def test_a_hole_is_no_report(self) -> None:
        """External images are not fetched, and parts that cannot be drawn are an error."""
        image = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" viewBox="0 0 9 9">'
        image += '<image xlink:href="file:///etc/hostname" width="9" height="9"/></svg>'
        with pytest.raises(InputError, match="cannot be converted to PDF"):
            render_pdf(f"<html><head><style></style></head><body>{image}</body></html>")


def test_the_command(season: Season, tmp_path: Path) -> None:
    config = minimal_config(tmp_path, season)
    out = tmp_path / "out"
    result = volcal("report", "last", "--config", config, "--out", out, "--pdf", "--json")
    assert json.loads(result.stdout)["run_id"] == season.aborted.outcome.run_id
    assert sorted(path.name for path in out.iterdir()) == ["report.html", "report.pdf"]


def test_the_command_writes_a_digital_certificate(season: Season, tmp_path: Path) -> None:
    """Unsigned with a warning, signed by the key of the settings, and with a word on what is missing."""
    config, file, run_id = (
        minimal_config(tmp_path, season),
        tmp_path / "new" / "dcc.xml",
        season.calibrated.outcome.run_id,
    )
    refused = volcal("report", run_id, "--config", config, "--dcc", file, exit_code=2)
    assert "report.laboratory.name, report.laboratory.city, report.laboratory.country" in refused.stderr
    assert not file.exists()
    who = identity("Laboratory")
    (tmp_path / "key.pem").write_bytes(who.key_pem)
    (tmp_path / "key.pem").chmod(0o600)
    (tmp_path / "cert.pem").write_bytes(who.pem)
    config.write_text(
        config.read_text() + '[report]\ncustomer = "C"\n[report.machine]\nserial_number = "7"\n'
        '[report.laboratory]\nname = "L"\ncity = "T"\ncountry = "DE"\n'
    )
    done = volcal("report", run_id, "--config", config, "--dcc", file)
    assert (done.stdout.strip(), "NOT SIGNED" in done.stderr) == (str(file), True)
    assert list(complaints(etree.parse(file).getroot())) == []
    # also the figures of ISO 230 with the table that the run wrote
    assert "with compensation table" in file.read_text(encoding="utf-8")
    with config.open("a") as settings:
        settings.write('[report.signature]\nkey_file = "key.pem"\ncertificate_file = "cert.pem"\n')
    done = volcal("report", run_id, "--config", config, "--dcc", file, "--json")
    assert (json.loads(done.stdout)["signed"], done.stderr) == (True, "")
    assert check_signature(file.read_bytes(), "dcc.xml", [tmp_path / "cert.pem"]).trust is Trust.TRUSTED
    none = volcal("report", season.aborted.outcome.run_id, "--config", config, "--dcc", file, exit_code=2)
    assert "no result that can be certified" in none.stderr
