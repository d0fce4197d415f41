"""The driver of Marlin printers over an emulated one: every fault of the line, and how it is opened."""

import re
import threading
from types import SimpleNamespace

import numpy as np
import pytest
from marlin_printer import SPEED, linked, until_it_moves
from simulated_setting import MOTION
from terminal import Terminal

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.plugin.links import serial_link
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.simulate.instruments.applicator import EmulatedApplicator
from cbsr_qa.simulate.instruments.streams import Fault, PtyPort
from cbsr_qa_plugins.hardware._marlin_link import MarlinLink
from cbsr_qa_plugins.hardware.marlin_applicator import open_applicator

# --- faults of the line ---


def fault_at(station, fault, at):
    """Let a fault meet the exchange of this number from now on; what counts them."""
    faults, count = station.emulation.ports["applicator"].faults, iter(range(10**6))
    take = faults.take
    faults.take = lambda: fault if next(count) == at else take()
    return count


MENDED = [(fault, at) for fault in (Fault.GARBLE, Fault.STALE, Fault.RESEND) for at in range(0, 40, 3)]
#: The first message, one in the middle of a press and one near its end stay in ``make test``; being busy takes time.
_MENDED_BY_TIER = [
    pytest.param(fault, at, marks=() if at in (0, 18, 36) else pytest.mark.rest)
    for fault, at in [*MENDED, (Fault.BUSY, 0), (Fault.BUSY, 17)]
]


@pytest.mark.parametrize(("fault", "at"), _MENDED_BY_TIER)
def test_a_line_that_stumbles_changes_no_press(station, homed, one_world, fault, at):
    one_world.presses.clear()
    count = fault_at(station, fault, at)
    homed.press(0.8, SPEED)
    assert next(count) > at
    if fault is not Fault.BUSY:  # two seconds a message pass in the middle of something
        assert [round(step.change, 6) for step in one_world.presses[0].steps] == pytest.approx(
            [(0.8 - one_world.surface_mm(0.0, 0.0, 0.0)) / 4.0], abs=1e-4
        )
    homed.release()
    assert station.head.up
    assert station.head.place_mm == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize("acknowledgement", [rb"ok \1\n", rb"ok N7 P15 B3 \1\n", rb"\1\nok N7 P15 B3\n"])
def test_an_answer_on_the_line_of_its_acknowledgement_is_read(make, monkeypatch, one_world, acknowledgement):
    receive = EmulatedApplicator.receive
    monkeypatch.setattr(
        EmulatedApplicator,
        "receive",
        lambda self, data: re.sub(rb"(X:[^\n]*)\nok\n", acknowledgement, receive(self, data)),
    )
    station = make()
    head = linked(station)
    head.home()
    head.move_to(12.0, -7.0)
    one_world.presses.clear()
    head.press(0.8, SPEED)
    assert len(one_world.presses) == 1
    head.release()
    assert station.head.place_mm == pytest.approx((12.0, -7.0))


@pytest.mark.parametrize("at", range(4, 40, 5))
def test_an_old_answer_is_no_position(station, homed, at):
    fault_at(station, Fault.STALE, at)
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

    def receive(self, data):
        if self.lasting in data:
            left_s = self.seconds
            while left_s > 0:
                threading.Event().wait(min(left_s, 2.0))
                left_s -= 2.0
                if left_s > 0:
                    self.send(b"echo:busy: processing\n")
        return self.printer.receive(data)

    def misbehave(self, fault):
        raise AssertionError(fault)


@pytest.mark.rest
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
    with pytest.raises(
        InstrumentError, match=r"there is no port|link is down|does not open|no Marlin printer answers"
    ):
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
    with pytest.raises(InstrumentError, match=r"it stands at \(64\.70, .* and was told to go to \(65\.00"):
        homed.move_to(10.0, 0.0)


# --- opening ---


def test_another_instrument_at_the_address_is_refused(make):
    station = make(firmware="marlin", steps_per_mm=[80.0, 80.0, 400.0])
    with pytest.raises(InstrumentError, match=r"firmware 'Marlin 2\.1\.2\.4' was found; 'prusa' was expected"):
        station.open("applicator", open_applicator, firmware="prusa")


@pytest.mark.parametrize(
    ("firmware", "model", "serial"),
    [
        ("prusa", "Prusa i3 MK3S", "00000000-0000-0000-0000-000000000000"),
        ("marlin", "3D Printer", "cede2a2f-41a2-4748-9b12-c55c62f367ff"),
    ],
)
def test_the_serial_number_holds_no_list_of_abilities(make, firmware, model, serial):
    station = make(firmware=firmware, steps_per_mm=[80.0, 80.0, 400.0])
    assert "Cap:" in station.emulation.instruments["applicator"]._m115(None)
    identity = station.open("applicator", open_applicator).identity()
    assert (identity.model, identity.serial) == (model, serial)


def test_nobody_at_the_address_is_said(make):
    station = make()
    station.arm("applicator", Fault.SILENCE)
    with pytest.raises(InstrumentError, match=r"no Marlin printer answers within 0\.5 s"):
        station.open("applicator", open_applicator, boot_s=0.5)


def test_a_printer_at_another_baud_rate_is_quoted():
    terminal = Terminal()
    link = SerialLink("applicator", terminal.path, baud=9600, timeout_s=0.1)
    terminal.say(b"\xf8\x80x\x00" * 3)
    with pytest.raises(InstrumentError, match=r"answers within 0\.5 s, and what came is 12 bytes without") as caught:
        MarlinLink(link, boot_s=0.5)
    link.close()
    terminal.hang_up()
    assert "baud rate" in caught.value.remedy


def test_a_search_below_the_sheet_is_refused_before_anything_is_opened(station):
    with pytest.raises(ConfigError, match="search_depth_mm is 9"):
        station.open("applicator", open_applicator, search_depth_mm=9.0)
