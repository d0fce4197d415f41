"""Emulated samplers send their lines as time passes, and stop when their line is down."""

import pytest
import serial
from simulated_setting import MOTION, base_scene, world

from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.samplers import EmulatedLoadCell
from cbsr_qa.simulate.instruments.streams import Fault, PtyPort, WatchedClock


@pytest.fixture
def sampled():
    port = PtyPort("load cell")
    rig = EmulatedRig(WatchedClock(), world(base_scene()), MOTION)
    cell = EmulatedLoadCell(rig, {"unit": "g", "rate_hz": 8.0}, port.send)
    cell.attach(port)
    port.serve(cell)
    yield rig.clock, port
    port.close()


def test_eight_lines_a_second_can_be_read_when_the_sleep_returns(sampled):
    clock, port = sampled
    with serial.Serial(port.address, timeout=2.0) as driver:
        clock.sleep(1.0)
        assert driver.read(driver.in_waiting).count(b"\r\n") == 8


@pytest.mark.parametrize("dropped", [False, True], ids=["closed", "dropped"])
def test_time_passes_where_the_line_is_down(sampled, dropped):
    clock, port = sampled
    if dropped:
        port.faults.arm(Fault.DROP)
        clock.sleep(1.0)
    else:
        port.close()
    clock.sleep(1.0)
    assert port.down
    assert port.unread() == 0
