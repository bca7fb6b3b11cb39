"""Values of the library in a notebook: pictures and tables, short representations, data frames."""

from __future__ import annotations

import base64
import re
import sys
from collections.abc import Mapping
from html.parser import HTMLParser
from importlib.metadata import version
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import volcal
from volcal.frames import columns

PNG = b"\x89PNG\r\n\x1a\n"
VOID = {"img"}


class Balanced(HTMLParser):
    """HTML whose elements are all closed."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        del attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def values(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Any]:
    folder = tmp_path_factory.mktemp("export")
    setup = volcal.case_study()
    balls = volcal.read_balls(volcal.shipped_file("examples/case-study-balls.csv"), setup.machine)
    estimate = volcal.identify(balls, setup.machine, setup.artefact, order=3)
    return {
        "setup": setup,
        "machine": setup.machine,
        "artefact": setup.artefact,
        "balls": balls,
        "estimate": estimate,
        "table": volcal.compensation_table(estimate, balls),
        "errors": volcal.volumetric_errors(estimate),
        "prediction": volcal.predict(estimate, [[0.0, 0.0, 0.0], [2000.0, 650.0, 750.0]]),
        "design": volcal.evaluate(setup, "S1"),
        "simulation": volcal.simulate(setup, "S1"),
        "export": volcal.export_table(volcal.compensation_table(estimate, balls), "neutral", folder),
    }


NAMES = ("setup", "machine", "artefact", "balls", "estimate", "table", "errors", "prediction", "design", "simulation",
         "export")  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_a_value_is_shown_as_html_and_has_a_short_representation(values: Mapping[str, Any], name: str) -> None:
    value = values[name]
    html = value._repr_html_()
    parsed = Balanced()
    parsed.feed(html)
    parsed.close()
    assert parsed.open == []
    assert "<table>" in html
    text = repr(value)
    assert len(text) <= 120
    assert "\n" not in text
    assert type(value).__name__ in text


@pytest.mark.parametrize("name", ["estimate", "table"])
def test_an_estimate_and_a_table_show_their_figure(values: Mapping[str, Any], name: str) -> None:
    (picture,) = re.findall(r"data:image/png;base64,([^']+)", values[name]._repr_html_())
    assert base64.b64decode(picture).startswith(PNG)


def test_a_stored_estimate_is_shown(values: Mapping[str, Any], tmp_path: Any) -> None:
    stored = volcal.read_estimate(volcal.write_estimate(values["estimate"], tmp_path / "estimate.json"))
    assert "standard uncertainty" in str(stored._repr_html_())
    assert len(repr(stored)) < 80
    assert len(columns(stored)["value"]) == len(stored.parameters)


def test_a_figure_is_the_picture_of_its_cell(values: Mapping[str, Any]) -> None:
    assert volcal.error_map(values["estimate"])._repr_png_().startswith(PNG)
    assert volcal.table_map(values["table"])._repr_png_().startswith(PNG)


def test_names_are_not_taken_as_html(values: Mapping[str, Any]) -> None:
    from dataclasses import replace

    html = replace(values["machine"], name="<b>mill & co</b>")._repr_html_()
    assert "&lt;b&gt;mill &amp; co&lt;/b&gt;" in html


def test_the_version_is_that_of_the_distribution() -> None:
    assert volcal.__version__ == version("volcal")


@pytest.mark.parametrize(
    ("name", "rows", "expected"),
    [
        ("balls", 260, {"position", "station", "ball", "x_mm", "sigma_z_um", "temperature_c"}),
        ("simulation", 78, {"position", "ball", "x_mm"}),
        ("prediction", 2, {"x_mm", "error_x_um", "standard_uncertainty_z_um"}),
        ("table", 41 * 14 * 16, {"x_mm", "correction_y_um", "measured"}),
        ("design", 8, {"station", "azimuth_deg", "elevation_deg"}),
    ],
)
def test_columns_of_a_data_frame_have_one_entry_for_each_row(
    values: Mapping[str, Any], name: str, rows: int, expected: set[str]
) -> None:
    found = columns(values[name])
    assert expected <= set(found)
    assert {len(column) for column in found.values()} == {rows}


def test_columns_hold_the_values_in_the_units_of_their_names(values: Mapping[str, Any]) -> None:
    balls, table = values["balls"].observations, values["table"]
    found = columns(values["balls"])
    np.testing.assert_array_equal(found["y_mm"], balls.axis_positions[:, 1])
    np.testing.assert_allclose(found["sigma_x_um"], 1e3 * np.sqrt(balls.covariance[:, 0, 0]))
    nodes = columns(table)
    at = np.column_stack([nodes["x_mm"], nodes["y_mm"], nodes["z_mm"]])
    np.testing.assert_allclose(nodes["correction_z_um"], 1e3 * table.at(at)[:, 2], atol=1e-9)
    estimate = columns(values["estimate"])
    assert set(estimate["unit"]) <= {"µm", "µrad"}
    assert len(estimate["name"]) == len(values["estimate"].parameters)


def test_a_data_frame_is_made_with_pandas(values: Mapping[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda columns: ("frame", sorted(columns))))
    kind, names = volcal.frame(values["design"])
    assert (kind, names) == ("frame", ["azimuth_deg", "elevation_deg", "station"])


def test_a_real_data_frame_has_the_rows_of_the_values(values: Mapping[str, Any]) -> None:
    for name in ("balls", "estimate", "prediction", "table", "design", "simulation"):
        assert len(volcal.frame(values[name])) == len(next(iter(columns(values[name]).values())))


def test_without_pandas_and_without_a_frame_the_error_says_what_to_do(
    values: Mapping[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(volcal.DataError, match="pip install pandas"):
        volcal.frame(values["balls"])
    with pytest.raises(volcal.DataError, match="no data frame of a str"):
        volcal.frame("balls")
