"""Design of an artefact with its mount: costs, frames, search and front, each against its own arithmetic."""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from study_case import shipped_job

from agent.model_files import load_artefact
from agent.planning.case_file import CASE_STUDY, SHIPPED_CONFIGURATION, load_case, shipped_case
from agent.planning.cycle_time import set_alone
from agent.planning.design.artefact_costs import SHIPPED_COSTS, ArtefactCosts, Equipment, load_costs
from agent.planning.design.artefact_design import ArtefactDesign, ArtefactDesigner
from agent.planning.design.artefact_effects import property_effects
from agent.planning.design.artefact_files import COLUMNS, write_artefact_design
from agent.planning.design.artefact_screening import ScreenedVariant, Screening
from agent.planning.design.artefact_search import PROPERTIES, VariantChoices, VariantSearch, euro_front
from agent.planning.design.artefact_variants import (
    ArtefactVariant,
    CentrePlace,
    PresentEquipment,
    RotationCentre,
    parse_centre,
)
from agent.settings.load import load_settings
from agent.studies.monte_carlo import ErrorSample, ProcedureTask
from agent.studies.study import StudyCase
from agent.studies.workers import LocalWorkers
from drivers.errors import ConfigurationError, InputError
from twin.artefact.ball_spacing import BallSpacing
from twin.artefact.mount_geometry import MountGeometry
from twin.artefact.position_set import Position
from twin.identification import Options
from twin.machine.volumetric import evaluation_grid
from twin.uncertainty.residual_field_form import FieldForm

BAR_500 = Equipment(length_mm=500.0, balls=5, shaft_mm=120.0, pedestal_mm=900.0, fork=False, stations=2)


@cache
def costs() -> ArtefactCosts:
    return load_costs(SHIPPED_COSTS)


@cache
def present() -> PresentEquipment:
    return PresentEquipment(shipped_job(), CASE_STUDY.parent, costs().calibration)


class TestCosts:
    def test_the_purchase_is_the_sum_of_the_prices_of_the_file(self) -> None:
        price = tomllib.loads(SHIPPED_COSTS.read_text())
        mount = price["mount"]
        expected = {
            "bar": price["bar"]["euro"] + 500 * price["bar"]["euro_per_mm"],
            "balls": 5 * price["ball"]["euro"],
            "calibration": price["calibration"]["euro"] + 5 * price["calibration"]["euro_per_ball"],
            "mount": mount["euro"] + 120 * mount["euro_per_mm_of_shaft"] + 900 * mount["euro_per_mm_of_pedestal"],
            "stations": 2 * price["station"]["euro"],
        }
        assert costs().purchase(BAR_500) == pytest.approx(expected)
        assert costs().purchase_euro(BAR_500) == pytest.approx(sum(expected.values()))
        forked = costs().purchase_euro(replace(BAR_500, fork=True)) - costs().purchase_euro(BAR_500)
        assert forked == pytest.approx(mount["fork_euro"])

    def test_a_run_pays_its_share_of_the_purchase_and_its_minutes(self) -> None:
        price = tomllib.loads(SHIPPED_COSTS.read_text())
        again = price["calibration"]["euro"] + 5 * price["calibration"]["euro_per_ball"]
        once = costs().purchase_euro(BAR_500) - again
        shares = once / price["use"]["runs"] + again / price["calibration"]["runs"]
        hours = 0.5 * price["use"]["machine_euro_per_hour"] + 0.1 * price["use"]["operator_euro_per_hour"]
        assert costs().run_euro(BAR_500, 30.0, 6.0) == pytest.approx(shares + hours)

    @given(
        st.floats(100.0, 3000.0), st.integers(3, 30), st.floats(0.0, 400.0), st.floats(0.0, 2000.0), st.integers(1, 10)
    )  # fmt: skip
    def test_more_of_anything_never_costs_less(
        self, length_mm: float, balls: int, shaft_mm: float, pedestal_mm: float, stations: int
    ) -> None:
        one = Equipment(length_mm, balls, shaft_mm, pedestal_mm, fork=False, stations=stations)
        changes: list[dict[str, Any]] = [
            {"length_mm": length_mm + 1.0},
            {"balls": balls + 1},
            {"shaft_mm": shaft_mm + 1.0},
            {"pedestal_mm": pedestal_mm + 1.0},
            {"fork": True},
            {"stations": stations + 1},
        ]
        for change in changes:
            more = replace(one, **change)
            assert costs().purchase_euro(more) > costs().purchase_euro(one)
            assert costs().run_euro(more, 30.0, 0.0) > costs().run_euro(one, 30.0, 0.0)
        assert costs().run_euro(one, 31.0, 0.0) > costs().run_euro(one, 30.0, 0.0)

    @pytest.mark.parametrize(
        ("former", "now", "key", "said"),
        [
            ("euro_per_mm = 0.40", "euro_per_mm = -1.0", "bar.euro_per_mm", "greater than or equal to 0"),
            ("euro_per_mm = 0.40", "euro_for_mm = 0.4", "bar.euro_for_mm", "unknown key"),
            ("fork_euro = 450.0", "", "mount.fork_euro", "is missing"),
            ("runs = 1000.0", "runs = nan", "use.runs", "finite"),
        ],
    )
    def test_a_wrong_cost_file_is_refused_by_its_key(
        self, tmp_path: Path, former: str, now: str, key: str, said: str
    ) -> None:
        text = SHIPPED_COSTS.read_text()
        assert former in text
        path = tmp_path / "costs.toml"
        path.write_text(text.replace(former, now, 1))
        with pytest.raises(ConfigurationError, match=said) as caught:
            load_costs(path)
        assert caught.value.where["key"] == key
        assert caught.value.where["file"] == str(path)


def turned(points: np.ndarray, azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    """Turn points (n, 3) about Y by minus the elevation, so that X rises, and then about Z by the azimuth."""
    az, el = math.radians(azimuth_deg), math.radians(elevation_deg)
    raised = np.array([[math.cos(el), 0, -math.sin(el)], [0, 1, 0], [math.sin(el), 0, math.cos(el)]])
    round_z = np.array([[math.cos(az), -math.sin(az), 0], [math.sin(az), math.cos(az), 0], [0, 0, 1]])
    return np.asarray(points @ raised.T @ round_z.T)


class TestFrames:
    @pytest.mark.parametrize(
        ("centre", "shaft"),
        [
            ("beside:120", (0.0, -120.0, 0.0)),
            ("beside:80", (0.0, -80.0, 0.0)),
            ("above:150", (0.0, 0.0, 150.0)),
            ("middle:150", (0.0, 0.0, 0.0)),
        ],
    )
    @pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (45.0, 30.0), (-90.0, -45.0)])
    def test_balls_are_where_the_shaft_and_the_angles_put_them(
        self, centre: str, shaft: tuple[float, float, float], azimuth: float, elevation: float
    ) -> None:
        variant = replace(
            present().variant,
            centre=parse_centre(centre), balls=4, length_mm=900.0, tilt_deg=0.0, height_mm=800.0, across_mm=950.0,
            stations=3,
        )  # fmt: skip
        job = present().job_of(variant)
        places = present().places_mm(variant)
        along = np.array([-450.0, -150.0, 150.0, 450.0])
        balls = np.column_stack([along, np.full(4, -60.0), np.zeros(4)]) + shaft
        expected = places[1] + turned(balls, azimuth, elevation) - (0.0, 250.0, 0.0)
        found = job.layout.nominal(Position(2, azimuth, elevation))
        assert found == pytest.approx(expected, abs=0.02)  # the bar of the case is not tilted by exactly 15 degrees
        assert places[:, 1:] == pytest.approx(np.array([[950.0, 800.0]] * 3))

    def test_the_stations_are_even_and_as_near_the_ends_as_now_for_the_length(self) -> None:
        found = present().places_mm(replace(present().variant, length_mm=750.0, stations=3))
        assert found[:, 0] == pytest.approx([350.0, 2000.0, 3650.0])
        own = present().places_mm(present().variant)
        assert own == pytest.approx(np.array(shipped_job().settings.stations.places_mm))

    def test_the_present_variant_is_that_of_the_settings(self) -> None:
        one = present().variant
        assert (one.length_mm, one.balls, one.tilt_deg, one.stations) == (1500.0, 11, 15.0, 4)
        assert one.centre == RotationCentre(CentrePlace.BESIDE, 120.0)
        job = present().job_of(one)
        assert np.abs(job.artefact.balls - shipped_job().artefact.balls).max() < 0.1
        assert job.settings.mount == shipped_job().settings.mount

    @pytest.mark.parametrize(("spacing", "stated_mm"), [("ends", ()), ("even", (0.0, 200.0, 450.0, 1499.0))])
    def test_a_bar_that_was_designed_is_the_present_variant_of_the_next_design(
        self, spacing: str, stated_mm: tuple[float, ...]
    ) -> None:
        designed = replace(
            present().variant,
            length_mm=stated_mm[-1] if stated_mm else 1800.0,
            balls=len(stated_mm) or 6,
            spacing=BallSpacing(spacing),
            tilt_deg=0.0,
            stated_mm=stated_mm,
        )
        again = PresentEquipment(present().job_of(designed), CASE_STUDY.parent, costs().calibration)
        assert again.variant == designed
        assert again.artefact(again.variant).balls == pytest.approx(present().artefact(designed).balls)

    def test_the_certificate_is_a_and_l_over_k(self) -> None:
        stated = costs().calibration
        artefact = present().artefact(replace(present().variant, tilt_deg=0.0))
        deviation_mm = np.sqrt(np.diagonal(artefact.covariance)).reshape(-1, 3)
        scale = 1e-6 * stated.length_standard_uncertainty_ppm * 750.0
        assert deviation_mm[0, 0] == pytest.approx(math.hypot(1e-3 * stated.standard_uncertainty_um, scale))
        assert deviation_mm[5, 0] == pytest.approx(1e-3 * stated.standard_uncertainty_um)

    def test_stated_places_of_the_balls_replace_the_spacing(self) -> None:
        stated = (0.0, 140.0, 400.0, 900.0)
        artefact = present().artefact(replace(present().variant, balls=4, length_mm=900.0, stated_mm=stated))
        assert artefact.balls[:, 0] == pytest.approx([-450.0, -310.0, -50.0, 450.0])
        assert "stated" in artefact.name

    def test_a_longer_bar_hangs_by_the_fourth_power(self) -> None:
        sagging = replace(shipped_job().artefact, sag_mm=0.016, sag_standard_uncertainty_mm=0.004)
        own = PresentEquipment(replace(shipped_job(), artefact=sagging), CASE_STUDY.parent, costs().calibration)
        half = own.artefact(replace(own.variant, length_mm=750.0))
        assert half.sag_mm == pytest.approx(0.001, rel=1e-3)
        assert half.sag_standard_uncertainty_mm == pytest.approx(0.00025, rel=1e-3)

    @pytest.mark.parametrize("text", ["beside", "beside:0", "under:100", "middle:-3", "above:x", "above:inf"])
    def test_other_rotation_centres_are_refused(self, text: str) -> None:
        with pytest.raises(ValueError, match=r".*"):
            parse_centre(text)

    def test_an_oblique_shaft_is_refused(self) -> None:
        with pytest.raises(ConfigurationError, match="neither beside"):
            RotationCentre.of(MountGeometry(shaft_direction=(0.0, 1.0, 1.0)))

    @pytest.mark.parametrize(
        ("case", "said"), [("hand-placed", "no mount to design"), ("two-mounts", "one mount that")]
    )
    def test_other_arrangements_are_refused(self, case: str, said: str) -> None:
        job = load_case(shipped_case(case).settings)
        with pytest.raises(InputError, match=said):
            PresentEquipment(job, SHIPPED_CONFIGURATION, costs().calibration)


@dataclass(frozen=True, eq=False)
class KnownScreening(Screening):
    """Screening whose errors are a known function of the variant."""

    error_um: Callable[[ArtefactVariant], float] = lambda _: 1.0

    def _screened(self, variant: ArtefactVariant) -> ScreenedVariant:
        error_um = self.error_um(variant)
        reason = "" if error_um < math.inf else "the bar hits the table"
        return ScreenedVariant(variant, self.purchase_euro(variant), error_um, 30.0, 40.0, 9, 63, reason)


CHOICES = VariantChoices(
    balls=(5, 7, 11),
    length_mm=(900.0, 1500.0),
    stations=(2, 3, 4),
    centre=(parse_centre("beside:120"), parse_centre("middle:150")),
    height_mm=(600.0, 750.0),
    across_mm=(1000.0,),
    spacing=(BallSpacing.EVEN, BallSpacing.ENDS),
    tilt_deg=(0.0, 15.0),
)


def search_with(error_um: Callable[[ArtefactVariant], float], budget_euro: float, most: int = 1000) -> VariantSearch:
    screening = KnownScreening(present(), costs(), 30.0, 45.0, set_alone, error_um=error_um)
    return VariantSearch(screening, CHOICES, budget_euro, most)


def separable_um(one: ArtefactVariant) -> float:
    """Error that each property changes by a factor, whatever the others are: 2 µm at the best."""
    of_balls = {5: 1.3, 7: 1.0, 11: 1.2}[one.balls] * (1.0 if one.length_mm == 1500.0 else 1.5)
    of_stations = {2: 1.4, 3: 1.0, 4: 1.1}[one.stations] * (1.0 if one.height_mm == 600.0 else 1.05)
    of_mount = 1.0 if one.centre.place is CentrePlace.MIDDLE else 1.1
    return 2.0 * of_balls * of_stations * of_mount * (1.0 if one.spacing is BallSpacing.ENDS else 1.02)


class TestSearch:
    def test_the_optimum_of_separable_effects_is_found_with_few_variants(self) -> None:
        search = search_with(separable_um, 1e5)
        best = search.run()[0]
        assert best.vce_um == pytest.approx(2.0)
        assert (best.variant.balls, best.variant.stations, best.variant.height_mm) == (7, 3, 600.0)
        every = math.prod(len(CHOICES.of(name)) for name in PROPERTIES)
        assert len(search.screening.screened) < every / 3
        changed = set(search.changes(best.variant))
        assert changed <= {one.variant for one in search.screening.screened}

    def test_nothing_beyond_the_budget_is_chosen(self) -> None:
        dear = costs().purchase_euro(present().equipment(search_with(separable_um, 1e5).run()[0].variant))
        search = search_with(separable_um, dear - 1.0)
        assert all(one.purchase_euro <= dear - 1.0 for one in search.run())

    def test_too_small_a_budget_names_the_least_sufficient_one(self) -> None:
        with pytest.raises(InputError, match="are too little") as caught:
            search_with(separable_um, 1000.0).run()
        least = int(caught.value.message.split("cost ")[1].split(" €")[0])
        assert search_with(separable_um, float(least)).run()
        with pytest.raises(InputError, match="are too little"):
            search_with(separable_um, least - 1.0).run()

    def test_if_nothing_can_be_measured_the_reason_is_told(self) -> None:
        with pytest.raises(InputError, match="the bar hits the table") as caught:
            search_with(lambda _: math.inf, 1e5).run()
        assert caught.value.where["key"] == "--slot"

    def test_the_search_ends_at_the_limit(self) -> None:
        search = search_with(separable_um, 1e5, most=6)
        assert search.run()
        assert search.exhausted
        assert len(search.screening.screened) == 6

    def test_a_variant_that_cannot_be_measured_is_never_chosen_and_stays_listed(self) -> None:
        def error_um(one: ArtefactVariant) -> float:
            return math.inf if one.stations == 3 else separable_um(one)

        search = search_with(error_um, 1e5)
        assert all(one.variant.stations != 3 for one in search.run())
        assert {one.reason for one in search.screening.screened if not one.measurable} == {"the bar hits the table"}

    @given(st.lists(st.tuples(st.integers(1, 20), st.integers(1, 20)), min_size=1, max_size=25))
    def test_the_front_is_what_nothing_else_beats(self, pairs: list[tuple[int, int]]) -> None:
        every = [ScreenedVariant(present().variant, float(euro), float(um), 30.0, 1.0, 3, 9) for euro, um in pairs]
        front = {(one.purchase_euro, one.vce_um) for one in euro_front(every)}
        unbeaten = {
            (float(euro), float(um))
            for euro, um in pairs
            if not any(e <= euro and u <= um and (e, u) != (euro, um) for e, u in pairs)
        }
        assert front == unbeaten


def test_the_effect_of_a_property_is_the_mean_over_all_pairs_that_differ_in_it_alone() -> None:
    def screened(balls: int, stations: int, vce_um: float) -> ScreenedVariant:
        variant = replace(present().variant, balls=balls, stations=stations)
        return ScreenedVariant(variant, 5000.0, vce_um)

    every = [
        screened(7, 3, 2.0), screened(5, 3, 4.0),
        screened(7, 2, 3.0), screened(5, 2, 1.5),
        screened(7, 4, 2.0), screened(5, 4, math.inf),
        screened(7, 6, 9.0),
    ]  # fmt: skip
    few, station = property_effects(every[0].variant, [every[1], every[2]], every)
    assert (few.name, few.values, few.ratios) == ("balls", (7, 5), (2.0, 0.5))
    assert few.mean_percent == pytest.approx(0.0)
    assert (station.name, station.ratios) == ("stations", (1.5, 0.375))
    assert station.mean_percent == pytest.approx(100.0 * (0.75 - 1.0))
    [alone] = property_effects(every[0].variant, [every[6]], [])
    assert alone.mean_percent is None


def test_a_slot_that_is_too_short_is_a_reason() -> None:
    screening = Screening(present(), costs(), 1.0, 90.0, set_alone)
    found = screening.result(present().variant)
    assert not found.measurable
    assert "too short" in found.reason


@pytest.fixture(scope="module")
def found() -> ArtefactDesign:
    """Return the design of a small choice on the case study, with the time of the set alone."""
    small = replace(
        CHOICES,
        balls=(5, 11), length_mm=(1500.0,), stations=(2,), height_mm=(750.0,),
        centre=(parse_centre("beside:120"),), spacing=(BallSpacing.EVEN,), tilt_deg=(15.0,),
    )  # fmt: skip
    screening = Screening(present(), costs(), 14.0, 45.0, set_alone)
    search = VariantSearch(screening, small, 9000.0, 10)
    designer = ArtefactDesigner(search, 45.0, 1, prove=lambda _: None, say=lambda _: None)
    return designer.run(free_stations=True)


class TestWholeDesign:
    def test_the_run_fits_and_its_cost_is_that_of_its_minutes(self, found: ArtefactDesign) -> None:
        best = found.best
        assert best.result.minutes <= 14.0
        carrying = best.result.minutes_by_phase.by_phase["station changes"]
        equipment = present().equipment(best.variant)
        assert best.run_euro == pytest.approx(costs().run_euro(equipment, best.result.minutes, carrying))
        assert best.result.preflight_passed

    def test_the_expected_error_is_that_of_simulated_identifications(self, found: ArtefactDesign) -> None:
        """Machines, touches and artefacts are drawn, measured and identified. The machines have the deflection of the
        machine file, which the design does not know: the simulated error may be larger by a tenth."""
        machines, job = 60, found.best.result.problem.job
        case = StudyCase(job, Options(), 7, machines, LocalWorkers(1), lambda *_: None, lambda _: None)
        planned = job.procedure.plan(found.best.result.positions).observations
        grid = evaluation_grid(job.machine.model.ranges_mm)
        form = FieldForm.build(job.machine.model, case.assumptions, grid, case.tool_offset)
        task = ProcedureTask.of(case, planned)
        sample = ErrorSample.compensated(form, [task(number) for number in range(machines)])
        simulated_um, error_um = sample.expected.aligned_um, sample.standard_error.aligned_um
        assert sample.refused == 0
        assert found.best.vce_um - 3.0 * error_um < simulated_um < 1.1 * found.best.vce_um + 3.0 * error_um
        assert error_um < 0.1 * found.best.vce_um

    def test_the_files_describe_the_equipment_and_can_be_read_again(
        self, found: ArtefactDesign, tmp_path: Path
    ) -> None:
        files = {path.name for path in write_artefact_design(found, 14.0, 9000.0, tmp_path)}
        assert files == {path.name for path in tmp_path.iterdir()}
        job = found.best.result.problem.job
        again = load_artefact(tmp_path / "artefact.toml")
        assert again.balls == pytest.approx(job.artefact.balls)
        assert again.covariance == pytest.approx(job.artefact.covariance)
        settings = load_settings(tmp_path / "settings.toml")
        assert settings.stations == job.settings.stations
        assert settings.mount == job.settings.mount
        assert settings.artefact == tmp_path / "artefact.toml"
        assert load_case(tmp_path / "settings.toml").positions == tuple(found.best.result.positions)
        rows = list(csv.DictReader((tmp_path / "variants.csv").read_text().splitlines()))
        assert tuple(rows[0]) == COLUMNS
        assert len(rows) == len(found.screened)
        assert "best found" in (tmp_path / "artefact-design.svg").read_text()
