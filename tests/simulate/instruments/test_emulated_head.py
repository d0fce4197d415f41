"""The emulated head: queued motions, strain in the sheet like the simulated head's, and stops midway."""

from dataclasses import astuple

import pytest
from simulated_setting import HEAD, MOTION, base_scene, installed, material, sensor_type, world

from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import WatchedClock
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa.system.clock import VirtualClock

SPEED = 40 / 60
CENTRE, HOVER_Z = (125.0, 105.0), 60.0


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def rig(one_world):
    one_world.presses.clear()
    rig = EmulatedRig(WatchedClock(), one_world, MOTION)
    rig.head.mount_over(CENTRE, HOVER_Z)
    return rig


def over(rig, x=0.0, y=0.0):
    rig.head.go((CENTRE[0] + x, CENTRE[1] + y, HOVER_Z), 1000.0)
    rig.clock.sleep(10.0)
    return rig


def down(rig, depth_mm, speed=SPEED):
    x, y, _ = rig.head.target_mm
    rig.head.go((x, y, HOVER_Z - MOTION.hover_mm - depth_mm), speed)


def test_a_motion_takes_its_time_and_ends_where_it_was_told_to(rig):
    over(rig)
    rig.head.go((CENTRE[0] + 30, CENTRE[1] - 40, HOVER_Z), 10.0)
    assert rig.head.moving
    rig.clock.sleep(2.5)
    assert rig.head.place_mm == pytest.approx((15.0, -20.0))
    rig.clock.sleep(2.5)
    assert not rig.head.moving
    assert rig.head.place_mm == pytest.approx((30.0, -40.0))
    assert rig.head.up


def test_motions_wait_for_each_other(rig):
    over(rig)
    for x in (10.0, 20.0, 0.0):
        rig.head.go((CENTRE[0] + x, CENTRE[1], HOVER_Z), 10.0)
    assert rig.head.queued == 3
    assert rig.head.free_at_s == pytest.approx(rig.clock.now() + 4.0)
    rig.clock.sleep(1.5)
    assert rig.head.place_mm[0] == pytest.approx(15.0)
    rig.clock.sleep(1.5)
    assert rig.head.place_mm[0] == pytest.approx(10.0)
    assert rig.head.queued == 1


def test_a_press_feels_like_the_simulated_heads(rig, one_world):
    over(rig)
    clock = VirtualClock()
    clock.sleep(rig.clock.now())
    other = SimulatedWorld(base_scene(), sensor_type(), material(), HEAD, seed=1, effect_factory=installed)
    simulated = SimulatedHead(clock, other, MOTION, role="head")
    simulated.press(0.8, SPEED)
    down(rig, -0.2, 10.0)
    down(rig, 0.8)
    rig.clock.sleep(clock.now() - rig.clock.now())
    simulated.lift()
    down(rig, -0.2)
    down(rig, -25.0, 10.0)
    rig.clock.sleep(60.0)
    (one,), (same,) = one_world.presses, other.presses
    assert len(one.steps) == len(same.steps) == 2
    for step, other_step in zip(one.steps, same.steps, strict=True):
        assert astuple(step) == pytest.approx(astuple(other_step), abs=1e-11)
    at_s = same.steps[0].start_s + same.steps[0].ramp_s
    assert other.force_N(at_s, 3) > 1.0
    assert one_world.force_N(at_s, 3) == pytest.approx(other.force_N(at_s, 3), abs=1e-9)
    assert rig.head.up
    assert not rig.head.touching


def test_touching_is_told_by_the_true_surface(rig, one_world):
    over(rig)
    surface = one_world.surface_mm(0.0, 0.0, 0.0)
    down(rig, surface - 0.01, 10.0)
    rig.clock.sleep(10.0)
    assert not rig.head.touching
    assert rig.head.height_mm == pytest.approx(0.01 - surface)
    down(rig, surface + 0.01, 10.0)
    rig.clock.sleep(10.0)
    assert rig.head.touching
    assert not rig.head.up


def test_a_stop_midway_leaves_what_was_pressed_and_no_more(rig, one_world):
    over(rig)
    surface = one_world.surface_mm(0.0, 0.0, 0.0)
    down(rig, surface, 10.0)
    rig.clock.sleep(10.0)
    down(rig, surface + 1.0)
    rig.head.go((CENTRE[0], CENTRE[1], HOVER_Z), 10.0)
    rig.clock.sleep(0.6)
    one_world.force_N(rig.clock.now(), 1)  # what is remembered of the press must not outlive the stop
    rig.head.stop()
    assert not rig.head.moving
    rig.clock.sleep(100.0)
    assert rig.head.height_mm == pytest.approx(-(surface + 0.4), abs=1e-5)
    (press,) = one_world.presses
    assert press.strain_at(rig.clock.now()) == pytest.approx(0.4 / 4.0, abs=1e-5)
    relaxed = one_world.force_N(rig.clock.now(), 1)
    rig.head.go((CENTRE[0], CENTRE[1], HOVER_Z), 10.0)
    rig.clock.sleep(5.0)
    assert one_world.presses[-1].strain_at(rig.clock.now()) == pytest.approx(0.0, abs=1e-9)
    assert abs(one_world.force_N(rig.clock.now(), 1)) < relaxed / 5


def test_a_stop_on_the_way_down_in_free_air_leaves_no_press(rig, one_world):
    over(rig)
    down(rig, 1.0, 10.0)
    rig.clock.sleep(1.0)
    rig.head.stop()
    rig.clock.sleep(10.0)
    assert rig.head.height_mm == pytest.approx(15.0)
    assert all(press.strain_at(rig.clock.now()) == 0 for press in one_world.presses)
    down(rig, 0.5, 10.0)
    rig.clock.sleep(10.0)
    assert one_world.presses[-1].strain_at(rig.clock.now()) > 0.05


def test_moving_sideways_in_the_sheet_is_noted(rig):
    over(rig)
    down(rig, 0.8)
    rig.clock.sleep(60.0)
    assert rig.head.dragged == 0
    rig.head.go((CENTRE[0] + 5, CENTRE[1], HOVER_Z - MOTION.hover_mm - 0.8), 10.0)
    rig.clock.sleep(1.0)
    assert rig.head.dragged == 1


def test_beside_the_sheet_there_is_nothing_to_press(rig, one_world):
    over(rig, 80.0, 0.0)
    down(rig, 3.0, 10.0)
    rig.clock.sleep(10.0)
    assert not rig.head.touching
    assert not one_world.presses


def test_a_machine_whose_z_grows_downwards(rig):
    rig.head.mount_over(CENTRE, HOVER_Z, up=False)
    rig.head.go((*CENTRE, HOVER_Z + 20.0), 100.0)
    rig.clock.sleep(10.0)
    assert rig.head.height_mm == pytest.approx(5.0)
