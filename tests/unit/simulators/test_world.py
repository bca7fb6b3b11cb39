"""Compensation, mount, temperatures and the truth."""

import numpy as np
import pytest
from worlds import TOOL, World, ball_axis_position, before_ball, case_study, ideal_world, moved, run

from drivers.errors import CommandRejected
from drivers.roles import MotionState, TableImage
from simulators.scenario import AxisBehaviour, TriggerSettings
from simulators.world.field import TableField

ORIGIN, STEP, SHAPE, RESOLUTION = (0.0, 0.0, 0.0), (100.0, 100.0, 100.0), (41, 14, 16), 1e-4


def nodes() -> np.ndarray:
    axes = [o + s * np.arange(n) for o, s, n in zip(ORIGIN, STEP, SHAPE, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def image_of(corrections_mm: np.ndarray) -> TableImage:
    counts = np.round(corrections_mm.reshape(*SHAPE, 3) / RESOLUTION).astype(np.int32)
    return TableImage(ORIGIN, STEP, RESOLUTION, counts)


def quiet_case_study() -> World:
    """Return the true machine with a probe and axes without noise, so that only the field remains."""
    scenario = case_study()
    update = {
        "trigger": TriggerSettings(pretravel_um=0.0, lobing_um=0.0, touch_sigma_um=0.0),
        "axes": AxisBehaviour(repeatability_um=0.0, backlash_um=0.0),
    }
    quiet = scenario.settings.model_copy(update=update)
    return World(type(scenario)(quiet, scenario.machine, scenario.artefact))


def test_the_shipped_machine_has_about_twelve_micrometres() -> None:
    raw_um, aligned_um = World(case_study()).truth.true_volumetric_error()
    assert raw_um == pytest.approx(12.45, abs=0.05)
    assert aligned_um == pytest.approx(11.81, abs=0.05)


def test_a_table_that_is_minus_the_true_field_makes_the_error_vanish() -> None:
    world = quiet_case_study()
    field = world.truth.machine.deviation(nodes())
    world.controller.write_bank(1, image_of(-field))
    world.controller.write_bank(2, image_of(field))
    bare = world.truth.true_volumetric_error()[0]
    assert world.truth.true_volumetric_error(1)[0] < 0.03 * bare
    assert world.truth.true_volumetric_error(2)[0] == pytest.approx(2.0 * bare, rel=0.01)


def test_with_that_table_active_a_touch_finds_the_ball_where_it_is() -> None:
    world = quiet_case_study()
    world.controller.write_bank(1, image_of(-world.truth.machine.deviation(nodes())))
    missed = {}
    for bank in (0, 1):
        world.controller.activate(bank)
        centre = before_ball(world, 9)
        world.controller.begin_touch(centre, 5.0)
        run(world)
        assert world.controller.latch is not None
        missed[bank] = abs(world.controller.latch.position[1] - (centre[1] - 15.5))
        moved(world, centre - [0.0, 20.0, 0.0])
    assert missed[0] > 2e-3
    assert missed[1] < 3e-4


def test_the_tip_is_where_the_table_and_the_true_field_put_it() -> None:
    world = quiet_case_study()
    x = np.array([1234.0, 567.0, 890.0])
    world.controller.write_bank(1, image_of(np.tile([0.01, -0.02, 0.03], (len(nodes()), 1))))
    world.controller.activate(1)
    tip = np.array(world.controller.contacts.tip(tuple(x)))
    bare = x + np.array([0.01, -0.02, 0.03])
    assert tip == pytest.approx(bare + TOOL + world.truth.machine.deviation(bare[None])[0], abs=1e-12)


def test_a_homing_displaces_the_zero_of_each_axis_by_its_scatter() -> None:
    scenario = case_study()
    axes = AxisBehaviour(repeatability_um=0.0, backlash_um=0.0, homing_um=(5.0, 0.0, 20.0))
    settings = scenario.settings.model_copy(update={"axes": axes})
    world = World(type(scenario)(settings, scenario.machine, scenario.artefact))
    controller, x = world.controller, (1234.0, 567.0, 890.0)
    former = np.array(controller.contacts.tip(x))
    found = []
    for _ in range(400):
        controller.set_zero()
        offset = np.array(controller.homing_offset_mm)
        # the machine has its deviation where the slides are
        bare = np.array(x) + offset
        assert np.array(controller.contacts.tip(x)) == pytest.approx(
            bare + TOOL + world.truth.machine.deviation(bare[None])[0], abs=1e-12
        )
        found.append(offset)
    sigma_um = 1e3 * np.std(found, axis=0, ddof=1)
    assert sigma_um == pytest.approx([5.0, 0.0, 20.0], rel=0.15)
    assert np.abs(np.array(controller.contacts.tip(x)) - former).max() > 1e-4


def test_tables_are_trilinear_inside_and_keep_the_border_outside() -> None:
    # f = x + 2y + 3z + xyz is trilinear: the interpolation is exact everywhere inside.
    axes = np.arange(3.0)
    x, y, z = np.meshgrid(axes, axes, axes, indexing="ij")
    counts = np.stack([x + 2 * y + 3 * z, x * y * z, 0 * x], axis=-1).astype(np.int32)
    field = TableField(TableImage((0.0, 0.0, 0.0), (10.0, 10.0, 10.0), 1.0, counts))
    at = field.at_many(np.array([[5.0, 12.0, 17.0], [-50.0, 20.0, 99.0]]))
    assert at[0] == pytest.approx([0.5 + 2.4 + 5.1, 0.5 * 1.2 * 1.7, 0.0])
    assert at[1] == pytest.approx([0.0 + 4.0 + 6.0, 0.0, 0.0])


def test_banks_refuse_what_does_not_fit() -> None:
    world = ideal_world()
    controller = world.controller
    table = image_of(np.zeros((len(nodes()), 3)))
    controller.write_bank(1, table)
    controller.activate(1)
    with pytest.raises(CommandRejected, match="active"):
        controller.write_bank(1, table)
    for bank in (0, 3):
        with pytest.raises(CommandRejected, match="no writable bank"):
            controller.write_bank(bank, table)
    with pytest.raises(CommandRejected, match="holds no table"):
        controller.activate(2)
    with pytest.raises(CommandRejected, match="exceeds"):
        controller.write_bank(2, image_of(np.full((len(nodes()), 3), 1.5)))
    large = TableImage(ORIGIN, STEP, RESOLUTION, np.zeros((65, 2, 2, 3), dtype=np.int32))
    with pytest.raises(CommandRejected, match="nodes"):
        controller.write_bank(2, large)
    assert controller.active_bank == 1


def test_the_mount_turns_by_its_law() -> None:
    world = ideal_world()
    moved(world, np.array([3000.0, 0.0, 750.0]))
    mount = world.mounts["mount"]
    begun = world.now
    mount.begin_turn("azimuth", 90.0)
    # 20°/s with 40°/s²: half a second and 5° for each ramp, 80° in 4 s.
    assert mount.turn_ends_s("azimuth") == pytest.approx(begun + 5.0)
    world.advance_to(begun + 2.5)
    assert mount.position_deg("azimuth") == pytest.approx(45.0)
    assert mount.moving("azimuth")
    mount.halt()
    world.advance_to(begun + 9.0)
    assert mount.position_deg("azimuth") == pytest.approx(50.0)
    with pytest.raises(CommandRejected, match="outside"):
        mount.begin_turn("elevation", 120.0)


def test_a_bar_that_turns_into_the_probe_is_a_collision_and_stops_both() -> None:
    world = ideal_world()
    before_ball(world, 8, distance=100.0)
    mount = world.mounts["mount"]
    mount.begin_turn("azimuth", -45.0)
    world.advance_to(world.now + 60.0)
    assert len(world.collisions) == 1
    assert world.controller.motion is MotionState.FAULT
    assert abs(mount.position_deg("azimuth")) < 40.0


def test_a_turn_far_from_the_probe_is_none() -> None:
    world = ideal_world()
    moved(world, np.array([world.workpiece.location_mm[0] + 1000.0, 0.0, 750.0]))
    for azimuth, elevation in ((90.0, 45.0), (-45.0, -45.0), (180.0, 90.0)):
        world.mounts["mount"].begin_turn("azimuth", azimuth)
        world.mounts["mount"].begin_turn("elevation", elevation)
        world.advance_to(world.now + 60.0)
    assert world.collisions == []


def test_the_hand_puts_the_artefact_near_the_station_and_never_twice_the_same() -> None:
    world = World(case_study())
    seen = []
    for _ in range(2):
        world.place_artefact(3)
        seen.append(world.workpiece.location_mm)
    nominal = np.array(case_study().settings.stations_mm[2])
    assert all(np.abs(place - nominal).max() <= 0.3 for place in seen)
    assert not np.array_equal(seen[0], seen[1])
    with pytest.raises(CommandRejected, match="no station 5"):
        world.place_artefact(5)


def test_a_warm_steel_bar_is_longer() -> None:
    scenario = case_study().without_errors()
    warm = scenario.settings.temperatures.model_copy(update={"artefact_c": 20.0, "artefact_k_per_h": 2.0})
    world = World(type(scenario)(scenario.settings.model_copy(update={"temperatures": warm}), scenario.machine,
                                 scenario.artefact))  # fmt: skip
    cold = np.linalg.norm(ball_axis_position(world, 10) - ball_axis_position(world, 0))
    world.advance_to(3600.0)
    after = np.linalg.norm(ball_axis_position(world, 10) - ball_axis_position(world, 0))
    assert after - cold == pytest.approx(1500.3 * 11.5e-6 * 2.0, rel=1e-3)
    assert world.controller.temperatures()["artefact"] == pytest.approx(22.0)


def test_the_true_bar_differs_from_its_certificate_within_it() -> None:
    world = World(case_study())
    difference = world.workpiece.artefact.balls - case_study().artefact.balls
    assert 0.5e-3 < difference.std() < 1.1e-3
