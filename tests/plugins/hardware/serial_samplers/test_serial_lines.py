"""Drivers of instruments that send lines, over a bare terminal and a real clock; how their clocks are mapped."""

from dataclasses import replace

import numpy as np
import pytest
from line_samplers import skipped
from simulated_setting import context
from terminal import Terminal

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.system.clock import RealClock
from cbsr_qa_plugins.hardware._line_sampler import DeviceTime, LineSampler
from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell

# --- a real clock: a thread reads ---


@pytest.fixture
def line():
    end = Terminal()
    yield end
    end.hang_up()


@pytest.fixture
def opened(line, monkeypatch):
    """Opens load cells at the line; they are closed whatever becomes of the test, or their lock would outlive it."""
    cells, wait = [], LineSampler.wait_for_first

    def wait_and_say(lines, allowed_s):
        line.say(b"990,0.5\r\n1000,1.0\r\n")  # not before the port is open: what came earlier is thrown away
        wait(lines, allowed_s)

    monkeypatch.setattr(LineSampler, "wait_for_first", wait_and_say)

    def load_cell(clock, **options):
        told = replace(context(None, clock=clock), role="cell", options={"address": line.path} | options)
        cells.append(open_load_cell(told))
        return cells[-1]

    yield load_cell
    for cell in cells:
        cell.close()


def until(true, clock, allowed_s=15.0):
    while not true() and clock.now() < allowed_s:
        clock.sleep(0.01)
    assert true()


def test_on_a_real_clock_lines_are_stamped_when_they_come(line, opened):
    clock = RealClock()
    cell = opened(clock, boot_s=5.0, rate_hz=100.0)
    said = []
    for n in range(1, 6):
        clock.sleep(0.05)
        said.append(clock.now())
        line.say(f"{1000 + 50 * n},{n}\r\n".encode())
    until(lambda: len(cell.samples_since(-1.0)) == 6, clock)
    block = cell.samples_since(-1.0)
    assert block.values.tolist() == [1.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert abs(block.time_s[1:] - said).max() < 0.1  # the first was said 0.2 s before all were there


def test_a_line_in_two_pieces_is_one_sample(line, opened):
    clock = RealClock()
    cell = opened(clock)
    line.say(b"1125,2.")
    clock.sleep(0.1)
    line.say(b"5\r\n")
    until(lambda: len(cell.samples_since(-1.0)) == 2, clock)
    assert cell.samples_since(-1.0).values.tolist() == [1.0, 2.5]


@pytest.mark.parametrize("bad", ["1125,", "1125;2.5", "nan", "1125,nan", "1125,inf", "1125,0x10", "-5,1.0", "1,2,3"])
def test_what_is_no_such_line_is_skipped_and_counted(line, opened, bad):
    clock = RealClock()
    cell = opened(clock)
    line.say(f"{bad}\r\n1250,3.0\r\n".encode())
    until(lambda: len(cell.samples_since(-1.0)) == 2, clock)
    assert cell.samples_since(-1.0).values.tolist() == [1.0, 3.0]
    assert skipped(cell) == 1


def test_nothing_but_nonsense_is_another_instrument(line, opened):
    clock = RealClock()
    cell = opened(clock)
    line.say(b"\xfe\x80garbage\r\n" * 25)

    def refused():
        try:
            cell.samples_since(-1.0)
        except InstrumentError as error:
            return "could not be read" in error.reason
        return False

    until(refused, clock)


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
