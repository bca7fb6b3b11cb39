import pytest

from twin.errors import ModelError
from twin.machine.kinematic_chain import Chain, parse_chain


def test_reads_the_case_study():
    chain = parse_chain("Tool-y-Z-x-BED-workpiece")
    assert chain == Chain(("Y", "Z", "X"), ())
    assert str(chain) == "tool-Y-Z-X-bed-workpiece"


def test_axes_on_both_sides_go_from_tool_to_bed_and_from_bed_to_workpiece():
    chain = parse_chain("tool-Z-bed-Y-X-workpiece")
    assert chain.tool_side == ("Z",)
    assert chain.workpiece_side == ("Y", "X")
    assert parse_chain(str(chain)) == chain


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Y-Z-X-bed-workpiece", "begin with 'tool'"),
        ("tool-Y-Z-X-bed", "end with 'workpiece'"),
        ("tool-Y-Z-X-workpiece", "'bed' exactly once"),
        ("tool-bed-Y-Z-X-bed-workpiece", "'bed' exactly once"),
        ("tool-Y-Z-bed-workpiece", "axis X is missing"),
        ("tool-Y-Z-X-bed-Y-workpiece", "axis Y is listed twice"),
        ("tool-Y-Z-X-bed-A-workpiece", "'A' is not a linear axis"),
        ("tool-Y--X-bed-Z-workpiece", "'' is not a linear axis"),
        ("", "begin with 'tool'"),
    ],
)
def test_a_wrong_chain_is_named(text, says):
    with pytest.raises(ModelError, match=says) as caught:
        parse_chain(text)
    assert caught.value.where["chain"] == text
    assert "tool-Y-Z-X-bed-workpiece" in caught.value.hint
