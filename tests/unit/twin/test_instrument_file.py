"""Files with the readings of an instrument: what is read, and what is wrong with them and where."""

from __future__ import annotations

import numpy as np
import pytest

from twin.errors import TwinError
from twin.formats.instrument_file import InstrumentMachine, parse_instrument
from twin.formats.instrument_section import InstrumentSection, instrument_documents
from twin.identification.instruments.check_result import InstrumentCheck, LargestResidual
from twin.identification.instruments.readings import InstrumentReadings
from twin.machine.error_model import ErrorModel
from twin.machine.kinematic_chain import parse_chain

RANGES = ((0.0, 1000.0), (0.0, 600.0), (0.0, 500.0))
MODEL = ErrorModel.uniform(parse_chain("tool-Y-Z-X-bed-workpiece"), RANGES, 3)
MACHINE = InstrumentMachine({"probe": (0.0, 0.0, -150.0)}, RANGES, MODEL)
LASER = """\
# instrument = "laser"
# tool = "probe"
# sigma_um = 0.3
# scale_um_per_m = 0.8
x_mm,y_mm,z_mm,reading_um
50,300,250,0
450,300,250,1.5
950,300,250,-2.0
"""
BALLBAR = """\
# instrument = "ballbar"
# tool_offset_mm = [0, 0, -100]
# plane = "YZ"
# centre_mm = [500, 300, 250]
# radius_mm = 150
angle_deg,reading_um,sigma_um
0,1,0.2
90,2,0.2
180,-1,0.3
270,0,0.2
"""


def read(text: str) -> InstrumentReadings:
    return parse_instrument(text, "/folder/laser.csv", "laser.csv", MACHINE)


def test_a_laser_line() -> None:
    found = read(LASER)
    assert (found.name, found.kind, found.lines) == ("laser.csv", "laser", (6, 7, 8))
    assert found.readings == pytest.approx([0.0, 1.5e-3, -2.0e-3])
    assert found.along == pytest.approx(np.tile([1.0, 0.0, 0.0], (3, 1)))
    assert found.tool_offset == pytest.approx([0.0, 0.0, -150.0])
    # 0.8 µm/m over 900 mm, common to all readings, and 0.3 µm of each
    assert found.stated_covariance[2, 2] == pytest.approx(0.3e-3**2 + 0.72e-3**2)
    assert found.stated_covariance[1, 2] == pytest.approx(0.32e-3 * 0.72e-3)


def test_a_circle_in_its_plane() -> None:
    found = read(BALLBAR)
    assert found.points == pytest.approx(
        np.array([[500, 450, 250], [500, 300, 400], [500, 150, 250], [500, 300, 100]]), abs=1e-9
    )
    assert found.along == pytest.approx((found.points - [500.0, 300.0, 250.0]) / 150.0)
    assert found.noise == pytest.approx([0.2e-3, 0.2e-3, 0.3e-3, 0.2e-3])
    # length and scale are added to the noise; the four lobes that three readings share cancel at no angle
    assert found.stated_covariance[0, 2] == pytest.approx((0.5e-3) ** 2 - 1.5e-3**2 * 1e-6 - (0.1e-3) ** 2)


def test_straightness_level_and_values() -> None:
    straightness = LASER.replace('"laser"', '"straightness"\n# across = "Z"').replace("# scale_um_per_m = 0.8\n", "")
    assert read(straightness).along[0] == pytest.approx([0.0, 0.0, 1.0])
    assert read(straightness).free.shape == (3, 2)
    level = "# instrument = 'level'\n# about = 'Y'\n# sigma_urad = 1\nx_mm,y_mm,z_mm,reading_urad\n0,0,0,0\n900,0,0,4\n"
    assert read(level).about[1] == pytest.approx([0.0, 1.0, 0.0])
    assert read(level).readings == pytest.approx([0.0, 4e-6])
    values = "# instrument = 'values'\nparameter,value,sigma\nC0Y,12,3\nEXX[1],-4,0.5\n"
    found = read(values)
    assert found.parameters == ("C0Y", "EXX[1]")
    assert found.readings == pytest.approx([12e-6, -4e-3])
    assert found.noise == pytest.approx([3e-6, 0.5e-3])
    assert (found.unit(0), found.unit(1)) == ("rad", "mm")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LASER.replace('# instrument = "laser"\n', ""), "key 'instrument' is missing"),
        (LASER.replace('"laser"', '"leser"'), "unknown instrument 'leser'"),
        (LASER.replace("# tool =", "# tol ="), "unknown key 'tol'"),
        (LASER.replace('"probe"', '"reflector"'), "no tool 'reflector'"),
        (LASER.replace('# tool = "probe"\n', ""), "neither tool nor tool_offset_mm"),
        (LASER.replace("# sigma_um = 0.3\n", ""), "no standard uncertainty above zero is stated"),
        (LASER.replace("1.5", "1,5"), "row 7"),
        (LASER.replace("1.5", "abc"), "'abc' is not a number (file /folder/laser.csv, row 7, column reading_um)"),
        (LASER.replace("950,300", "1950,300"), "outside the travel of X"),
        (LASER.replace("450,300", "450,320"), "mm off the line"),
        (LASER.replace("50,300", "600,300", 1), "on the other side of the first target, 150.0 mm behind it"),
        (LASER[: LASER.index("50,300")], "no reading follows the header"),
        (LASER[: LASER.index("450,300")], "all targets are at the same place"),
        (LASER.replace("reading_um", "value_um"), "column 'reading_um' is missing"),
        (LASER.replace('"laser"', '"straightness"\n# across = "X"').replace("# scale_um_per_m = 0.8\n", ""), "across"),
        (BALLBAR.replace("150", "400"), "the circle leaves the travel of Y"),
        (BALLBAR.replace("[500,", "[-90000,"), "the circle leaves the travel of X, 0 to 1000 mm"),
        (BALLBAR.replace("# plane", '# tool = "probe"\n# plane'), "tool and tool_offset_mm both say where"),
        (BALLBAR[: BALLBAR.index("180")], "determine no more than the set-up"),
        ("# instrument = 'values'\nparameter,value,sigma\nEXX[7],1,1\n", "is no parameter of the error model"),
        ("# instrument = 'values'\nparameter,value,sigma\nC0Y,1,1\nC0Y,1,1\n", "is stated twice"),
        ("# instrument = 'values'\nparameter,value,sigma\nC0Y,1,0\n", "must be above zero"),
        ("# instrument = [\nx\n", "not valid TOML"),
        ("", "key 'instrument' is missing"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(text: str, said: str) -> None:
    with pytest.raises(TwinError) as caught:
        read(text)
    assert said in str(caught.value)
    assert "/folder/laser.csv" in str(caught.value)


def test_results_go_to_the_estimate_file_and_back() -> None:
    checks = (
        InstrumentCheck(
            "laser.csv", "laser", 20, 41.0, 19, 0.002, LargestResidual(7, -3.9, -8.1e-3, "mm"), True, False
        ),
        InstrumentCheck("level.csv", "level", 5, 3.0, 4, 0.6, LargestResidual(3, 1.2, 2e-6, "rad"), False, True),
    )
    documents = instrument_documents(checks)
    assert documents[0]["largest"] == {"row": 7, "sigmas": -3.9, "size": pytest.approx(-8.1), "unit": "µm"}
    back = tuple(InstrumentSection.model_validate(document).check for document in documents)
    assert [one.largest.text for one in back] == [one.largest.text for one in checks]
    assert back[0].largest.text == "row 7: 3.9 sigma, -8.1 µm"
