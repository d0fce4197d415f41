"""Drivers of load cells and thermometers that send lines, over emulated ones: faults and bad input."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from line_samplers import skipped, skipped_lines, true_N
from simulated_setting import held
from terminal import Terminal

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.plugin.links import serial_link
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.simulate.instruments.streams import Fault
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa_plugins.hardware._line_sampler import LineSampler
from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell, open_thermometer

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


@pytest.mark.parametrize(
    ("came", "said"),
    [
        (b"\xf8\x80x\x00" * 9, r"36 bytes without a line end, the last '\\xf8\\x80x\\x00.*' was found within 2 s"),
        (b"10,0.5\r20,0.5\r", r"14 bytes whose lines end in \\r, not in \\n, the last '.*' was found within 2 s"),
    ],
)
@pytest.mark.parametrize("clock", [VirtualClock, RealClock])
def test_bytes_at_another_baud_rate_are_quoted(came, said, clock):
    terminal = Terminal()
    link = SerialLink("cell", terminal.path, baud=9600)
    terminal.say(came)
    while link._port.in_waiting < len(came):  # a busy machine passes them on later; a virtual clock would not wait
        time.sleep(0.01)
    lines = LineSampler(link, clock(), timed=True, rate_hz=8.0, convert=float)
    with pytest.raises(InstrumentError, match=said) as caught:
        lines.wait_for_first(2.0)
    lines.close()
    terminal.hang_up()
    assert "baud rate" in caught.value.remedy
    assert "switched on" not in caught.value.remedy


def test_another_instrument_at_the_address_is_said(station):
    """A thermometer where the load cell should be."""
    there = station.emulation.fill_address(station.specs["thermometer"]).options["address"]
    with pytest.raises(InstrumentError, match=r"'2\d\.\d+' was found .*'<milliseconds>,<value>' was expected"):
        station.open("cell", open_load_cell, address=there)
