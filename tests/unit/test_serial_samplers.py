"""Drivers of load cells and thermometers that send lines, over emulated ones and over a bare terminal."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from emulated_bench import SAFETY, EmulatedStation
from simulated_setting import HEAD, base_scene, context, held, installed, material, sensor_type, world
from terminal import Terminal

from cbsr_qa.clock import RealClock
from cbsr_qa.domain.errors import ConfigError, InstrumentError, RefusedError, SafetyError
from cbsr_qa.domain.station_check import CheckOutcome
from cbsr_qa.emulate.faults import Fault
from cbsr_qa.interfaces import Alive, Sampler, SelfTesting
from cbsr_qa.links import serial_link
from cbsr_qa.simulate.world import SimulatedWorld
from cbsr_qa_plugins.hardware._device_time import DeviceTime
from cbsr_qa_plugins.hardware.serial_load_cell import open_load_cell
from cbsr_qa_plugins.hardware.serial_thermometer import open_thermometer

CELL = {"driver": "serial-load-cell"}


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


@pytest.fixture
def make(one_world):
    made = []

    def station(**options):
        made.append(EmulatedStation(one_world, cell=CELL | options, thermometer={"driver": "serial-thermometer"}))
        return made[-1]

    yield station
    for one in made:
        one.close()


@pytest.fixture
def station(make):
    return make()


@pytest.fixture
def cell(station):
    return station.open("cell", open_load_cell)


def skipped(cell):
    """Lines it could not read."""
    return cell._source.skipped


def skipped_lines(thermometer):
    """Lines it could not read."""
    return thermometer._lines.skipped


def true_N(station, times):
    numbers = np.round(np.asarray(times) * 8).astype(int)
    return [station.rig.world.force_N(n / 8, int(n)) for n in numbers]


# --- what is read ---


def test_they_are_samplers(station, cell):
    assert isinstance(cell, Sampler)
    assert isinstance(cell, Alive)
    assert isinstance(cell, SelfTesting)
    assert (cell.channel, cell.unit) == ("force", "N")
    assert cell.identity().model == "load cell that sends lines of text, N"


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"time": "arrival"},
        {"unit": "g", "sign": -1},
        {"unit": "g", "scale": 2.5, "offset": 70.13, "sign": -1},
        {"unit": "counts", "scale": 1e-5, "offset": -3.0},
    ],
)
def test_the_force_is_the_worlds_whatever_the_line_says_it_in(make, one_world, options):
    station = make(**options)
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=2.0))
    cell = station.open("cell", open_load_cell)
    for _ in range(16):
        station.clock.sleep(0.25)
    block = cell.samples_since(1.0)
    assert len(block) >= 23
    np.testing.assert_allclose(block.values, true_N(station, block.time_s), atol=2e-4)
    assert block.values.max() > 1.0
    assert skipped(cell) == 0


def test_all_that_was_sent_up_to_now_is_there_at_once(station, cell):
    for _ in range(200):
        before = station.clock.now()
        station.clock.sleep(0.5)
        assert len(cell.samples_since(before)) in (4, 5)


def test_samples_come_after_the_time_asked_for_and_each_once(station, cell):
    seen, last = [], -1.0
    for pause in np.random.default_rng(7).uniform(0.01, 2.0, 100):
        station.clock.sleep(pause)
        block = cell.samples_since(last)
        seen += list(block.time_s)
        last = seen[-1] if seen else last
    assert (np.diff(seen) > 0).all()
    assert len(seen) == pytest.approx(8 * station.clock.now(), abs=4)
    np.testing.assert_array_equal(cell.samples_since(-1.0).time_s, seen)


def test_times_are_the_stations_though_the_device_has_its_own_clock(station, cell):
    random = np.random.default_rng(3)
    while station.clock.now() < 1200.0:  # by then the device is 48 ms ahead of itself
        station.clock.sleep(random.uniform(0.5, 5.0))
        cell.samples_since(station.clock.now())
    times = cell.samples_since(station.clock.now() - 60.0).time_s
    late_s = times - np.round(times * 8) / 8
    assert abs(late_s).max() < 0.02
    assert times[-1] <= station.clock.now()


def test_a_long_pause_is_read_whole(station, cell):
    before = station.clock.now()
    station.clock.sleep(60.0)  # more than the kernel's first buffer holds; it has room for a minute and a half
    assert len(cell.samples_since(before)) == pytest.approx(480, abs=1)


def test_what_was_an_hour_ago_is_forgotten(station, cell):
    for _ in range(180):
        station.clock.sleep(60.0)
        cell.samples_since(station.clock.now())
    kept = cell.samples_since(-1.0).time_s
    assert 3590.0 <= station.clock.now() - kept[0] <= 7300.0


def test_the_temperature_is_read(station):
    one = station.open("thermometer", open_thermometer)
    station.clock.sleep(10.0)
    block = one.samples_since(-1.0)
    assert (block.channel, block.unit) == ("temperature", "°C")
    assert len(block) >= 10
    np.testing.assert_allclose(block.values, 22.0, atol=0.1)
    assert (np.diff(block.time_s) > 0.5).all()
    assert len(one.samples_since(station.clock.now())) == 0


def test_a_resumed_session_draws_noise_of_its_own(station, cell):
    station.clock.sleep(5.0)
    before = cell.samples_since(-1.0).values
    later = SimulatedWorld(
        base_scene(), sensor_type(), material(), HEAD, seed=1, effect_factory=installed, began_s=7.5
    )
    again = EmulatedStation(later, cell=dict(CELL))
    try:
        resumed = again.open("cell", open_load_cell)
        again.clock.sleep(5.0)
        after = resumed.samples_since(-1.0).values
    finally:
        again.close()
    assert len(before) == len(after)
    assert (before != after).all()


# --- tare, limit, dead weight ---


def test_a_tare_makes_the_unloaded_cell_zero(make):
    station = make(unit="g", sign=-1)
    cell = station.open("cell", open_load_cell, offset=30.0, tare_s=1.0)  # the emulated one has no such offset
    station.clock.sleep(5.0)
    assert abs(cell.samples_since(station.clock.now() - 4).values.mean()) < 0.02


def test_a_load_is_no_zero(make, one_world):
    station = make()
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=-20.0))
    with pytest.raises(InstrumentError, match=r"reads \d\.\d+ N before it is tared; more than 0\.5 N is no zero"):
        station.open("cell", open_load_cell, tare_s=1.0)


def test_a_cell_at_its_limit_is_said_and_is_well_again_after(make, one_world):
    station = make(limit_N=2.0)
    cell = station.open("cell", open_load_cell)
    press = held(0, 0.0, 0.0, 0.25, start_s=station.clock.now())
    one_world.presses.append(press)
    station.clock.sleep(0.5)
    cell.samples_since(-1.0)
    station.clock.sleep(1.5)
    with pytest.raises(SafetyError, match=r"stands at its limit of 2 N") as caught:
        cell.samples_since(station.clock.now() - 0.1)
    assert caught.value.rule == "force"
    one_world.presses.clear()
    station.clock.sleep(1.0)
    assert cell.samples_since(-1.0).values.max() == pytest.approx(2.0)


def test_a_dead_weight_is_found_and_a_wrong_one_is_told(make, one_world):
    station = make(unit="g")
    cell = station.open("cell", open_load_cell)
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=-5000.0))  # relaxed: a steady force
    force_N = float(np.mean([one_world.force_N(station.clock.now(), n) for n in range(100)]))
    right = cell.dead_weight_check(force_N / 9.80665e-3, tolerance_percent=1.0)
    assert right.passed
    assert right.found_N == pytest.approx(force_N, rel=0.01)
    assert 0 < right.error_N < 0.01
    wrong = cell.dead_weight_check(1.05 * force_N / 9.80665e-3, tolerance_percent=1.0)
    assert not wrong.passed
    assert "expected" in wrong.words()
    with pytest.raises(RefusedError, match="checks nothing"):
        cell.dead_weight_check(0.0)


def test_a_self_test_looks_at_zero_and_noise_and_says_what_it_did_not_do(station, cell):
    zero, noise, weight = cell.self_test()
    assert (zero.name, noise.name, weight.name) == ("zero", "noise", "dead weight")
    assert zero.outcome is CheckOutcome.OK
    assert abs(zero.value) < 0.02
    assert 0 < noise.value < 0.01
    assert weight.outcome is CheckOutcome.NOT_DONE
    assert "dead_weight_g" in weight.remedy


@pytest.mark.parametrize(("share", "outcome"), [(1.0, "ok"), (1.05, "failed")])
def test_a_self_test_with_a_known_mass_asks_for_it(station, one_world, share, outcome):
    press = held(0, 0.0, 0.0, 0.2, start_s=-5000.0)  # relaxed: a steady force
    asked = []

    def ask(text):
        asked.append(text)
        one_world.presses[:] = [press] if "Put" in text else []
        return ""

    one_world.presses.append(press)
    force_N = float(np.mean([one_world.force_N(2.0, n) for n in range(100)]))
    one_world.presses.clear()
    cell = station.open("cell", open_load_cell, ask=ask, dead_weight_g=share * force_N / 9.80665e-3)
    _, _, weight = cell.self_test()
    assert weight.outcome == outcome
    assert weight.value == pytest.approx(force_N, rel=0.01)
    assert [text.split()[0] for text in asked] == ["Put", "Take"]
    assert abs(cell.self_test()[0].value) < 0.02


def test_a_self_test_warns_of_a_load(station, one_world):
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=-20.0))
    zero = station.open("cell", open_load_cell).self_test()[0]
    assert zero.outcome is CheckOutcome.WARNING
    assert zero.value > 1.0


# --- faults ---


def run_through(station, cell, fault, *, seconds=10.0):
    """Ten seconds with a fault in the middle; returns all samples."""
    station.clock.sleep(5.0)
    cell.samples_since(-1.0)
    station.arm("cell", fault)
    for _ in range(int(4 * seconds)):
        station.clock.sleep(0.25)
        cell.samples_since(station.clock.now() - 0.25)
    return cell.samples_since(-1.0)


@pytest.mark.parametrize("fault", [Fault.GARBLE, Fault.STALE, Fault.RESET, Fault.DELAY])
def test_a_line_that_stumbles_makes_up_no_sample(station, one_world, fault):
    one_world.presses.append(held(0, 0.0, 0.0, 0.1, start_s=-10.0))
    cell = station.open("cell", open_load_cell)
    block = run_through(station, cell, fault)
    if fault is Fault.DELAY:  # what came late is there, with the time it was sent at
        assert skipped(cell) == 0
    if fault in (Fault.GARBLE, Fault.STALE):
        assert skipped(cell) == 1
    assert (np.diff(block.time_s) > 0).all()
    late_s = block.time_s - np.round(block.time_s * 8) / 8
    assert abs(late_s).max() < 0.03
    wrong = abs(block.values - true_N(station, block.time_s)) > 2e-4
    assert wrong.sum() <= (fault is Fault.RESET)  # the first after a restart is as late as it was read
    missing = 8 * 15 - len(block)
    assert missing <= {Fault.RESET: 14}.get(fault, 4)


def test_late_lines_are_stale_while_they_do_not_come(station, cell):
    station.clock.sleep(5.0)
    station.arm("cell", Fault.DELAY)
    station.clock.sleep(2.5)
    assert len(cell.samples_since(station.clock.now() - 2.0)) == 0


def test_silence_is_told_by_the_age_of_what_was_read(station, cell):
    run_through(station, cell, Fault.SILENCE)
    assert len(cell.samples_since(station.clock.now() - 9.0)) == 0
    with pytest.raises(InstrumentError, match="has sent nothing"):
        cell.alive()


def test_an_overload_reads_far_above_any_ceiling(station, cell):
    assert run_through(station, cell, Fault.OVERLOAD).values.max() > 100.0


def test_a_pulled_cable_is_said(station, cell):
    with pytest.raises(InstrumentError, match=r"link is down|no port"):
        run_through(station, cell, Fault.DROP)
    with pytest.raises(InstrumentError, match=r"link is down|no port|does not open"):
        cell.samples_since(-1.0)


def test_a_cell_named_by_its_identity_is_read_again_once_it_is_back(monkeypatch, station):
    adapter = SimpleNamespace(
        device=station.emulation.ports["cell"].address, vid=0x1A86, pid=0x7523, serial_number=None
    )
    there = [adapter]
    monkeypatch.setattr(serial_link.list_ports, "comports", lambda: there)
    cell = station.open("cell", open_load_cell, address="usb:1A86:7523")
    station.clock.sleep(2.0)
    cell._source._link.close()  # as a pulled cable
    there.clear()
    for _ in range(2):
        station.clock.sleep(1.0)
        with pytest.raises(InstrumentError, match=r"no such device is plugged in|link is closed"):
            cell.samples_since(-1.0)
    there.append(adapter)
    cell.samples_since(-1.0)
    station.clock.sleep(2.0)
    block = cell.samples_since(-1.0)
    assert station.clock.now() - block.time_s[-1] < 0.2
    assert (np.diff(block.time_s) > 0).all()


@pytest.mark.parametrize("fault", [Fault.RESEND, Fault.BUSY, Fault.COMPLIANCE])
def test_faults_that_a_load_cell_cannot_have_change_nothing(station, cell, fault):
    assert len(run_through(station, cell, fault)) >= 8 * 15 - 2
    assert skipped(cell) == 0


@pytest.mark.parametrize(
    "fault", [Fault.GARBLE, Fault.STALE, Fault.RESET, Fault.DELAY, Fault.OVERLOAD, Fault.SILENCE]
)
def test_a_thermometer_that_stumbles_makes_up_no_temperature(station, fault):
    one = station.open("thermometer", open_thermometer)
    station.clock.sleep(10.0)
    station.arm("thermometer", fault)
    for _ in range(20):
        station.clock.sleep(1.0)
        one.samples_since(station.clock.now() - 1.0)
    block = one.samples_since(-1.0)
    assert (np.diff(block.time_s) > 0).all()
    if fault is Fault.OVERLOAD:
        assert block.values.max() > 100.0
        return
    np.testing.assert_allclose(block.values, 22.0, atol=0.2)
    assert skipped_lines(one) == {Fault.GARBLE: 1, Fault.RESET: 1}.get(fault, 0)
    if fault is Fault.SILENCE:
        with pytest.raises(InstrumentError, match="has sent nothing"):
            one.alive()


def test_a_thermometer_that_was_unplugged_is_said(station):
    one = station.open("thermometer", open_thermometer)
    station.arm("thermometer", Fault.DROP)
    station.clock.sleep(2.0)
    with pytest.raises(InstrumentError, match=r"thermometer at .*(link is down|no port|does not open)"):
        one.samples_since(-1.0)


# --- bad input ---


def test_nobody_at_the_address_is_said(station):
    station.arm("cell", Fault.SILENCE)
    with pytest.raises(InstrumentError, match=r"cell at /dev/pts/\d+: nothing was found within 2 s; '<milliseconds>"):
        station.open("cell", open_load_cell, boot_s=2.0)


def test_another_instrument_at_the_address_is_said(station):
    """A thermometer where the load cell should be."""
    there = station.emulation.addressed(station.specs["thermometer"]).options["address"]
    with pytest.raises(InstrumentError, match=r"'2\d\.\d+' was found .*'<milliseconds>,<value>' was expected"):
        station.open("cell", open_load_cell, address=there)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"ofset": 3.0}, "has no option 'ofset'"),
        ({"unit": "lb"}, "unit is 'lb'"),
        ({"unit": "counts"}, "needs option 'scale'"),
        ({"scale": 0}, "scale is 0"),
        ({"sign": 0}, "sign is 0"),
        ({"time": "gps"}, "time is 'gps'"),
        ({"rate_hz": 0}, "rate_hz is 0"),
        ({"limit_N": -1}, "limit_N is -1"),
    ],
)
def test_wrong_options_are_refused(station, more, said):
    with pytest.raises(ConfigError, match=said):
        station.open("cell", open_load_cell, **more)


@pytest.mark.parametrize("factory", [open_load_cell, open_thermometer])
def test_an_address_is_needed(factory):
    with pytest.raises(ConfigError, match="needs option 'address'"):
        factory(replace(context(None), options={}, safety=SAFETY))


# --- a real clock: a thread reads ---


@pytest.fixture
def line():
    end = Terminal()
    yield end
    end.hang_up()


def opened(line, clock, **options):
    told = replace(context(None, clock=clock), role="cell", options={"address": line.path} | options)
    say_soon(line, b"990,0.5\r\n1000,1.0\r\n")
    return open_load_cell(told)


def say_soon(line, data):
    import threading

    threading.Timer(0.1, lambda: line.say(data)).start()


def until(true, clock, allowed_s=2.0):
    while not true() and clock.now() < allowed_s:
        clock.sleep(0.01)
    assert true()


def test_on_a_real_clock_lines_are_stamped_when_they_come(line):
    clock = RealClock()
    cell = opened(line, clock, boot_s=5.0, rate_hz=100.0)
    said = []
    for n in range(1, 6):
        clock.sleep(0.05)
        said.append(clock.now())
        line.say(f"{1000 + 50 * n},{n}\r\n".encode())
    until(lambda: len(cell.samples_since(-1.0)) == 6, clock)
    block = cell.samples_since(-1.0)
    assert block.values.tolist() == [1.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert abs(block.time_s[1:] - said).max() < 0.04
    cell.close()


def test_a_line_in_two_pieces_is_one_sample(line):
    clock = RealClock()
    cell = opened(line, clock)
    line.say(b"1125,2.")
    clock.sleep(0.1)
    line.say(b"5\r\n")
    until(lambda: len(cell.samples_since(-1.0)) == 2, clock)
    assert cell.samples_since(-1.0).values.tolist() == [1.0, 2.5]
    cell.close()


@pytest.mark.parametrize("bad", ["1125,", "1125;2.5", "nan", "1125,nan", "1125,inf", "1125,0x10", "-5,1.0", "1,2,3"])
def test_what_is_no_such_line_is_skipped_and_counted(line, bad):
    clock = RealClock()
    cell = opened(line, clock)
    line.say(f"{bad}\r\n1250,3.0\r\n".encode())
    until(lambda: len(cell.samples_since(-1.0)) == 2, clock)
    assert cell.samples_since(-1.0).values.tolist() == [1.0, 3.0]
    assert skipped(cell) == 1
    cell.close()


def test_nothing_but_nonsense_is_another_instrument(line):
    clock = RealClock()
    cell = opened(line, clock)
    line.say(b"\xfe\x80garbage\r\n" * 25)

    def refused():
        try:
            cell.samples_since(-1.0)
        except InstrumentError as error:
            return "could not be read" in error.reason
        return False

    until(refused, clock)
    cell.close()


# --- clocks ---


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_device_times_are_mapped_by_the_lines_that_came_soonest(drift):
    random = np.random.default_rng(5)
    mapped, true_s = DeviceTime(), np.arange(0.0, 3600.0, 0.125)
    delays = 0.002 + random.exponential(0.05, true_s.shape)
    found = [
        mapped.on_station(round(1e3 * (1 + drift) * t) / 1e3, t + late)
        for t, late in zip(true_s, delays, strict=True)
    ]
    error = np.array(found) - true_s
    assert (np.diff(found) > 0).all()
    assert abs(error[800:]).max() < 0.012  # the shortest delay, a millisecond of rounding, 60 s of drift
    assert (np.array(found) <= true_s + delays + 1e-9).all()
    assert mapped.restarts == 0


def test_a_device_that_restarts_is_mapped_anew():
    mapped = DeviceTime()
    before = [mapped.on_station(n * 0.125, 100 + n * 0.125) for n in range(100)]
    after = [mapped.on_station(n * 0.125, 115 + n * 0.125) for n in range(100)]
    assert mapped.restarts == 1
    assert after[0] is None  # one line alone may have been garbled
    assert before[-1] < after[1] == pytest.approx(115.125)
    assert after[-1] == pytest.approx(115 + 99 * 0.125)


def test_an_old_line_again_is_no_sample():
    mapped = DeviceTime()
    assert mapped.on_station(1.0, 5.0) == 5.0
    assert mapped.on_station(1.125, 5.125) == pytest.approx(5.125)
    assert mapped.on_station(1.125, 5.2) is None
    assert mapped.on_station(1.0, 5.21) is None
    assert mapped.on_station(1.125, 5.22) is None
    assert mapped.on_station(1.25, 5.25) == pytest.approx(5.25)
    assert mapped.restarts == 0


@pytest.mark.parametrize("garbled_s", [1.5, 92.5, 13.5])
def test_one_garbled_time_moves_no_other_sample(garbled_s):
    mapped = DeviceTime()
    found = [mapped.on_station(garbled_s if n == 80 else n * 0.125, 100 + n * 0.125) for n in range(200)]
    assert found[80] is None
    assert mapped.restarts == 0
    np.testing.assert_allclose([t for t in found if t is not None], [100 + n * 0.125 for n in range(200) if n != 80])
