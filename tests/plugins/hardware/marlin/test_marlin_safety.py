"""The driver of Marlin printers over an emulated one: force, the safe state, and restarts."""

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from emulated_bench import SAFETY
from marlin_printer import SPEED, linked, took, until_it_moves
from simulated_setting import MOTION

from cbsr_qa.domain.errors import ConfigError, InstrumentError, SafetyError
from cbsr_qa.simulate.instruments.streams import Fault
from cbsr_qa_plugins.hardware.marlin_applicator import open_applicator

# --- force ---


def test_without_a_load_cell_it_cannot_be_linked(station):
    one = station.open("applicator", open_applicator)
    with pytest.raises(ConfigError, match="needs an instrument that samples 'force'"):
        one.link({"frame_source": object()})


def test_a_force_above_the_ceiling_stops_a_press_and_lifts(station):
    homed = linked(station, safety=replace(SAFETY, force_N=2.0))
    homed.home()
    surface = homed.find_surface(0.0, 0.0) - MOTION.hover_mm
    sounds = []
    station.clock.watch(lambda now_s: sounds.append(station.head.height_mm))
    with pytest.raises(SafetyError, match=r"N measured; the station allows 2 N") as caught:
        homed.press(1.2, SPEED)
    assert caught.value.rule == "force"
    assert min(sounds) > -surface - 1.15  # it did not go all the way
    station.clock.sleep(4.0)
    assert station.head.up


@pytest.mark.parametrize("use", [lambda one: one.press(0.4, SPEED), lambda one: one.find_surface(0.0, 0.0)])
def test_without_fresh_force_the_head_does_not_go_down(station, homed, use):
    station.force.silent_from_s = -1.0
    with pytest.raises(SafetyError, match=r"the last force sample did not come for 2 s") as caught:
        use(homed)
    assert caught.value.rule == "stale force"
    assert station.head.up
    assert not station.head.moving


@pytest.mark.parametrize("how", ["silent", "error", "nan"])
def test_a_load_cell_that_fails_stops_a_press_and_lifts(station, homed, how):
    homed.find_surface(0.0, 0.0)

    def fail(now_s):
        if station.head.touching:
            station.force.silent_from_s = min(station.force.silent_from_s, now_s if how == "silent" else np.inf)
            station.force.error = "it was unplugged" if how == "error" else None
            station.force.more_N = np.nan if how == "nan" else 0.0

    station.clock.watch(fail)
    with pytest.raises((SafetyError, InstrumentError), match=r"stale|old|unplugged|not a number"):
        homed.press(3.0, SPEED)
    station.clock.sleep(5.0)
    assert station.head.up


# --- safe state ---


def test_the_safe_state_lifts_from_the_sheet_and_returns_at_once(station, homed):
    homed.press(0.8, SPEED)
    assert took(station, homed.safe_state) == 0.0
    assert took(station, homed.safe_state) == 0.0
    station.clock.sleep(2.7)
    assert station.head.up
    assert station.head.height_mm == pytest.approx(MOTION.hover_mm)
    homed.press(0.4, SPEED)
    assert station.head.height_mm == pytest.approx(-0.4, abs=1e-3)


def test_the_safe_state_of_a_head_nobody_homed_lifts_it_once_out_of_wherever_it_is(station, head):
    before = station.head.position_mm[2]
    for _ in range(3):
        head.safe_state()
        station.clock.sleep(10.0)
    assert station.head.position_mm[2] == pytest.approx(before + MOTION.hover_mm)


@pytest.mark.parametrize("pause_s", [0.0, 0.4])
def test_a_head_that_is_told_again_while_it_lifts_goes_all_the_way(station, head, pause_s):
    # What makes the bench safe at the start, and right after it an error or an impatient operator.
    before_mm = station.head.height_mm
    head.safe_state()
    station.clock.sleep(pause_s)
    head.safe_state()
    station.clock.sleep(4.0)
    assert station.head.height_mm == pytest.approx(before_mm + MOTION.hover_mm, abs=0.1)


def test_opening_moves_nothing_and_stops_what_moves(make, one_world):
    station = make()
    station.head.go((0.0, 0.0, 0.0), 1.0)
    station.clock.sleep(1.0)
    station.open("applicator", open_applicator)
    before = station.head.position_mm
    station.clock.sleep(10.0)
    assert station.head.position_mm == before


def test_the_safe_state_comes_from_another_thread_in_the_middle_of_a_press(station, homed):
    reached, go_on = threading.Event(), threading.Event()
    station.clock.watch(lambda now_s: station.head.touching and reached.set())
    real = station.force.samples_since

    def slow(time_s):
        if reached.is_set():
            go_on.wait(5.0)
        return real(time_s)

    station.force.samples_since = slow

    with ThreadPoolExecutor() as other:
        pressing = other.submit(homed.press, 1.2, SPEED)
        assert reached.wait(10.0)
        homed.safe_state()
        go_on.set()
        assert "stopped on its way" in pressing.exception(10.0).reason
    station.clock.sleep(5.0)
    assert station.head.up


def test_the_safe_state_gets_through_while_a_command_hangs(station, homed):
    homed.press(0.8, SPEED)
    with homed._marlin.alone(1.0), ThreadPoolExecutor() as other:
        met = other.submit(homed.safe_state).exception(5.0)
    assert isinstance(met, InstrumentError)
    assert "another command hangs" in met.reason  # nobody heard it answer: somebody must look
    until_it_moves(station.head)
    station.clock.sleep(5.0)
    assert station.head.up


def test_a_stop_in_the_middle_of_homing_leaves_no_position(station, head):
    printer = station.emulation.instruments["applicator"]
    real, met = printer._g28, []

    def g28(parameters):
        with ThreadPoolExecutor() as other:
            met.append(other.submit(head.safe_state).exception(5.0))
        return real(parameters)

    printer._g28 = g28
    with pytest.raises(InstrumentError, match="stopped on its way"):
        head.home()
    assert "another command hangs" in met[0].reason
    with pytest.raises(InstrumentError, match="position is lost"):
        head.move_to(0.0, 0.0)
    printer._g28 = real
    head.safe_state()
    station.clock.sleep(10.0)
    assert not station.head.touching
    head.home()
    assert station.head.place_mm == pytest.approx((0.0, 0.0))


# --- restarts ---


def test_after_a_restart_nothing_moves_until_it_has_homed_again(station, homed):
    homed.press(0.8, SPEED)
    station.arm("applicator", Fault.RESET)
    with pytest.raises(InstrumentError, match="has restarted"):
        homed.press(0.4, SPEED)
    for use in (lambda: homed.press(0.4, SPEED), lambda: homed.move_to(0.0, 0.0), homed.release, homed.alive):
        with pytest.raises(InstrumentError, match="position is lost"):
            use()
    with pytest.raises(InstrumentError, match="position is lost"):
        homed.samples_since(-1.0)
    assert station.head.height_mm == pytest.approx(-0.8, abs=1e-3)
    homed.home()
    assert station.head.dragged == 0
    homed.press(0.4, SPEED)
    assert station.head.height_mm == pytest.approx(-0.4, abs=1e-3)


def test_a_restart_while_nobody_looked_is_noticed_before_anything_moves(station, homed):
    port = station.emulation.ports["applicator"]
    port.send(b"start\n")
    while not port.unread():  # the kernel takes a moment
        threading.Event().wait(0.001)
    with pytest.raises(InstrumentError, match="has restarted"):
        homed.move_to(10.0, 0.0)
    threading.Event().wait(0.3)  # for the emulator to obey, had it been told anything
    station.clock.sleep(10.0)
    assert station.head.place_mm == pytest.approx((0.0, 0.0))


def test_the_safe_state_after_a_restart_lifts_out_of_the_sheet(station, homed):
    homed.press(0.8, SPEED)
    station.arm("applicator", Fault.RESET)
    homed.safe_state()
    station.clock.sleep(5.0)
    assert not station.head.touching
    assert station.head.height_mm == pytest.approx(MOTION.hover_mm - 0.8, abs=1e-3)
