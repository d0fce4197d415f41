"""The driver of Marlin printers over an emulated one: motion, surface, force, restarts, and every fault."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from emulated_bench import SAFETY, EmulatedStation, WorldForce
from simulated_setting import HEAD, MOTION, base_scene, context, installed, material, sensor_type, world

from cbsr_qa.clock import VirtualClock
from cbsr_qa.domain import kinematics
from cbsr_qa.domain.errors import ConfigError, InstrumentError, SafetyError
from cbsr_qa.emulate.faults import Fault
from cbsr_qa.emulate.streams import PtyPort
from cbsr_qa.interfaces import Alive, ForceApplicator, Linked, Sampler
from cbsr_qa.links import serial_link
from cbsr_qa.simulate.head import SimulatedHead
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa_plugins.hardware.marlin_applicator import open_applicator

SPEED = 40 / 60
TABLE = {"driver": "marlin-applicator", "centre_mm": [125.0, 105.0], "hover_height_mm": 60.0, "timeout_s": 0.4}


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def make(one_world):
    made = []

    def station(**options):
        made.append(EmulatedStation(one_world, applicator=TABLE | options))
        return made[-1]

    yield station
    for one in made:
        one.close()


@pytest.fixture
def station(make):
    return make()


@pytest.fixture
def head(station):
    """An applicator that is linked with a force but has not homed."""
    return linked(station)


@pytest.fixture
def homed(head):
    head.home()
    return head


def linked(station, **more):
    one = station.open("applicator", open_applicator, **more)
    station.force = WorldForce(station.rig)
    one.link({"force": station.force})
    return one


def took(station, what, *arguments):
    before = station.clock.now()
    what(*arguments)
    return station.clock.now() - before


def until_it_moves(head):
    """A command without an answer is heard some time later; one that changes nothing never shows."""
    patience = threading.Event()
    for _ in range(50):
        if head.moving:
            return
        patience.wait(0.02)


# --- motion ---


def test_it_is_what_it_says(homed):
    for role in (ForceApplicator, Sampler, Linked, Alive):
        assert isinstance(homed, role)
    identity = homed.identity()
    assert (identity.model, identity.driver) == ("Prusa i3 MK3S", "marlin-applicator")
    assert identity.firmware.startswith("Prusa-Firmware 3.")


def test_homing_ends_over_the_centre_at_the_hover_height(station, homed):
    assert station.head.position_mm == pytest.approx((125.0, 105.0, 60.0))
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
    other = SimulatedWorld(base_scene(), sensor_type(), material(), HEAD, seed=1, effect_factory=installed)
    simulated = SimulatedHead(clock, other, MOTION, role="head")
    simulated.travel(10.0, 5.0)

    def mean_N(window_s):
        numbers = range(int(np.floor((clock.now() - window_s) * 8)) + 1, int(np.floor(clock.now() * 8)) + 1)
        return float(np.mean([other.force_N(n / 8, 1000 + n) for n in numbers]))

    expected = simulated.find_surface(mean_N)
    found = homed.find_surface(10.0, 5.0)
    true = MOTION.hover_mm + one_world.surface_mm(10.0, 5.0, 0.0)
    assert found == pytest.approx(expected, abs=0.01)  # other samples of the load cell's noise
    assert found == pytest.approx(true, abs=0.03)
    assert station.head.up


def test_presses_are_below_the_surface_found(station, homed, one_world):
    surface = homed.find_surface(10.0, 5.0) - MOTION.hover_mm
    homed.press(0.8, SPEED)
    assert station.head.height_mm == pytest.approx(-surface - 0.8, abs=1e-3)


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

    def hold(now_s):
        if station.head.touching and not reached.is_set():
            reached.set()

    station.clock.watch(hold)
    met = []
    real = station.force.samples_since

    def slow(time_s):
        if reached.is_set():
            go_on.wait(5.0)
        return real(time_s)

    station.force.samples_since = slow

    def press():
        try:
            homed.press(1.2, SPEED)
        except InstrumentError as error:
            met.append(error)

    thread = threading.Thread(target=press)
    thread.start()
    assert reached.wait(10.0)
    homed.safe_state()
    go_on.set()
    thread.join(timeout=10.0)
    assert "stopped on its way" in met[0].reason if hasattr(met[0], "reason") else False
    station.clock.sleep(5.0)
    assert station.head.up


def test_the_safe_state_gets_through_while_a_command_hangs(station, homed):
    homed.press(0.8, SPEED)
    with homed._marlin.alone(1.0):
        met = []

        def stop():
            try:
                homed.safe_state()
            except InstrumentError as error:
                met.append(error)

        thread = threading.Thread(target=stop)
        thread.start()
        thread.join(timeout=5.0)
    assert "another command hangs" in str(met[0])  # nobody heard it answer: somebody must look
    for _ in range(50):
        if station.head.moving:
            break
        threading.Event().wait(0.02)
    station.clock.sleep(5.0)
    assert station.head.up


def test_a_stop_in_the_middle_of_homing_leaves_no_position(station, head):
    printer = station.emulation.instruments["applicator"]
    real, met = printer._g28, []

    def stop():
        with pytest.raises(InstrumentError, match="another command hangs"):
            head.safe_state()
        met.append(True)

    def g28(parameters):
        thread = threading.Thread(target=stop)
        thread.start()
        thread.join(timeout=5.0)
        return real(parameters)

    printer._g28 = g28
    with pytest.raises(InstrumentError, match="stopped on its way"):
        head.home()
    assert met
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


# --- faults of the line ---

MENDED = [(fault, at) for fault in (Fault.GARBLE, Fault.STALE, Fault.RESEND) for at in range(0, 40, 3)]


@pytest.mark.parametrize(("fault", "at"), [*MENDED, (Fault.BUSY, 0), (Fault.BUSY, 17)])  # the latter takes real time
def test_a_line_that_stumbles_changes_no_press(station, homed, one_world, fault, at):
    one_world.presses.clear()
    port = station.emulation.ports["applicator"]
    count = iter(range(10**6))
    met = port.faults.met
    port.faults.met = lambda: fault if next(count) == at else met()
    homed.press(0.8, SPEED)
    assert next(count) > at
    if fault is not Fault.BUSY:  # two seconds a message pass in the middle of something
        assert [round(step.change, 6) for step in one_world.presses[0].steps] == pytest.approx(
            [(0.8 - one_world.surface_mm(0.0, 0.0, 0.0)) / 4.0], abs=1e-4
        )
    homed.release()
    assert station.head.up
    assert station.head.place_mm == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize("fault", [Fault.COMPLIANCE, Fault.OVERLOAD])
def test_faults_that_a_printer_cannot_have_change_nothing(station, homed, fault):
    station.arm("applicator", fault)
    homed.press(0.8, SPEED)
    assert station.head.height_mm == pytest.approx(-0.8, abs=1e-3)


@pytest.mark.parametrize("at", range(4, 40, 5))
def test_an_old_answer_is_no_position(station, homed, at):
    port = station.emulation.ports["applicator"]
    count = iter(range(10**6))
    met = port.faults.met
    port.faults.met = lambda: Fault.STALE if next(count) == at else met()
    since = station.clock.now()
    homed.press(0.8, SPEED)
    block = homed.samples_since(since)
    assert (np.diff(block.values) > 0.004).all()  # the one before would be the same again


def test_an_answer_that_comes_late_is_waited_for_and_moves_nothing_twice(make, one_world):
    station = make(timeout_s=1.0)
    one = linked(station)
    one.home()
    before = station.head.position_mm
    station.arm("applicator", Fault.DELAY)
    one.move_to(10.0, 0.0)
    assert station.head.position_mm == pytest.approx((before[0] + 10.0, before[1], before[2]))
    one.press(0.4, SPEED)
    assert station.head.height_mm == pytest.approx(-0.4, abs=1e-3)


class KeptWaiting:
    """A printer in real time: a command that lasts says nothing for two seconds, then that it is busy."""

    def __init__(self, printer, send, lasting, seconds):
        self.printer, self.send, self.lasting, self.seconds = printer, send, lasting, seconds

    def received(self, data):
        if self.lasting in data:
            left_s = self.seconds
            while left_s > 0:
                threading.Event().wait(min(left_s, 2.0))
                left_s -= 2.0
                if left_s > 0:
                    self.send(b"echo:busy: processing\n")
        return self.printer.received(data)

    def misbehave(self, fault):
        raise AssertionError(fault)


@pytest.mark.parametrize(("lasting", "seconds"), [(b"G28", 4.5), (b"M400", 2.2)])
def test_a_printer_says_that_it_is_busy_only_after_two_seconds(make, one_world, lasting, seconds):
    station = make()
    port = PtyPort("slow printer")
    try:
        port.serve(KeptWaiting(station.emulation.instruments["applicator"], port.send, lasting, seconds))
        linked(station, address=port.address).home()
    finally:
        port.close()
    assert station.head.up


def test_silence_is_said(station, homed):
    station.arm("applicator", Fault.SILENCE)
    with pytest.raises(InstrumentError, match="does not answer any more") as caught:
        homed.move_to(10.0, 0.0)
    assert caught.value.role == "applicator"
    with pytest.raises(InstrumentError, match="does not answer any more"):
        homed.safe_state()
    station.clock.sleep(10.0)
    assert station.head.up  # it heard what it did not answer


@pytest.mark.parametrize("noticed", [False, True])
def test_a_silent_printer_is_told_to_lift_and_may_hear_it(station, homed, noticed):
    homed.find_surface(0.0, 0.0)
    homed.press(0.8, SPEED)
    assert station.head.touching
    station.arm("applicator", Fault.SILENCE)
    if noticed:
        with pytest.raises(InstrumentError, match="does not answer any more"):
            homed.alive()
    for _ in range(2):  # told twice, it goes no higher
        with pytest.raises(InstrumentError, match="does not answer any more"):
            homed.safe_state()
        until_it_moves(station.head)
        station.clock.sleep(10.0)
        assert station.head.height_mm == pytest.approx(MOTION.hover_mm, abs=0.01)


def test_a_pulled_cable_is_said(station, homed):
    station.arm("applicator", Fault.DROP)
    with pytest.raises(InstrumentError, match="link is down"):
        homed.move_to(10.0, 0.0)
    with pytest.raises(InstrumentError, match=r"there is no port|link is down|does not open|nobody answers"):
        homed.safe_state()


def plugged_in(monkeypatch, path):
    """Let a printer with an identity of its own be at a port."""
    there = [SimpleNamespace(device=path, vid=0x2C99, pid=2, serial_number="CZPX1")]
    monkeypatch.setattr(serial_link.list_ports, "comports", lambda: there)


def test_a_printer_named_by_its_identity_is_used_again_once_it_is_back(monkeypatch, station):
    plugged_in(monkeypatch, station.emulation.ports["applicator"].address)
    homed = linked(station, address="usb:2C99:0002:CZPX1")
    homed.home()
    homed.press(0.8, SPEED)
    homed._link.close()  # as a pulled cable
    station.clock.sleep(1.0)
    with pytest.raises(InstrumentError, match="usb:2C99:0002:CZPX1: the link is closed"):
        homed.samples_since(station.clock.now() - 1)
    homed.safe_state()
    station.clock.sleep(5.0)
    assert not station.head.touching
    with pytest.raises(InstrumentError, match="position is lost"):
        homed.move_to(0.0, 0.0)  # printers restart when their port is opened
    homed.home()
    homed.press(0.4, SPEED)
    assert station.head.height_mm == pytest.approx(-0.4, abs=1e-3)


def test_a_head_that_a_killed_program_left_in_the_sheet_comes_up(station, homed):
    homed.press(0.8, SPEED)
    homed.close()
    assert station.head.touching
    again = linked(station)
    assert station.head.touching  # opening moves nothing
    again.safe_state()
    station.clock.sleep(5.0)
    assert not station.head.touching
    again.home()
    assert station.head.dragged == 0


@pytest.mark.parametrize("firmware", ["prusa", "marlin"])  # a Prusa lifts by itself before it homes
def test_homing_from_within_the_sheet_lifts_first(make, firmware):
    station = make(firmware=firmware, steps_per_mm=[100.0, 100.0, 400.0])
    homed = linked(station)
    homed.home()
    homed.press(0.8, SPEED)
    homed.close()
    linked(station).home()
    assert station.head.dragged == 0
    assert station.head.up


def test_an_answer_that_is_off_the_way_is_asked_for_again(station, homed):
    """Digits that were garbled into others have no checksum in Marlin's answers."""
    real, spoilt = station.emulation.instruments["applicator"]._m114, []

    def m114(parameters):
        said = real(parameters)
        if not spoilt and station.head.moving:
            spoilt.append(said)
            told, _, count = said.partition("Count")
            return f"{told}Count{count.replace('Z:', 'Z:9')}"
        return said

    station.emulation.instruments["applicator"]._m114 = m114
    since = station.clock.now()
    homed.press(0.8, SPEED)
    assert spoilt
    assert abs(homed.samples_since(since).values).max() <= MOTION.hover_mm
    assert station.head.height_mm == pytest.approx(-0.8, abs=1e-3)


def test_a_head_that_does_not_get_there_is_said(station, homed):
    """As when something is in its way, or an end stop is met."""
    real = station.head.go
    station.head.go = lambda goal, speed: real((goal[0] - 0.3, *goal[1:]), speed)
    with pytest.raises(InstrumentError, match=r"it stands at \(134\.70, .* and was told to go to \(135\.00"):
        homed.move_to(10.0, 0.0)


# --- opening ---


def test_another_instrument_at_the_address_is_refused(make):
    station = make(firmware="marlin", steps_per_mm=[80.0, 80.0, 400.0])
    with pytest.raises(InstrumentError, match=r"firmware 'Marlin 2\.1\.2\.4' was found; 'prusa' was expected"):
        station.open("applicator", open_applicator, firmware="prusa")


def test_nobody_at_the_address_is_said(make):
    station = make()
    station.arm("applicator", Fault.SILENCE)
    with pytest.raises(InstrumentError, match=r"nobody answers as a Marlin printer within 0\.5 s"):
        station.open("applicator", open_applicator, boot_s=0.5)


def test_a_second_program_on_the_port_is_refused(station, head):
    with pytest.raises(InstrumentError, match="in use by process"):
        station.open("applicator", open_applicator)


def test_unplugged_at_start():
    options = {key: value for key, value in TABLE.items() if key != "driver"} | {"address": "/dev/no-such-port"}
    told = replace(context(None), options=options)
    with pytest.raises(InstrumentError, match="no port /dev/no-such-port"):
        open_applicator(told)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"centre": [1, 2]}, "has no option 'centre'"),
        ({"centre_mm": [1]}, "centre_mm is"),
        ({"firmware": "reprap"}, "firmware is 'reprap'"),
        ({"firmware": "marlin"}, "needs option 'steps_per_mm'"),
        ({"firmware": "marlin", "steps_per_mm": [0, 1, 1]}, "steps_per_mm is"),
        ({"search_depth_mm": 9.0}, "search_depth_mm is 9.0"),
    ],
)
def test_wrong_options_are_refused_before_anything_is_opened(station, more, said):
    with pytest.raises(ConfigError, match=said):
        station.open("applicator", open_applicator, **more)
