"""The report: its numbers against hand calculation, its page as a browser would read it."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.figures.style import join_markers
from agent.language.sentences import as_it_is, german, without_marks
from agent.reports.page import (
    EventLine,
    Header,
    IdentificationData,
    ReportData,
    RunFacts,
    TemperatureTrace,
    VerificationFacts,
    VerifiedPosition,
)
from agent.reports.page.budget_table import budget_table
from agent.reports.page.curve_figure import draw_cross_effect
from agent.reports.page.data import name_of_positions
from agent.reports.page.document_head import calibration_notes, document_head, instruments
from agent.reports.page.error_curves import cross_effect_curves, error_curve, geometric_error_curves
from agent.reports.page.error_table import ErrorRow, error_rows
from agent.reports.page.identification_sections import null_intro
from agent.reports.page.identity import validity
from agent.reports.page.number_format import fixed, micrometres, number
from agent.reports.page.render import render_report
from agent.reports.page.residual_figures import BallResiduals
from agent.reports.page.run_figures import sensor_look
from agent.reports.page.texts import ENGLISH
from agent.reports.page.workspace_maps import workspace_maps
from agent.reports.run_report import prior_name
from agent.results.estimation import volumetric_summary
from agent.results.facts import ArtefactFacts, Quantity, TableFacts, triple
from agent.results.gates.gate import Gate
from agent.settings.report import ReportSettings
from twin.artefact.artefact import ball_bar
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.observations import Observations
from twin.artefact.position_set import Position, mount_pose, parse_position_set
from twin.compensation.table import build_table, regular_nodes
from twin.errors import FormatError
from twin.formats.estimate_file import format_estimate, parse_estimate
from twin.formats.toml_reading import validate_document
from twin.identification import Estimate, Misfit, Options, identify, predicted_vce
from twin.identification.instruments.check_result import InstrumentCheck, LargestResidual
from twin.identification.normal import PriorPrecision
from twin.identification.predicted import field_forms
from twin.identification.series_prior import SeriesPrior
from twin.machine.anchor import Anchor
from twin.machine.axis_polynomial import AxisPolynomial
from twin.machine.cross_term import CrossTerm
from twin.machine.error_model import ErrorModel
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import parse_chain
from twin.machine.machine_population import family_from_amplitudes
from twin.machine.volumetric import align_rigidly, evaluation_grid
from twin.uncertainty.posterior_budget import posterior_budget
from twin.uncertainty.thermometer_effect import thermometer_effect

RANGES = ((0.0, 1000.0), (0.0, 600.0), (0.0, 500.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, order=3)
OFFSET = np.array([0.0, 150.0, 0.0])
AMPLITUDES = {"positioning_um": 6.0, "straightness_um": 4.0, "rotation_urad": 8.0, "squareness_urad": 12.0}
FAMILY = family_from_amplitudes(MODEL, AMPLITUDES)
BAR = ball_bar(
    "bar & <certified>",
    balls=5,
    length_mm=400.0,
    tilt_rad=0.2,
    holder_length_mm=50.0,
    ball_diameter_mm=20.0,
    standard_uncertainty_mm=5e-4,
)
POSITIONS = parse_position_set("S1+S3", 2)


def observations(rng: np.random.Generator) -> Observations:
    truth = FAMILY.draw(rng, 1)[0]
    points, rows = [], []
    for index, position in enumerate(POSITIONS):
        place = np.array([150.0 + 500.0 * position.station - 300.0, 450.0, 250.0])
        angles = np.radians([position.azimuth_deg, position.elevation_deg])
        pose = mount_pose(place, MountGeometry(), *angles)
        points.append(pose.apply(BAR.balls) - OFFSET)
        rows += [(index, ball, angles[1]) for ball in range(5)]
    commanded = np.concatenate(points)
    found = commanded - exact_deviation(MODEL, commanded, OFFSET, truth)
    found += rng.normal(0.0, 1e-3, commanded.shape)
    index, ball, elevation = np.array(rows).T
    n = len(rows)
    return Observations(
        position=index.astype(np.int64),
        ball=ball.astype(np.int64),
        tool=np.zeros(n, dtype=np.int64),
        axis_positions=found,
        covariance=np.tile(1e-6 * np.eye(3), (n, 1, 1)),
        temperature_c=np.full(n, 20.5),
        elevation_rad=elevation,
        tool_offsets=OFFSET[None],
    )


def report_data() -> ReportData:
    seen = observations(np.random.default_rng(3))
    estimate = identify(MODEL, seen, BAR, FAMILY, Options())
    nodes = regular_nodes(RANGES, (100.0, 100.0, 100.0))
    table = build_table(MODEL, estimate.parameters, nodes, OFFSET, Anchor(np.zeros(3)), seen.axis_positions)
    header = Header(
        title="Volumetric calibration",
        run_id="run-17",
        timestamp="2026-03-01T02:03:04.000Z",
        software_version="1.2.3",
        state="complete",
        position_set="S1+S3, 2 stations",
    )
    volumetric = volumetric_summary(estimate, OFFSET)
    found = IdentificationData.of(seen, estimate, POSITIONS, volumetric, TableFacts.of(table, "0badcafe"))
    return ReportData(header, "mill <5>", ArtefactFacts.of(BAR), "probe", triple(OFFSET), found)


def estimate_of(data: ReportData) -> Estimate:
    assert data.identification is not None
    assert isinstance(data.identification.estimate, Estimate)
    return data.identification.estimate


def with_estimate(data: ReportData, estimate: Estimate) -> ReportData:
    assert data.identification is not None
    return replace(data, identification=replace(data.identification, estimate=estimate))


@pytest.fixture(scope="module")
def offline() -> ReportData:
    return report_data()


@pytest.fixture(scope="module")
def offline_page(offline: ReportData) -> str:
    return render_report(offline)


def test_the_report_in_german_leaves_names_and_reasons_of_people_as_they_are(offline: ReportData) -> None:
    """Names that are words of the catalogue, such as a machine that is called Night."""
    run = RunFacts(touches=1, machine_minutes=1.0, reason="aborted: Prior (Night)")
    named = replace(offline, machine=as_it_is("Night"), tool_name=as_it_is("Prior"), run=run)
    cells = re.findall(r">([^<]+)<", render_report(named, language="de"))
    assert {"Night", "abgebrochen: Prior (Night)", "Kalibrierschein"} <= {*cells}
    assert any(cell.startswith("Prior ") for cell in cells)
    assert not any(mark in "".join(cells) for mark in "\u2068\u2069")


class Page(HTMLParser):
    """Collects section ids, every attribute that may load something, and the elements left open."""

    VOID = frozenset({"meta", "br", "link", "img", "input", "hr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.loads: list[str] = []
        self.tags: list[str] = []
        self._open: list[str] = []
        self.misnested: list[str] = []
        self.text: list[str] = []
        self.feed(text)
        self.unclosed = self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._collect(attrs)
        if tag not in self.VOID:
            self._open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._collect(attrs)

    def handle_endtag(self, tag: str) -> None:
        if not self._open or self._open.pop() != tag:
            self.misnested.append(tag)

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def _collect(self, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href", "xlink:href", "srcset", "data", "action"):
                self.loads.append(value or "")


class TestPage:
    def test_it_is_well_formed_and_ids_are_unique(self, offline_page: str) -> None:
        page = Page(offline_page)
        assert page.misnested == []
        assert page.unclosed == []
        assert len(page.ids) == len(set(page.ids))

    def test_all_21_errors_are_there(self, offline_page: str) -> None:
        page = Page(offline_page)
        curves = {name.rsplit("-", 1)[1] for name in page.ids if "curve-E" in name and "E_" not in name}
        assert curves == {f"E{direction}{axis}" for axis in "XYZ" for direction in "XYZABC"}
        assert {"A0Z", "B0Z", "C0Y"} <= set(page.text)
        assert sum("curve-E_" in name for name in page.ids) == 2

    def test_nothing_is_loaded_from_anywhere(self, offline_page: str) -> None:
        page = Page(offline_page)
        assert page.loads
        assert all(load.startswith(("#", "data:image/png;base64,")) for load in page.loads)
        assert "script" not in page.tags
        assert "@import" not in offline_page
        addresses = set(re.findall(r"https?://[^\"\s<>]+", offline_page))
        assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}
        assert all(target.startswith("#") for target in re.findall(r"url\(([^)]*)\)", offline_page))

    def test_every_reference_within_the_page_leads_somewhere(self, offline_page: str) -> None:
        page = Page(offline_page)
        inside = {load[1:] for load in page.loads if load.startswith("#")}
        inside |= set(re.findall(r"url\(#([^)]*)\)", offline_page))
        assert inside <= set(page.ids)

    def test_figures_follow_the_theme(self, offline_page: str) -> None:
        assert not re.search(r"#0[1-6]0[1-6]0[1-6]", offline_page)
        assert "prefers-color-scheme: dark" in offline_page
        assert "size: A4" in offline_page

    def test_text_from_files_is_escaped(self, offline_page: str) -> None:
        assert "mill &lt;5&gt;" in offline_page
        assert "bar &amp; &lt;certified&gt;" in offline_page

    def test_sections_of_a_run_are_left_out_offline(self, offline_page: str) -> None:
        ids = Page(offline_page).ids
        assert not {"verification", "gates", "events", "warnings"} & set(ids)
        wanted = {"summary", "validity", "errors", "map", "residuals", "temperatures", "fit", "null-space"}
        assert wanted | {"table", "parameters"} <= set(ids)

    def test_identity_and_table_are_stated(self, offline_page: str) -> None:
        text = " ".join(Page(offline_page).text)
        for wanted in ("run-17", "2026-03-01 02:03 UTC", "1.2.3", "0badcafe", "11 × 7 × 6", "valid for this offset"):
            assert wanted in text


class TestRunSections:
    @pytest.mark.parametrize(("touches", "said"), [(3, True), (None, False)])
    def test_positions_whose_balls_cannot_be_checked_are_counted(
        self, offline: ReportData, touches: int | None, said: bool
    ) -> None:
        found = offline.identification
        assert found is not None
        seen = found.observations
        here = seen.position == seen.position[0]
        few = seen.select(np.flatnonzero(~here | (np.cumsum(here) <= 4)))
        run = RunFacts(800, 91.2, touches_checked_together=touches)
        shown = replace(found, observations=few)
        data = replace(offline, run=run, identification=shown)
        counted = f"1 of {len(set(seen.position.tolist()))} position"
        statements = [text for text in validity(data, shown) if text.startswith("Not checked: ")]
        assert [counted in text and "fewer than 5 balls" in text for text in statements] == [True] * said

    def test_a_run_shows_what_it_decided_and_proved(self, offline: ReportData) -> None:
        proof = VerificationFacts(
            False,
            "Not better: the old table is active again.",
            Quantity(9.0, 0.2),
            Quantity(9.5),
            1.5,
            (VerifiedPosition("station 1", 9.0, 9.5, 1.5), VerifiedPosition("station 2", None, 3.0, 1.5)),
        )
        trace = TemperatureTrace("column", np.array([0.0, 60.0]), np.array([20.0, 20.4]))
        event = EventLine("2026-03-01T02:03:04Z", "retry", "ball 3")
        run = RunFacts(800, 91.2, verification=proof, temperatures=(trace,), events=(event,))
        gate = Gate("fit", False, 3.2, 2.0, "normalised χ²")
        page = Page(render_report(replace(offline, run=run, gates=(gate,), warnings=("mind the probe",))))
        text = " ".join(page.text)
        assert {"verification", "gates", "events", "warnings"} <= set(page.ids)
        for wanted in ("Not better", "mind the probe", "not passed", "ball 3", "91 min", "800", "9.00 ± 0.40 µm"):
            assert wanted in text

    def test_rejected_balls_are_named(self, offline: ReportData) -> None:
        rejected = replace(estimate_of(offline), rejected=((4, 2, 0),))
        text = " ".join(Page(render_report(with_estimate(offline, rejected))).text)
        place = POSITIONS[4]
        assert f"station {place.station}, azimuth {place.azimuth_deg:g}°, elevation {place.elevation_deg:g}°" in text


STATED: dict[str, Any] = {
    "number_prefix": "VC-",
    "customer": "Prior & <Sons>",
    "machine": {"maker": "Maker", "model": "M 400", "serial_number": "17"},
    "instruments": [
        {"kind": "thermometer", "name": "Night", "certificate": "K-1", "calibrated": "2025-01-31", "due": "2026-01-31"},
        {"kind": "sensor", "serial_number": "S 2", "calibrated": "2026-03-02"},
        {"kind": "probe", "calibrated": "2026-01-01", "due": "2026-03-01"},
    ],
    "tolerances": {"EXX": 1e4, "A0Z": 1e4, "VCE": 1e-3},
    "measured_by": "A. Body",
}


def stated(**changes: Any) -> ReportSettings:
    return validate_document(STATED | changes, "settings", ReportSettings)


class TestDocument:
    def test_what_nobody_has_stated_is_not_stated(self, offline: ReportData) -> None:
        head = dict(document_head(offline, ENGLISH))
        assert as_it_is("run-17") == head.pop("Report number")
        assert set(head.values()) == {"not stated"}
        probe, artefact, thermometer = instruments(offline, ENGLISH).rows
        assert probe[1:] == thermometer[1:] == ("not stated",) * 5
        assert [without_marks(cell) for cell in artefact[1:4]] == [BAR.name, "not stated", BAR.certificate]
        assert calibration_notes(offline, ENGLISH) == ()

    def test_what_is_stated_stands_at_the_head_in_both_languages(self, offline: ReportData) -> None:
        data = replace(offline, document=stated())
        english, german = (render_report(data, language=language) for language in ("en", "de"))
        for page in (english, german):
            for words in ("VC-run-17", "Prior &amp; &lt;Sons&gt;", ">17<", ">Night<", "A. Body"):
                assert words in page
        assert "Thermometer (Night, K-1): the calibration was due on 2026-01-31, before this" in english
        assert "Thermometer (Night, K-1): Die Kalibrierung war am 31.01.2026 fällig, vor dieser" in german
        assert "Sensor (S 2): the calibration of 2026-03-02 is later than this measurement of 2026-03-01." in english
        assert english.count("the calibration was due on") == 1
        assert not re.search(r"Statement|not stated|nicht stated|conforms", german)

    @pytest.mark.parametrize("mark", ["\u00ad", "\u061c", "\u200e", "\u202e", "\u2066", "\ufeff"])
    def test_invisible_characters_and_marks_of_the_writing_direction_are_refused(self, mark: str) -> None:
        with pytest.raises(FormatError) as refused:
            stated(customer=f"Prior{mark} & Sons")
        assert refused.value.where["key"] == "customer"

    @pytest.mark.parametrize(
        ("changes", "key"),
        [
            ({"instruments": [{"kind": "probe", "calibrated": "2026-02-01", "due": "2026-02-01"}]}, "instruments[0]"),
            ({"instruments": [{"kind": "laser"}]}, "instruments[0].kind"),
            ({"tolerances": {"EXQ": 1.0}}, "tolerances.EXQ"),
            ({"tolerances": {"EXX": 0.0}}, "tolerances.EXX"),
            ({"customer": "a\nb"}, "customer"),
            ({"customer": "  "}, "customer"),
            ({"machine": {"maker": "x" * 121}}, "machine.maker"),
        ],
    )
    def test_a_head_that_cannot_be_is_refused_by_its_key(self, changes: dict[str, Any], key: str) -> None:
        with pytest.raises(FormatError) as refused:
            stated(**changes)
        assert refused.value.where["key"].startswith(key)

    def test_tolerances_are_judged_with_a_guard_band(self, offline: ReportData) -> None:
        row = ErrorRow("EXX", "positioning of X", "µm", -10.0, 2.0)
        expected = {
            None: "no tolerance",
            12.0: "conforms",
            11.9: "undecided",
            8.0: "undecided",
            7.9: "does not conform",
        }
        assert {tolerance: row.conformity(tolerance).value for tolerance in expected} == expected
        with_waves = replace(row, waves=1.0)
        assert [with_waves.conformity(one).value for one in (13.0, 12.9, 7.0, 6.9)] == [
            *("conforms", "undecided"),
            *("undecided", "does not conform"),
        ]
        page = Page(render_report(replace(offline, document=stated())))
        for words in ("conforms", "VCE with table, predicted", "the new table is not active"):
            assert words in page.text
        assert "ISO 14253-1" in " ".join(page.text)

    def test_there_is_one_convention_of_coverage(self, offline_page: str) -> None:
        text = " ".join(Page(offline_page).text)
        assert not re.search(r"σ|k = 1", text)
        assert "coverage factor k = 2" in text


class TestBudget:
    def test_the_columns_add_up_to_what_the_report_states(self, offline: ReportData) -> None:
        found, estimate = offline.identification, estimate_of(offline)
        assert found is not None
        table = budget_table(found, OFFSET, ENGLISH)
        values = np.array([[float(cell.replace("–", "0")) for cell in row[1:]] for row in table.rows])
        assert np.sqrt((values[:-1] ** 2).sum(axis=0)) == pytest.approx(values[-1], abs=0.03)
        stated_um = predicted_vce(estimate, evaluation_grid(RANGES), OFFSET).aligned_um
        rows = {row.name: row for row in error_rows(found)}
        assert rows["EXX"].waves > 0.0
        assert rows["EAX"].waves == rows["A0Z"].waves == 0.0
        total = dict(zip(table.heads[1:], values[-1].tolist(), strict=True))
        assert total["VCE / µm"] == pytest.approx(stated_um, abs=0.006)
        assert total["U(EXX) / µm"] == pytest.approx(rows["EXX"].expanded_uncertainty, abs=0.006)
        assert total["U(A0Z) / µrad"] == pytest.approx(rows["A0Z"].expanded_uncertainty, abs=0.006)

    def test_the_row_of_the_ball_centres_says_that_instruments_joined(self, offline: ReportData) -> None:
        largest = LargestResidual(7, 1.0, 1e-3, "mm")
        for joined, name in ((True, "ball centres and other instruments"), (False, "ball centres (touches")):
            check = InstrumentCheck("laser.csv", "laser", 5, 3.0, 4, 0.6, largest, not joined, joined)
            found = with_estimate(offline, replace(estimate_of(offline), instruments=(check,))).identification
            assert found is not None
            assert [row[0].startswith(name) for row in budget_table(found, OFFSET, ENGLISH).rows].count(True) == 1

    def test_touches_and_family_are_told_apart_as_for_a_linear_estimate(self, offline: ReportData) -> None:
        """An estimate with random information N of all unknowns: H = N + P, where P is the prior precision. Given the
        nuisance unknowns, the noise causes H⁻¹ N H⁻¹ of the other ones, and the family H⁻¹ P H⁻¹."""
        base, rng = estimate_of(offline), np.random.default_rng(8)
        unknowns, blocks = base.unknowns, base.unknowns.blocks
        prior = PriorPrecision(blocks, None, SeriesPrior.of(MODEL, unknowns.scale)).matrix(base.scales)
        rows = rng.normal(size=(blocks.size // 2, blocks.size))
        information = rows.T @ rows
        covariance = np.asarray(np.linalg.inv(information + prior), dtype=np.float64)
        misfit = Misfit.of(unknowns, base.z, covariance, 0.0)
        assert misfit is not None
        own = np.r_[0 : blocks.parameters.stop, blocks.misfit.start : blocks.misfit.stop]
        known = np.linalg.inv((information + prior)[np.ix_(own, own)])
        scale = np.concatenate((unknowns.scale, np.ones(len(own) - MODEL.size)))
        units = np.multiply.outer(*2 * [np.where(scale > 0.0, scale, 1.0)])
        free = np.multiply.outer(scale > 0.0, scale > 0.0)  # the family holds some parameters at zero
        estimate = replace(base, z_covariance=covariance, misfit=misfit)
        budget = posterior_budget(estimate, family_prior=True)
        for name, matrix in (("centres", information), ("undetermined", prior)):
            expected = known @ matrix[np.ix_(own, own)] @ known
            assert budget.parts[name] / units == pytest.approx(free * expected, rel=1e-6, abs=1e-9)
        total = sum(budget.parts.values()) / units
        assert total == pytest.approx(free * covariance[np.ix_(own, own)], rel=1e-6, abs=1e-9)
        apart = posterior_budget(estimate, family_prior=False)
        assert apart.parts["centres and prior"] == pytest.approx(budget.parts["centres"] + budget.parts["undetermined"])

    def test_a_thermometer_has_the_part_that_the_validity_states(self) -> None:
        options = Options(temperature_standard_uncertainty_k=0.5)
        estimate = identify(MODEL, observations(np.random.default_rng(3)), BAR, FAMILY, options)
        forms = field_forms(estimate, evaluation_grid(RANGES), OFFSET)
        parts = posterior_budget(estimate, family_prior=True).remaining_rms(forms[1])
        stated_mm = thermometer_effect(estimate, forms).contribution.aligned_mm
        assert parts["temperature"] == pytest.approx(stated_mm, rel=1e-6)


class TestRanges:
    def test_the_range_of_a_slope_is_twice_its_coefficient(self) -> None:
        values, covariance = np.zeros(MODEL.size), np.zeros((MODEL.size, MODEL.size))
        place = MODEL.index("EXX[1]")
        values[place], covariance[place, place] = -0.004, 0.0005**2
        curve = error_curve(MODEL, values, covariance, "EXX")
        assert curve is not None
        assert curve.range == pytest.approx((8.0, 2.0))  # P1 = ∓1 at the ends; U = 2 · 2 · 0.5

    def test_the_true_range_is_rarely_beyond_range_and_uncertainty(self) -> None:
        """Error motions drawn from their posterior, well determined ones and ones that nothing determines."""
        rng, block = np.random.default_rng(9), MODEL.block["EYY"]
        covariance = np.zeros((MODEL.size, MODEL.size))
        factor = rng.normal(size=(block.stop - block.start,) * 2) * 1e-3
        covariance[block, block] = factor @ factor.T
        for size in (0.0, 0.02):
            values = np.zeros(MODEL.size)
            values[block] = size * rng.normal(size=block.stop - block.start)
            curve = error_curve(MODEL, values, covariance, "EYY")
            assert curve is not None
            total = sum(curve.range)
            drawn = rng.multivariate_normal(curve.value, curve.covariance, 4000, method="eigh")
            assert np.mean(np.ptp(drawn, axis=1) <= total) > 0.93


class TestCurves:
    def values(self, **terms: float) -> np.ndarray:
        values = np.zeros(MODEL.size)
        for name, value in terms.items():
            values[MODEL.index(name.replace("__", "[").replace("_", "]"))] = value
        return values

    def test_a_second_order_term_is_the_second_legendre_polynomial(self) -> None:
        values = self.values(EYX__2_=0.003)
        covariance = np.zeros((MODEL.size, MODEL.size))
        place = MODEL.index("EYX[2]")
        covariance[place, place] = 0.001**2
        curve = {curve.name: curve for curve in geometric_error_curves(MODEL, values, covariance)}["EYX"]
        assert curve.unit == "µm"
        assert curve.value[[0, 40, 80]] == pytest.approx([3.0, -1.5, 3.0])
        assert curve.sigma[[0, 40, 80]] == pytest.approx([1.0, 0.5, 1.0])
        assert curve.position_mm[[0, 40, 80]] == pytest.approx([0.0, 500.0, 1000.0])

    def test_correlated_terms_share_their_variance(self) -> None:
        covariance = np.zeros((MODEL.size, MODEL.size))
        first, second = MODEL.index("EAZ[1]"), MODEL.index("EAZ[2]")
        covariance[np.ix_([first, second], [first, second])] = 1e-12 * np.array([[1.0, -1.0], [-1.0, 1.0]])
        curves = geometric_error_curves(MODEL, np.zeros(MODEL.size), covariance)
        sigma = {curve.name: curve for curve in curves}["EAZ"].sigma
        assert sigma[[0, 80]] == pytest.approx([2.0, 0.0], abs=1e-9)  # at the ends P1 = ∓1, P2 = 1: var (P1 - P2)²

    def test_the_cross_effect_is_shown_at_full_overhang(self) -> None:
        values = np.zeros(MODEL.size)
        values[[MODEL.index("CROSS[b1]"), MODEL.index("CROSS[b2]")]] = 0.002, 0.001
        values[MODEL.index("CROSS[c1]")] = 4e-6
        straight, turned = cross_effect_curves(MODEL, values, np.zeros((MODEL.size, MODEL.size)))
        assert straight.value[[0, 40, 80]] == pytest.approx([0.0, 1.25, 3.0])
        assert turned.value[[0, 40, 80]] == pytest.approx([0.0, 2.0, 4.0])
        assert turned.unit == "µrad"

    def test_the_cross_effect_of_other_beams_is_shown_along_the_axis_of_each_error(self) -> None:
        rails = (
            CrossTerm("CROSS[rail.EZX]", "EZX", AxisPolynomial((((1, 1, 0), 2.0), ((2, 1, 0), -1.0)))),
            CrossTerm("CROSS[rail.EAX]", "EAX", AxisPolynomial((((1, 1, 0), 1.0),))),
        )
        model = replace(MODEL, cross_effect=(), structure=rails)
        values, covariance = np.zeros(model.size), np.zeros((model.size, model.size))
        values[-2:], covariance[-2, -2] = (0.004, 5e-6), 0.001**2
        sag, roll = cross_effect_curves(model, values, covariance)
        assert [(one.name, one.argument, one.unit) for one in (sag, roll)] == [
            ("E_ZX", "X", "µm"),
            ("E_AX", "X", "µrad"),
        ]
        assert sag.position_mm[[0, -1]].tolist() == list(RANGES[0])
        assert sag.value[[0, 40, 80]] == pytest.approx([0.0, 3.0, 4.0])
        assert sag.sigma[[0, 40, 80]] == pytest.approx([0.0, 0.75, 1.0])
        assert roll.value[[0, 40, 80]] == pytest.approx([0.0, 2.5, 5.0])
        drawn = draw_cross_effect((sag, roll, sag, roll))
        assert drawn.count("curve-E_ZX") == 2


class TestNumbers:
    def test_squareness_alone_by_hand(self, offline: ReportData) -> None:
        """d = (0, -A0Z z, 0); a turn w about X leaves (A0Z - w)² var z + w² var y, which is least for
        w = A0Z var z / (var y + var z). The uncertainty scales with A0Z's own."""
        values, covariance = np.zeros(MODEL.size), np.zeros((MODEL.size, MODEL.size))
        place = MODEL.index("A0Z")
        values[place], covariance[place, place] = 20e-6, (2e-6) ** 2
        estimate: Estimate = replace(estimate_of(offline), parameters=values, covariance=covariance)
        summary = volumetric_summary(estimate, OFFSET)
        yy, zz = np.var(np.linspace(0.0, 600.0, 20)), np.var(np.linspace(0.0, 500.0, 20))
        by_hand = 20e-3 * np.sqrt(yy * zz / (yy + zz))
        assert summary.table_ve_um == pytest.approx(by_hand, rel=1e-9)
        assert summary.before_aligned.standard_uncertainty_um == pytest.approx(0.1 * by_hand, rel=1e-9)

    def test_the_map_is_the_aligned_field(self, offline: ReportData) -> None:
        """The planes, put under the standard grid and aligned with it, point by point."""
        values = FAMILY.draw(np.random.default_rng(5), 1)[0]
        nothing = np.zeros((MODEL.size, MODEL.size))
        estimate = replace(estimate_of(offline), parameters=values, covariance=nothing, misfit=None)
        maps = workspace_maps(estimate, OFFSET, np.zeros((1, 3)))
        grid = evaluation_grid(RANGES)
        field = exact_deviation(MODEL, grid, OFFSET, values)
        removed = field - align_rigidly(grid + OFFSET, field)
        motion = np.linalg.lstsq(np.column_stack([np.ones(len(grid)), grid]), removed)[0]  # affine, so exact
        for count, height in enumerate((0.0, 250.0, 500.0)):
            plane = np.stack(np.meshgrid(np.linspace(0, 1000, 49), np.linspace(0, 600, 25), indexing="ij"), axis=-1)
            points = np.column_stack([plane.reshape(-1, 2), np.full(49 * 25, height)])
            left = (
                exact_deviation(MODEL, points, OFFSET, values)
                - np.column_stack([np.ones(len(points)), points]) @ motion
            )
            assert maps.deviation[count].length_um.ravel() == pytest.approx(
                1e3 * np.linalg.norm(left, axis=1), abs=0.01
            )
            assert maps.uncertainty[count].length_um.max() < 1e-3

    def test_the_uncertainty_map_is_the_posterior_by_sampling(self, offline: ReportData) -> None:
        rng = np.random.default_rng(6)
        factor = rng.normal(0.0, 1e-6, (MODEL.size, MODEL.size))
        estimate = replace(estimate_of(offline), covariance=factor @ factor.T, misfit=None)
        draws = rng.standard_normal((60, MODEL.size)) @ factor.T
        sampled = [
            workspace_maps(replace(estimate, parameters=draw), OFFSET, np.zeros((1, 3))).deviation[2] for draw in draws
        ]
        spread = np.sqrt(np.mean([plane.length_um**2 for plane in sampled], axis=0))
        stated = workspace_maps(estimate, OFFSET, np.zeros((1, 3))).uncertainty[2]
        assert np.median(spread / stated.length_um) == pytest.approx(1.0, abs=0.15)

    def test_the_uncertainty_map_adds_up_to_the_predicted_error(self, offline: ReportData) -> None:
        """Simpson's rule over the three planes, misfit included, comes near the rms over the volume."""
        maps = workspace_maps(estimate_of(offline), OFFSET, np.zeros((1, 3))).uncertainty
        bottom, middle, top = (float(np.mean(plane.length_um**2)) for plane in maps)
        grid = evaluation_grid(RANGES, (21, 13, 13))
        stated = predicted_vce(estimate_of(offline), grid, OFFSET).aligned_um
        assert np.sqrt((bottom + 4.0 * middle + top) / 6.0) == pytest.approx(stated, rel=0.15)

    def test_rms_per_ball_leaves_the_rejected_out(self) -> None:
        residuals = BallResiduals(
            position=np.array([0, 1, 2, 0]),
            ball=np.array([0, 0, 0, 1]),
            residual_um=np.array([[3.0, 0, 0], [-3.0, 0, 0], [99.0, 0, 0], [0, 2.0, 0]]),
            standardised=np.zeros((4, 3)),
            accepted=np.array([True, True, False, True]),
        )
        balls, rms = residuals.rms_per_ball
        assert balls.tolist() == [0, 1]
        assert rms.tolist() == [[3.0, 0.0, 0.0], [0.0, 2.0, 0.0]]


class TestMarkers:
    def test_a_series_becomes_one_path_with_its_line_and_filling(self) -> None:
        shape = '<defs> <path id="m" d="M 0 -1.5 L 1e-1 2 z" style="stroke: red"/> </defs>'
        uses = "".join(f'<use xlink:href="#m" x="{x}" y="20" style="fill: blue"/>\n' for x in (10, 11.5))
        joined = join_markers(f'<g>{shape}{uses}<use xlink:href="#m" x="1" y="2" style="fill: none"/></g>')
        first = '<path d="M 10 18.5 L 10.1 22 z M 11.5 18.5 L 11.6 22 z" style="fill: blue; stroke: red"/>'
        assert joined.split("\n") == [
            f"<g>{first}",
            '<path d="M 1 0.5 L 1.1 4 z" style="fill: none; stroke: red"/>',
            "</g>",
        ]

    @pytest.mark.parametrize(
        ("style", "dot"),
        [
            ("fill: red", "fill: none; stroke: red; stroke-opacity: 1; stroke-width: 2; stroke-linecap: round"),
            (
                "fill: red; fill-opacity: 0.5; stroke: red; stroke-opacity: 0.5; stroke-width: 0.7",
                "fill: none; stroke: red; stroke-opacity: 0.5; stroke-width: 2.7; stroke-linecap: round",
            ),
            ("fill: red; stroke: blue", None),
            ("fill: red; fill-opacity: 0.5; stroke: red; stroke-opacity: 0.9", None),
            ("fill: red; fill-opacity: 0.5; stroke: red", None),
            ("fill: none; stroke: red", None),
            ("stroke: red", None),
            ("", None),
        ],
    )
    def test_a_disc_of_one_colour_is_a_line_without_length(self, style: str, dot: str | None) -> None:
        circle = "M 0 1 " + "C 1 2 3 4 5 6 \n" * 8 + "z\n"
        svg = join_markers(
            f'<defs> <path id="m" d="{circle}"/> </defs><use xlink:href="#m" x="3" y="4" style="{style}"/>'
        )
        if dot is None:
            assert f'style="{style}"' in svg
            assert svg.count("C") == 8
        else:
            assert svg == f'<path d="M 3 4 h 0" style="{dot}"/>\n'

    def test_a_page_refers_to_no_marker(self, offline_page: str) -> None:
        assert "<use" not in offline_page


class TestWords:
    @pytest.mark.parametrize(
        ("value", "text"), [(0.0, "0"), (1234567.0, "1230000"), (-0.01234, "−0.0123"), (2.5e-7, "2.5e−07")]
    )
    def test_numbers_read_as_people_write_them(self, value: float, text: str) -> None:
        assert number(value) == text

    def test_uncertainty_is_expanded_and_has_the_values_decimals(self) -> None:
        assert micrometres(Quantity(12.34, 0.5)) == "12.3 ± 1.0 µm"
        assert micrometres(Quantity(2.345, 0.051)) == "2.35 ± 0.10 µm"
        assert micrometres(Quantity(3.0)) == "3.00 µm"
        assert micrometres(None) == "–"
        assert fixed(-1.0, 1) == "−1.0"
        assert fixed(-0.001, 2) == "0.00"

    def test_a_complete_set_is_named_and_a_choice_is_counted(self) -> None:
        assert name_of_positions(parse_position_set("S2+S3", 3)) == "S2+S3, 3 stations"
        assert name_of_positions(parse_position_set("S1", 1)) == "S1, 1 station"
        assert name_of_positions((*parse_position_set("S1", 2), Position(2, 10.0, 20.0))) == "7 user-defined positions"


def test_the_prior_of_a_fused_night_is_that_of_the_nights_before(offline: ReportData) -> None:
    text = format_estimate(estimate_of(offline), {})
    calibrated = parse_estimate(text, "estimate.json")
    document = json.loads(text)
    document["carried_over"]["drift_factor"] = {"value": 1.5, "log_deviation": 0.1}
    fused = parse_estimate(json.dumps(document), "estimate.json")
    chosen = {"prior": True, "weights": "full"}
    assert prior_name(chosen, calibrated) == prior_name(chosen, None) == "machine family"
    assert prior_name(chosen, fused) == "earlier nights"
    assert prior_name({"prior": False}, calibrated) == "none"
    assert german("earlier nights") != "earlier nights"


def test_without_the_family_nothing_is_said_to_follow_from_it(offline: ReportData) -> None:
    found = offline.identification
    assert found is not None
    model = estimate_of(offline).model
    few: Any = SimpleNamespace(model=model, rank=model.size - 2)
    with_family, without = (
        null_intro(replace(found, estimate=few, family_prior=prior_is_family)) for prior_is_family in (True, False)
    )
    assert "The other 2 directions follow from the machine family alone" in with_family
    assert "family" not in without
    assert "The other 2 directions do not follow from this measurement" in without


def test_no_two_sensors_look_alike() -> None:
    assert [sensor_look(count)[1] for count in range(4)] == ["-", "--", "-.", ":"]
    assert len({sensor_look(count) for count in range(16)}) == 16
