"""The driver of Marlin printers over an emulated one: how it moves, and how it finds the surface."""

import numpy as np
import pytest
from marlin_printer import SPEED, linked, took
from simulated_setting import MOTION, base_scene, world

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.plan import steps as kinematics
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.system.clock import VirtualClock

# --- motion ---


def test_it_says_which_printer_it_is(homed):
    identity = homed.identity()
    assert (identity.model, identity.driver) == ("Prusa i3 MK3S", "marlin-applicator")
    assert identity.firmware.startswith("Prusa-Firmware 3.")


def test_homing_ends_over_the_centre_at_the_hover_height(station, homed):
    assert station.head.position_mm == pytest.approx((55.0, 52.0, 32.0))
    assert station.head.dragged == 0


def test_times_are_those_the_dry_run_counts_with(station, homed):
    depth = homed.find_surface(0.0, 0.0) - MOTION.hover_mm
    assert took(station, homed.move_to, 30.0, -20.0) == pytest.approx(kinematics.travel_s(MOTION, 36.056), rel=0.02)
    assert took(station, homed.press, 0.8, SPEED) == pytest.approx(kinematics.stroke_s(MOTION, 0.8), rel=0.02)
    assert took(station, homed.press, 0.4, SPEED) == pytest.approx(kinematics.ease_s(MOTION, 0.8, 0.4), rel=0.02)
    assert station.head.height_mm == pytest.approx(-0.4 - depth, abs=1e-3)
    assert took(station, homed.release) == pytest.approx(kinematics.stroke_s(MOTION, 0.4), rel=0.02)
    assert took(station, homed.find_surface, 30.0, -20.0) == pytest.approx(
        kinematics.surface_search_s(MOTION),
        rel=0.15,  # how far it steps depends on where the surface is
    )


def test_easing_goes_straight_and_does_not_leave_the_sheet(station, homed, one_world):
    homed.find_surface(0.0, 0.0)
    one_world.presses.clear()
    homed.press(0.4, SPEED)
    homed.press(0.8, SPEED)
    homed.press(0.2, SPEED)
    (press,) = one_world.presses
    assert np.sign([step.change for step in press.steps]).tolist() == [1, 1, -1]


def test_it_lifts_before_it_travels(station, homed):
    homed.press(0.8, SPEED)
    homed.move_to(20.0, 0.0)
    assert station.head.dragged == 0
    assert station.head.place_mm == pytest.approx((20.0, 0.0))


def test_it_says_where_it_is_while_it_moves(station, homed):
    since = station.clock.now()
    homed.press(0.8, SPEED)
    block = homed.samples_since(since)
    assert (block.channel, block.unit) == ("head depth", "mm")
    assert len(block) > 30
    assert (np.diff(block.time_s) > 0).all()
    assert block.values[0] == pytest.approx(-24.0, abs=0.02)
    assert block.values[-1] == pytest.approx(0.8, abs=0.02)
    assert len(homed.samples_since(station.clock.now())) == 0
    station.clock.sleep(7.0)
    assert homed.samples_since(station.clock.now() - 1.0).values == pytest.approx([0.8], abs=0.02)


def test_before_homing_it_has_no_position_to_tell(head):
    assert len(head.samples_since(-1.0)) == 0
    head.alive()


@pytest.mark.parametrize(
    "use",
    [
        lambda one: one.move_to(0.0, 0.0),
        lambda one: one.find_surface(0.0, 0.0),
        lambda one: one.press(0.4, SPEED),
        lambda one: one.release(),
    ],
)
def test_nothing_moves_before_it_has_homed(station, head, use):
    before = station.head.position_mm
    with pytest.raises(InstrumentError, match="has not homed yet"):
        use(head)
    station.clock.sleep(10.0)
    assert station.head.position_mm == before


@pytest.mark.parametrize("place", [(60.0, 0.0), (float("nan"), 0.0)])
def test_it_does_not_leave_the_sheet(homed, place):
    with pytest.raises(InstrumentError, match="outside the sheet"):
        homed.move_to(*place)


@pytest.mark.parametrize(("depth", "speed"), [(4.0, SPEED), (-0.1, SPEED), (0.5, 0.0), (float("nan"), SPEED)])
def test_it_does_not_press_what_makes_no_sense(homed, depth, speed):
    with pytest.raises(InstrumentError, match="cannot press"):
        homed.press(depth, speed)


def test_stock_marlin_tells_steps(make, one_world):
    station = make(firmware="marlin", steps_per_mm=[80.0, 80.0, 400.0])
    one = linked(station)
    one.home()
    one.press(0.8, SPEED)
    assert one.samples_since(station.clock.now() - 1).values[-1] == pytest.approx(0.8, abs=0.01)


def test_a_machine_whose_z_grows_downwards(make):
    station = make(z_axis="down", hover_height_mm=40.0)
    one = linked(station)
    one.home()
    one.press(0.8, SPEED)
    assert station.head.height_mm == pytest.approx(-0.8, abs=1e-3)
    one.release()
    assert station.head.up


# --- surface ---


def test_the_surface_is_where_the_simulated_bench_finds_it(station, homed, one_world):
    clock = VirtualClock()
    other = world(base_scene())
    simulated = SimulatedHead(clock, other, MOTION, role="head")
    simulated.travel(10.0, 5.0)

    def mean_N(window_s):
        numbers = range(int(np.floor((clock.now() - window_s) * 8)) + 1, int(np.floor(clock.now() * 8)) + 1)
        return float(np.mean([other.force_N(n / 8, 1000 + n) for n in numbers]))

    simulated.approach()
    expected = simulated.find_surface(mean_N)
    found = homed.find_surface(10.0, 5.0)
    true = MOTION.hover_mm + one_world.surface_mm(10.0, 5.0, 0.0)
    assert found == pytest.approx(expected, abs=0.01)  # other samples of the load cell's noise
    assert found == pytest.approx(true, abs=0.03)
    assert station.head.up


def test_without_a_sheet_it_goes_no_deeper_than_it_knows_as_safe(station, homed):
    station.force.rig = type("Air", (), {"clock": station.clock, "world": type("N", (), {"force_N": lambda *_: 0.0})})
    lowest = []
    station.clock.watch(lambda now_s: lowest.append(station.head.height_mm))
    with pytest.raises(InstrumentError, match=r"no contact force of 0\.2 N down to 1 mm below nominal"):
        homed.find_surface(0.0, 0.0)
    assert min(lowest) > -1.1
    assert station.head.up


def test_a_load_cell_that_was_not_tared_finds_no_surface_in_the_air(station, homed):
    station.force.more_N = 0.5
    with pytest.raises(InstrumentError, match=r"reads 0\.\d+ N 0\.5 mm above the nominal surface"):
        homed.find_surface(0.0, 0.0)
    assert station.head.up


def test_a_force_that_falls_silent_ends_the_search(station, homed):
    station.force.silent_from_s = station.clock.now() + 4.0
    with pytest.raises((InstrumentError, SafetyError), match="force sample"):
        homed.find_surface(0.0, 0.0)
    station.clock.sleep(5.0)
    assert station.head.up
