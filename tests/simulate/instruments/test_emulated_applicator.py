"""The emulated printer answers as Marlin does."""

import pytest
from simulated_setting import MOTION, base_scene, world

from cbsr_qa.simulate.instruments.applicator import EmulatedApplicator
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.streams import Fault, WatchedClock

OPTIONS = {"centre_mm": [125.0, 105.0], "hover_height_mm": 60.0}


@pytest.fixture(scope="module")
def one_world():
    return world(base_scene())


class Printer:
    def __init__(self, one_world, **options):
        one_world.presses.clear()
        self.rig = EmulatedRig(WatchedClock(), one_world, MOTION)
        self.unasked = []
        self.instrument = EmulatedApplicator(self.rig, OPTIONS | options, self.unasked.append)

    def __call__(self, *lines):
        return self.instrument.receive("".join(f"{line}\n" for line in lines).encode()).decode().splitlines()

    def took(self, *lines):
        before = self.rig.clock.now()
        self(*lines)
        return self.rig.clock.now() - before


@pytest.fixture
def printer(one_world):
    return Printer(one_world)


def test_it_says_start_at_boot(printer):
    assert b"".join(printer.unasked).startswith(b"start\n")


def test_the_checksums_of_the_manual(printer):
    assert printer("N0 M110 N0*125") == ["ok"]
    (ok,) = printer("N1 M105*38")
    assert ok.startswith("ok T:")


@pytest.mark.parametrize(
    ("line", "wrong"),
    [
        ("N1 M105*39", "checksum mismatch"),
        ("N1 M105", "No Checksum with line number"),
        ("N3 M105*36", "Line Number is not Last Line Number+1"),
        ("M105*38", "No Line Number with checksum"),
        ("N1 M105*", "checksum mismatch"),
    ],
)
def test_a_wrong_line_is_asked_for_again_and_has_an_ok_to_swallow(printer, line, wrong):
    assert printer(line) == [f"Error:{wrong}, Last Line: 0", "Resend: 1", "ok"]
    assert printer("N1 M105*38")[0].startswith("ok")


def test_a_line_of_96_bytes_is_cut_off(printer):
    assert printer("G4 " + "S0" + " " * 100 + "P1000") == ["ok"]
    assert printer.rig.clock.now() == 0.0


def test_what_it_does_not_know_is_echoed_and_gets_its_ok(printer):
    assert printer("M9999 S1") == ['echo:Unknown command: "M9999 S1"', "ok"]
    assert printer("HELLO")[-1] == "ok"


def test_an_ok_to_a_move_means_queued_and_m400_waits(printer):
    printer("G28 X Y Z")
    assert printer.took("G1 Z60 F600") == 0.0
    assert printer.took("M400") == pytest.approx(6.0, abs=1e-5)


def test_it_says_that_it_is_busy_every_two_seconds_while_it_waits(printer):
    printer("G28 X Y Z", "G1 Z70 F600")
    printer.unasked.clear()
    assert printer("M400") == ["ok"]
    assert (
        printer.unasked == [b"echo:busy: processing\n"] * 3
    )  # while it waits: drivers give up after less than a homing


def test_a_full_buffer_holds_back_the_ok(printer):
    printer("G28 X Y Z")
    moves = [f"G1 Z{10 * (n % 2 + 1)} F600" for n in range(17)]
    assert printer.took(*moves[:16]) == 0.0
    assert printer.took(moves[16]) == pytest.approx(1.0, abs=1e-5)


def test_position_is_the_target_and_count_is_live(printer):
    printer("G28 X Y Z", "G1 Z60 F600")
    printer.rig.clock.sleep(1.5)
    assert printer("M114") == ["X:0.00 Y:0.00 Z:60.00 E:0.00 Count X: 0.00 Y:0.00 Z:15.00 E:0.00", "ok"]


def test_count_in_steps_on_stock_marlin(one_world):
    printer = Printer(one_world, firmware="marlin", steps_per_mm=[80.0, 80.0, 400.0])
    printer("G28 X Y Z", "G1 X10 Z60 F600")
    printer.rig.clock.sleep(100)
    assert printer("M114") == ["X:10.00 Y:0.00 Z:60.00 E:0.00 Count X:800 Y:0 Z:24000", "ok"]
    assert "FIRMWARE_NAME:Marlin 2" in printer("M115")[0]


def test_before_homing_it_does_not_know_where_it_is(printer):
    assert printer("M114")[0].startswith("X:0.00 Y:0.00 Z:0.00")
    assert printer.rig.head.position_mm[2] > 10
    printer("G28 X Y Z")
    assert printer.rig.head.position_mm == (0.0, 0.0, 0.0)


def test_a_plain_g28_levels_the_mesh_on_a_prusa_only(one_world):
    for firmware, more_s in (("prusa", 60.0), ("marlin", 0.0)):
        printer = Printer(one_world, firmware=firmware)
        named = printer.took("G28 X Y Z")
        printer("G1 X10 Y10 Z40 F6000", "M400")
        assert printer.took("G28") == pytest.approx(named + more_s, abs=0.01)


def test_relative_moves(printer):
    printer("G28 X Y Z", "G91", "G1 Z5 F600", "G1 Z5", "G90", "G1 X20", "M400")
    assert printer.rig.head.position_mm == pytest.approx((20.0, 0.0, 10.0))


def test_it_does_not_leave_its_reach(printer):
    printer("G28 X Y Z", "G1 X999 Z-3 F6000", "M400")
    assert printer.rig.head.position_mm == pytest.approx((250.0, 0.0, 0.0))


def test_a_quick_stop_stands_still_where_it_is_and_forgets_the_queue(printer):
    printer("G28 X Y Z", "G1 Z60 F600", "G1 Z10", "G1 Z60")
    printer.rig.clock.sleep(1.0)
    assert printer("M410") == ["ok"]
    assert printer.took("M400") == 0.0
    assert printer("M114")[0].startswith("X:0.00 Y:0.00 Z:10.00")


@pytest.mark.parametrize("how", ["M112", "told"])
def test_a_reset_loses_position_line_number_and_what_it_was_told(printer, how):
    printer("N0 M110 N0*125", "N1 M105*38", "G28 X Y Z", "G1 Z60 F600", "M400", "G1 Z40")
    printer.rig.clock.sleep(0.5)
    if how == "told":
        printer.instrument.misbehave(Fault.RESET)
    said = printer("M112")
    assert "start" in said
    assert "ok" not in said
    printer.rig.clock.sleep(10)
    assert printer.rig.head.position_mm[2] == pytest.approx(55.0)
    assert printer("M114")[0].startswith("X:0.00 Y:0.00 Z:0.00")
    assert printer("N2 M105*37")[1] == "Resend: 1"


def test_told_to_ask_again_it_asks_for_the_next_numbered_line_once(printer):
    printer.instrument.misbehave(Fault.RESEND)
    assert printer("M105")[0].startswith("ok")
    assert printer("N1 M105*38")[1:] == ["Resend: 1", "ok"]
    assert printer("N1 M105*38")[0].startswith("ok")


def test_told_to_be_busy_it_says_so_before_it_answers(printer):
    printer.unasked.clear()
    printer.instrument.misbehave(Fault.BUSY)
    printer.unasked.clear()
    assert printer("M400") == ["ok"]
    assert printer.unasked == [b"echo:busy: processing\n"] * 3
    assert printer.rig.clock.now() == 6.0
