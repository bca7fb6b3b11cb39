"""Proposed actions help machines that share no code with the program as much as they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from agent.workpiece.proposed_actions import action_text
from campaigns.foreign.artefact import measure_at, tilted_bar
from campaigns.foreign.machine import TOOL, DrawnMachine, aligned_rms_um, grid
from campaigns.foreign.score import family_of
from campaigns.foreign.trials import GENERATORS, places_of
from twin.errors import DataError, ModelError
from twin.identification import Estimate, identify_by_evidence
from twin.machine.error_model import ErrorModel, Ranges
from twin.machine.forward_model import exact_deviation
from twin.machine.kinematic_chain import Chain, parse_chain
from twin.machine.mounting import Foot, Guide, Mounting
from twin.workpiece.action_fields import ActionKind, MechanicalAction, candidates
from twin.workpiece.mechanical_actions import ActionPlan, plan_actions


@dataclass(frozen=True, eq=False)
class KnownMachine:
    """Estimate of a machine whose parameters have the covariance `covariance`, by default 1 nm² and 1 µrad²."""

    model: ErrorModel
    parameters: np.ndarray
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    misfit: None = None
    scatter_mm2: float = 0.0

    def __post_init__(self) -> None:
        if not self.covariance.size:
            object.__setattr__(self, "covariance", 1e-12 * np.eye(self.model.size))


def straight_model(chain: str) -> ErrorModel:
    return ErrorModel.uniform(parse_chain(chain), ((0.0, 900.0), (0.0, 600.0), (0.0, 400.0)), 1, ())


MACHINES = 6
GRID = grid((60, 20, 20))
"""Positions over which a volumetric error is taken."""
OFFSET = np.asarray(TOOL, dtype=np.float64)


def estimated(number: int) -> tuple[DrawnMachine, Estimate]:
    rng = np.random.default_rng([number, 55])
    machine, bar = GENERATORS["mixed"](rng), tilted_bar(rng)
    return machine, identify_by_evidence(family_of, measure_at(machine, bar, places_of("S3"), rng).seen, bar.artefact)


SHOES_MM = 600.0
FEET = (
    Foot("a", (-300.0, -200.0)),
    Foot("b", (4200.0, -200.0)),
    Foot("c", (-300.0, 900.0)),
    Foot("d", (4200.0, 950.0)),
)
MOUNTING = Mounting(
    {
        "X": Guide(SHOES_MM, (0.0, -500.0, -400.0)),
        "Y": Guide(SHOES_MM, (0.0, -900.0, 50.0)),
        "Z": Guide(SHOES_MM, (-100.0, -600.0, 0.0)),
    },
    FEET,
)
CHAIN = parse_chain("tool-Y-Z-X-bed-workpiece")


def tool_points(
    chain: Chain,
    actions: Sequence[MechanicalAction],
    positions: np.ndarray,
    ranges: Ranges,
    mounting: Mounting = MOUNTING,
) -> np.ndarray:
    """Return the tool points (n, 3) in the coordinates of the workpiece on a machine without errors after the actions,
    by rigid bodies. From the bed outwards, each carriage carries the next one; a table moves against the displayed
    position."""

    def carried(axes: Sequence[str], sign: float) -> tuple[np.ndarray, Rotation]:
        """Return origin and orientation of the last carriage in the coordinates of the bed."""
        point, frame = np.zeros((len(positions), 3)), Rotation.identity(len(positions))
        for name in axes:
            axis = "XYZ".index(name)
            at = positions[:, axis]
            for one in (one for one in actions if one.axis == name and one.kind is ActionKind.SQUARENESS):
                about = np.cross(np.eye(3)[axis], np.eye(3)["XYZ".index(one.towards)])
                frame = frame * Rotation.from_rotvec(one.amount * about)
            stretched = at * (
                1.0 + sum(one.amount for one in actions if one.axis == name and one.kind is ActionKind.SCALE)
            )
            point = point + frame.apply(sign * stretched[:, None] * np.eye(3)[axis])
            centre = np.array(mounting.guides[name].centre_mm)
            for one in (one for one in actions if one.axis == name):
                shift, turn = carriage_on(one, at, sign, ranges[axis])
                point = point + frame.apply(shift + centre - turn.apply(centre))
                frame = frame * turn
        return point, frame

    origin, frame = carried(tuple(reversed(chain.tool_side)), 1.0)
    table, table_frame = carried(chain.workpiece_side, -1.0)
    return np.asarray(table_frame.inv().apply(origin + frame.apply(OFFSET) - table))


def carriage_on(
    action: MechanicalAction, at: np.ndarray, sign: float, travel: tuple[float, float]
) -> tuple[np.ndarray, Rotation]:
    """Return displacement (n, 3) and turn of a carriage at axis positions (n,), from where its two shoes stand."""
    along = np.eye(3)["XYZ".index(action.axis)]
    if action.kind is ActionKind.LEVEL:
        roll = action.amount * ((at - travel[0]) / (travel[1] - travel[0]) - 0.5)
        return np.zeros((len(at), 3)), Rotation.from_rotvec(roll[:, None] * along)
    if action.kind is not ActionKind.STRAIGHTNESS:
        return np.zeros((len(at), 3)), Rotation.identity(len(at))
    places, shims = [shim.at_mm for shim in action.shims], [shim.amount_mm for shim in action.shims]
    assert (places[0], places[-1]) == (travel[0] - 0.5 * SHOES_MM, travel[1] + 0.5 * SHOES_MM)
    assert min(shims) == 0.0
    rail = make_interp_spline(places, shims, k=3, bc_type="natural")
    first, last = rail(at - 0.5 * SHOES_MM), rail(at + 0.5 * SHOES_MM)
    across = np.eye(3)["XYZ".index(action.towards)]
    tilt = sign * np.arctan2(last - first, SHOES_MM)
    return 0.5 * (first + last)[:, None] * across, Rotation.from_rotvec(tilt[:, None] * np.cross(along, across))


def true_error_um(machine: DrawnMachine, plan: ActionPlan | None = None) -> float:
    """True volumetric error after the actions."""
    field = machine.deviation(GRID).copy()
    if plan is not None:
        ranges = ((0.0, 4000.0), (0.0, 1300.0), (0.0, 1500.0))
        field += tool_points(CHAIN, plan.actions, GRID, ranges) - tool_points(CHAIN, (), GRID, ranges)
    return aligned_rms_um(GRID + TOOL, field)


def test_the_gain_is_as_stated() -> None:
    inside, gains = [], []
    kinds: set[ActionKind] = set()
    for number in range(MACHINES):
        machine, estimate = estimated(number)
        plan = plan_actions(estimate, OFFSET, mounting=MOUNTING)
        kinds.update(one.kind for one in plan.actions)
        assert 1 <= len(plan.actions) <= 5
        assert len(plan.states) == len(plan.actions) + 1
        expected = [state.expected_mm for state in plan.states]
        assert expected == sorted(expected, reverse=True)
        before, after = true_error_um(machine), true_error_um(machine, plan)
        for state, true_um in ((plan.states[0], before), (plan.states[-1], after)):
            # 95 % limits of a few machines: some are missed by a little
            assert 0.8 * state.low_mm < 1e-3 * true_um < 1.25 * state.high_mm
            inside.append(state.low_mm <= 1e-3 * true_um <= state.high_mm)
        gains.append(before - after)
    assert np.mean(inside) >= 0.75
    assert min(gains) > 0.0
    assert kinds == set(ActionKind)


CHAINS = (
    "tool-Y-Z-X-bed-workpiece",
    "tool-Z-Y-bed-X-workpiece",
    "tool-Z-bed-Y-X-workpiece",
    "tool-Z-X-Y-bed-workpiece",
)


@pytest.mark.parametrize("chain", CHAINS)
def test_the_actions_move_the_tool_as_rigid_bodies_do(chain: str) -> None:
    model = straight_model(chain)
    rng = np.random.default_rng(5)
    positions = rng.uniform([0.0, 0.0, 0.0], [900.0, 600.0, 400.0], (300, 3))
    nominal = tool_points(model.chain, (), positions, model.ranges_mm)
    kinds = []
    for one in candidates(model, MOUNTING):
        unit = 1e-2 if one.kind is ActionKind.STRAIGHTNESS else 2e-5
        amounts = unit * rng.uniform(0.5, 1.0, one.size)
        action = one.action(amounts, amounts, MOUNTING)
        moved = tool_points(model.chain, (action,), positions, model.ranges_mm) - nominal
        left = aligned_rms_um(positions, one.columns(positions, OFFSET) @ amounts - moved)
        assert left < 1e-3 * aligned_rms_um(positions, moved) < 0.1
        kinds.append(one.kind)
    assert kinds.count(ActionKind.STRAIGHTNESS) == 6
    nearest = (*model.chain.tool_side[-1:], *model.chain.workpiece_side[:1])
    assert kinds.count(ActionKind.LEVEL) == len([name for name in nearest if name != "Z"])


@pytest.mark.parametrize("chain", CHAINS)
def test_raised_feet_twist_the_bed_as_a_level_action_asks(chain: str) -> None:
    """The height of the bed is the one surface 1, x, y, xy through all its feet."""
    model = straight_model(chain)
    for one in candidates(model, MOUNTING):
        if one.kind is not ActionKind.LEVEL:
            continue
        action = one.action(np.array([3e-5]), np.array([1e-6]), MOUNTING)
        assert min(foot.height_mm for foot in action.feet) == 0.0
        x, y = np.array([foot.at_mm for foot in FEET]).T
        surface = np.linalg.solve(
            np.column_stack((np.ones(4), x, y, x * y)), np.array([foot.height_mm for foot in action.feet])
        )
        # right-handed about X, the bed rises towards Y; about Y, it sinks towards X
        twist_per_mm = surface[3] if one.axis == "X" else -surface[3]
        moves_table = one.axis in model.chain.workpiece_side
        assert twist_per_mm * action.travel_mm == pytest.approx(-3e-5 if moves_table else 3e-5)


def test_a_rail_that_is_high_in_the_middle_is_lowered_there() -> None:
    model = straight_model("tool-Y-Z-X-bed-workpiece")
    parameters = np.zeros(model.size)
    bent = ErrorModel.uniform(model.chain, model.ranges_mm, 2, ())
    parameters = np.zeros(bent.size)
    # 20 µm lower at the ends, and the slope of this parabola: -e'(x) about Y, from the lower ends of the travel
    parameters[bent.index("EZX[2]")], parameters[bent.index("EBX[1]")] = -20e-3 / 1.5, 3.0 * 20e-3 / 1.5 / 450.0
    mounting = Mounting({"X": Guide(100.0, (0.0, 0.0, 0.0))})
    plan = plan_actions(KnownMachine(bent, parameters), np.zeros(3), mounting=mounting)
    first = plan.actions[0]
    assert (first.kind, first.axis, first.towards) == (ActionKind.STRAIGHTNESS, "X", "Z")
    assert [shim.at_mm for shim in first.shims] == [-50.0, 200.0, 450.0, 700.0, 950.0]
    ends, lower, middle, upper, others = (shim.amount_mm for shim in first.shims)
    # a shim cannot be negative: the ends are raised instead
    assert ends == others > max(lower, upper) >= min(lower, upper) > middle == 0.0
    assert first.amount == pytest.approx(-ends)
    assert plan.states[1].expected_mm < 0.25 * plan.states[0].expected_mm
    assert action_text(first).startswith(
        f"straighten the guide of X with shims towards +Z, from end to end: {1e3 * ends:.1f} µm, {1e3 * lower:.1f} µm "
        "(X = 200 mm), 0.0 µm (X = 450 mm)"
    )
    assert "-" not in action_text(first)


def test_a_rail_that_would_need_shims_of_a_millimetre_is_not_straightened() -> None:
    bent = ErrorModel.uniform(CHAIN, ((0.0, 900.0), (0.0, 600.0), (0.0, 400.0)), 2, ())
    parameters = np.zeros(bent.size)
    parameters[bent.index("EZX[2]")], parameters[bent.index("EBX[1]")] = -1.0 / 1.5, 3.0 / 1.5 / 450.0
    plan = plan_actions(
        KnownMachine(bent, parameters), np.zeros(3), mounting=Mounting({"X": Guide(100.0, (0.0, 0.0, 0.0))})
    )
    assert ActionKind.STRAIGHTNESS not in {one.kind for one in plan.actions}


@pytest.mark.parametrize("shoes_mm", [901.0, 0.0, float("nan")])
def test_shoes_longer_than_the_travel_are_refused(shoes_mm: float) -> None:
    model = straight_model("tool-Y-Z-X-bed-workpiece")
    mounting = Mounting({"X": Guide(shoes_mm, (0.0, 0.0, 0.0))})
    with pytest.raises(ModelError, match="the shoes of X") as refused:
        plan_actions(KnownMachine(model, np.zeros(model.size)), np.zeros(3), mounting=mounting)
    assert refused.value.where["key"] == "axes.X.guide.shoes_mm"


@pytest.mark.parametrize("chain", CHAINS)
def test_a_guide_that_is_turned_as_proposed_makes_two_axes_square(chain: str) -> None:
    """By rigid bodies. The machine has no other errors."""
    model = straight_model(chain)
    parameters = np.zeros(model.size)
    for name, size in (("C0Y", 20e-6), ("B0Z", -15e-6), ("A0Z", 30e-6)):
        parameters[model.index(name)] = size
    known = KnownMachine(model, parameters)
    plan = plan_actions(known, np.zeros(3))
    assert [one.kind for one in plan.actions] == [ActionKind.SQUARENESS] * 3
    positions = np.random.default_rng(3).uniform([0.0, 0.0, 0.0], [900.0, 600.0, 400.0], (200, 3))
    field = exact_deviation(model, positions, np.zeros(3), parameters)
    before = aligned_rms_um(positions, field)
    after, nominal = (tool_points(model.chain, done, positions, model.ranges_mm) for done in (plan.actions, ()))
    field = field + after - nominal
    assert before > 3.0
    assert aligned_rms_um(positions, field) < 1e-3 * before


def test_the_words_and_signs_are_those_of_the_actions() -> None:
    """X goes 10 µm/m too far, and Z leans by 30 µrad towards +X as it rises."""
    model = straight_model("tool-Y-Z-X-bed-workpiece")
    positions = np.array([[900.0, 0.0, 0.0], [0.0, 0.0, 400.0]])
    parameters = np.zeros(model.size)
    parameters[model.index("EXX[1]")], parameters[model.index("B0Z")] = 4.5e-3, 30e-6
    ahead, leaning = exact_deviation(model, positions, np.zeros(3), parameters)
    origin = exact_deviation(model, np.zeros((1, 3)), np.zeros(3), parameters)[0]
    assert (ahead - origin)[0] == pytest.approx(9e-3, rel=1e-3)
    leans = "-" if (leaning - origin)[0] > 0.0 else "+"
    plan = plan_actions(KnownMachine(model, parameters), np.zeros(3))
    assert {action_text(one) for one in plan.actions} == {
        "shorten the scale of X: 9.0 µm over 900 mm",
        f"turn the guide of Z: over 400 mm towards +Z, the tool must move 12.0 µm further towards {leans}X relative to "
        "the workpiece",
    }
    assert plan.states[-1].expected_mm < 0.2 * plan.states[0].expected_mm


def test_a_candidate_that_is_not_certain_does_not_hide_another_one() -> None:
    """No scale is known to better than 100 µm/m, as without a thermometer; a squareness is."""
    model = straight_model("tool-Y-Z-X-bed-workpiece")
    parameters, sigmas = np.zeros(model.size), np.full(model.size, 1e-9)
    for axis, half_mm in zip("XYZ", (450.0, 300.0, 200.0), strict=True):
        index = model.index(f"E{axis}{axis}[1]")
        parameters[index], sigmas[index] = 60e-6 * half_mm, 50e-6 * half_mm
    parameters[model.index("C0Y")] = 10e-6
    plan = plan_actions(KnownMachine(model, parameters, np.diag(sigmas**2)), np.zeros(3))
    assert [(one.kind, {one.axis, one.towards}) for one in plan.actions] == [(ActionKind.SQUARENESS, {"X", "Y"})]


def test_fewer_actions_begin_with_the_same_ones() -> None:
    _, estimate = estimated(0)
    all_of_them, first = plan_actions(estimate, OFFSET), plan_actions(estimate, OFFSET, 1)
    assert [one.axis for one in first.actions] == [all_of_them.actions[0].axis]
    assert first.states == all_of_them.states[:2]
    assert all(abs(one.amount) > one.expanded for one in all_of_them.actions)
    squareness = [one for one in all_of_them.actions if one.kind is ActionKind.SQUARENESS]
    assert all(one.axis != one.towards for one in squareness)
    with pytest.raises(DataError, match="at least one action"):
        plan_actions(estimate, OFFSET, 0)
