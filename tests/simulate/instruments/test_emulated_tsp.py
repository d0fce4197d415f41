"""The language of the emulated source-measure unit: what it runs, and what it refuses like the instrument."""

import struct

import pytest
from scanning_rig import TabledWorld

from cbsr_qa.domain.plan.plan import Motion
from cbsr_qa.simulate.instruments.rig import EmulatedRig
from cbsr_qa.simulate.instruments.source_meter import EmulatedSourceMeter
from cbsr_qa.simulate.instruments.streams import Fault, WatchedClock


@pytest.fixture
def smu():
    rig = EmulatedRig(WatchedClock(), TabledWorld(), Motion(40 / 60, 10.0, 25.0))
    one = EmulatedSourceMeter(rig, {}, lambda data: None)
    one.bench = rig
    return one


def say(smu, *lines):
    return smu.receive("".join(f"{line}\n" for line in lines).encode()).decode("latin-1")


def errors(smu):
    said = say(smu, *["print(errorqueue.next())"] * 3)
    return [(float(code), text) for code, text, *_ in (line.split("\t") for line in said.splitlines()) if float(code)]


def test_it_says_who_it_is(smu):
    assert say(smu, "*IDN?") == "Keithley Instruments Inc., Model 2634B, 4123456, 3.2.2\n"


def test_lines_may_come_in_pieces(smu):
    assert smu.receive(b"print(1") == b""
    assert smu.receive(b")\nprint(") == b"1.00000e+00\n"
    assert smu.receive(b'"a", true, nil)\n') == b"a\ttrue\tnil\n"


def test_attributes_are_read_back_with_the_precision_that_was_set(smu):
    assert say(smu, "smub.source.leveli = 1.234567891e-4", "print(smub.source.leveli)") == "1.23457e-04\n"
    assert say(smu, "format.asciiprecision = 10", "print(smub.source.leveli)") == "1.234567891e-04\n"


def test_functions_loops_and_arguments(smu):
    say(smu, 'function f(n, word) for k = 1, n do print(word, k) end print("end of it") end')
    assert say(smu, 'f(2, "x")') == "x\t1.00000e+00\nx\t2.00000e+00\nend of it\n"


@pytest.mark.parametrize(
    "line",
    ["smub.source.leveli =", "for k = 1, 2 print(k) end", "print(1", "function f( print(1) end", "?", "end", "1 = 2",
     "while true do end", 'print("a"'],
)  # fmt: skip
def test_a_line_that_is_not_in_the_language_is_not_run_at_all(smu, line):
    assert say(smu, f"print(7) {line}") == ""
    ((code, text),) = errors(smu)
    assert code == -285
    assert text.startswith("TSP Syntax error at line 1")


@pytest.mark.parametrize(
    "line", ["smub.source.nothing = 1", "print(nobody)", "nobody()", "smub.measure.x()", "smuc.source.leveli = 1"]
)
def test_names_that_stand_for_nothing_stop_the_line(smu, line):
    assert say(smu, f"print(7) {line} print(8)") == "7.00000e+00\n"
    ((code, _),) = errors(smu)
    assert code == -286


@pytest.mark.parametrize("line", ["smub.source.leveli = 2", "smub.source.limitv = 500", "smua.measure.nplc = 26"])
def test_values_out_of_range_are_not_taken(smu, line):
    name = line.partition(" ")[0]
    before = say(smu, f"print({name})")
    say(smu, line)
    assert errors(smu) == [(-222.0, "Parameter data out of range")]
    assert say(smu, f"print({name})") == before


def test_an_empty_queue_says_so(smu):
    assert say(smu, "print(errorqueue.next())") == "0.00000e+00\tQueue Is Empty\t0.00000e+00\t1.00000e+00\n"
    say(smu, "?", "errorqueue.clear()")
    assert say(smu, "print(errorqueue.count)") == "0.00000e+00\n"


def drive(smu, level_A):
    say(smu, "smub.source.func = smub.OUTPUT_DCAMPS", f"smub.source.leveli = {level_A:.9e}",
        "smub.source.output = smub.OUTPUT_ON", "smua.source.output = 1")  # fmt: skip


def test_it_reads_what_ohm_s_law_gives_and_takes_its_aperture_for_it(smu):
    drive(smu, 1e-4)
    smu.bench.wiring.drive, smu.bench.wiring.measure = 3, 5
    say(smu, "smua.measure.nplc = 0.5")
    before_s = smu.bench.clock.now()
    volts = float(say(smu, "print(smua.measure.v())"))
    assert volts == pytest.approx(1e-4 * smu.bench.world.ohm[3, 5], rel=1e-5)
    assert smu.bench.clock.now() - before_s == pytest.approx(0.01, abs=1e-6)


def test_resistance_and_power_are_those_of_volts_and_amperes(smu):
    smu.bench.world.drive_ohm[0] = 2e3
    drive(smu, 1e-3)
    volts, amperes = (float(say(smu, f"print(smub.measure.{quantity}())")) for quantity in "vi")
    assert float(say(smu, "print(smub.measure.r())")) == pytest.approx(volts / amperes, rel=1e-5)
    assert float(say(smu, "print(smub.measure.p())")) == pytest.approx(volts * amperes, rel=1e-5)
    assert float(say(smu, "print(smua.measure.r())")) == pytest.approx(9.91e37)  # it drives no current
    say(smu, "smub.measure.autorangev = 0", "smub.measure.rangev = 0.1")
    assert float(say(smu, "print(smub.measure.p())")) == pytest.approx(9.91e37)


def test_beyond_its_limit_the_source_gives_what_the_limit_drives(smu):
    smu.bench.world.drive_ohm[0] = 1e5
    drive(smu, 1e-3)
    say(smu, "smub.source.limitv = 20", "smub.measure.autorangei = 1")
    assert say(smu, "print(smub.source.compliance)") == "true\n"
    assert float(say(smu, "print(smub.measure.i())")) == pytest.approx(2e-4)
    say(smu, "smub.source.limitv = 101")
    assert say(smu, "print(smub.source.compliance)") == "false\n"
    assert float(say(smu, "print(smub.measure.i())")) == pytest.approx(1e-3)


def test_binary_buffers_hold_readings_and_status_and_say_where_there_is_none(smu):
    smu.bench.world.drive_ohm[0] = 1e5
    drive(smu, 1e-3)
    say(smu, "format.data = format.REAL32", "smub.nvbuffer1.appendmode = 1", "smub.measure.rangei = 1e-3",
        "for k = 1, 2 do smub.measure.i(smub.nvbuffer1) end")  # fmt: skip
    reply = smu.receive(b"printbuffer(1, 3, smub.nvbuffer1.readings, smub.nvbuffer1.statuses)\n")
    assert reply[:2] == b"#0"
    assert reply[-1:] == b"\n"
    values = struct.unpack("<6f", reply[2:-1])
    assert values[:4] == pytest.approx((2e-4, 0x40, 2e-4, 0x40))
    assert values[4:] == pytest.approx((9.91e37, 9.91e37))


def test_a_reading_beyond_the_range_is_no_number(smu):
    drive(smu, 1e-3)
    say(smu, "smua.measure.autorangev = 0", "smua.measure.rangev = 1")
    assert float(say(smu, "print(smua.measure.v())")) == pytest.approx(9.91e37)


def test_a_reset_forgets_functions_settings_and_output(smu):
    drive(smu, 1e-3)
    say(smu, "function f() print(1) end")
    smu.misbehave(Fault.RESET)
    assert smu.bench.wiring.current_A is None
    assert say(smu, "f()", "print(smub.source.leveli)") == "0.00000e+00\n"
    assert [code for code, _ in errors(smu)] == [-286]


def test_what_is_not_switched_on_gives_nothing(smu):
    say(smu, "smub.source.func = 0", "smub.source.leveli = 1e-3")
    assert smu.bench.wiring.current_A is None
    assert float(say(smu, "print(smua.measure.v())")) == 0.0
