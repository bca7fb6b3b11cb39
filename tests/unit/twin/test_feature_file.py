"""Feature files: what a drawing states is read, and what cannot be is refused with file, row and column."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import FormatError
from twin.workpiece.feature_file import COLUMNS, OPTIONAL_COLUMNS, parse_features
from twin.workpiece.features import FeatureKind

HEADER = ",".join((*COLUMNS, *OPTIONAL_COLUMNS))


def row(**cells: object) -> str:
    known = dict.fromkeys((*COLUMNS, *OPTIONAL_COLUMNS), "") | {"x_mm": 1, "y_mm": 2, "z_mm": 3, "name": "a"}
    assert not cells.keys() - known.keys()
    return ",".join(str(cell) for cell in (known | cells).values())


def test_every_kind_is_read() -> None:
    lines = [
        row(name="A", kind="datum"),
        row(name="p", kind="point", j=-2, lower_um=-5),
        row(name="d", kind="Distance", to_x_mm=1, to_y_mm=2, to_z_mm=9, lower_um=-5, upper_um=7),
        row(name="b", kind="diameter", size_mm=40),
        row(name="h", kind="position", upper_um=12),
        row(name="f", kind="flatness", size_mm=300, width_mm=200),
    ]
    found = parse_features("\n".join([HEADER, *lines]), "part.csv")
    assert [one.kind for one in found] == [
        FeatureKind.DATUM,
        FeatureKind.POINT,
        FeatureKind.DISTANCE,
        FeatureKind.DIAMETER,
        FeatureKind.POSITION,
        FeatureKind.FLATNESS,
    ]
    _, point, distance, bore, hole, face = found
    assert point.matrix.tolist() == [[0.0, -1.0, 0.0]]
    assert distance.tolerance is not None
    assert (distance.tolerance.lower_mm, distance.tolerance.upper_mm) == (-0.005, 0.007)
    assert np.linalg.norm(bore.points - [1.0, 2.0, 3.0], axis=1) == pytest.approx(20.0)
    assert np.abs(hole.matrix).tolist() == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert np.ptp(face.points, axis=0).tolist() == [300.0, 200.0, 0.0]


def test_columns_that_nothing_uses_may_be_missing() -> None:
    text = "kind,name,z_mm,y_mm,x_mm,upper_um\nposition,h,3,2,1,10\n"
    (hole,) = parse_features(text, "part.csv")
    assert hole.points.tolist() == [[1.0, 2.0, 3.0]]


@pytest.mark.parametrize(
    ("text", "where", "said"),
    [
        ("", {"row": "1", "column": "name"}, "is missing"),
        (HEADER, {}, "contains no feature to predict"),
        (f"{HEADER}\n{row(kind='datum')}", {}, "contains no feature to predict"),
        (f"{HEADER},colour\n", {"row": "1", "column": "colour"}, "is not known"),
        (f"{HEADER},i\n", {"row": "1", "column": "i"}, "appears more than once"),
        (f"{HEADER}\n{row(kind='slot')}", {"row": "2", "column": "kind"}, "'slot' is no kind of feature"),
        (f"{HEADER}\n{row(kind='point', name='')}", {"row": "2", "column": "name"}, "is empty"),
        (f"{HEADER}\n{row(kind='point', name=chr(27) + '[2J')}", {"row": "2", "column": "name"}, "printable"),
        (f"{HEADER}\n{row(kind='point', x_mm='1,5')}", {"row": "2"}, "values, but the header names"),
        (f"{HEADER}\n{row(kind='point', x_mm='one')}", {"row": "2", "column": "x_mm"}, "is not a number"),
        (f"{HEADER}\n{row(kind='point', x_mm=1e6)}", {"row": "2", "column": "x_mm"}, "no size of a workpiece"),
        (f"{HEADER}\n{row(kind='point', size_mm=4)}", {"row": "2", "column": "size_mm"}, "a point has no size_mm"),
        (f"{HEADER}\n{row(kind='diameter')}", {"row": "2", "column": "size_mm"}, "is empty"),
        (f"{HEADER}\n{row(kind='diameter', size_mm=-3)}", {"row": "2"}, "must be a positive number"),
        (f"{HEADER}\n{row(kind='position', lower_um=1)}", {"row": "2", "column": "lower_um"}, "has no lower_um"),
        (f"{HEADER}\n{row(kind='position', upper_um=0)}", {"row": "2"}, "an upper one above 0"),
        (f"{HEADER}\n{row(kind='point', lower_um=1, upper_um=-1)}", {"row": "2"}, "must be below the upper one"),
        (f"{HEADER}\n{row(kind='point')}\n{row(kind='point')}", {"row": "3", "column": "name"}, "name of row 2"),
        (f'{HEADER}\n"{"x" * 200_000}', {}, "not valid CSV"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, where: dict[str, str], said: str) -> None:
    with pytest.raises(FormatError, match=said) as caught:
        parse_features(text, "part.csv")
    assert caught.value.where["file"] == "part.csv"
    assert where.items() <= caught.value.where.items()
