"""The multiplexer's driver over the emulated board's pseudo terminal."""

import re

import pytest
from scanning_rig import MATERIAL, SENSOR, Scanning

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.plugin.links.serial_link import SerialLink
from cbsr_qa.simulate.instruments import multiplexer as emulated, streams
from cbsr_qa.simulate.instruments.streams import Fault, PtyPort, WatchedClock
from cbsr_qa.system.clock import RealClock
from cbsr_qa_plugins.hardware.esp32_multiplexer import open_multiplexer


def connected(bench):
    return bench.rig.wiring.drive, bench.rig.wiring.measure


def counter(bench):
    return bench.emulation.instruments["multiplexer"]._counter


# --- the emulated board, byte by byte ---


@pytest.fixture
def line(bench):
    link = SerialLink("line", bench.emulation.ports["multiplexer"].address, baud=115200, timeout_s=0.5)
    yield link
    link.close()


def test_the_board_says_where_it_is_with_its_labels_of_source_and_sink_swapped(line):
    line.write(b"g")
    assert line.read_line() == b"gisrc1,isnk0,vn0,vp1"
    line.write(b"i")
    assert line.read(1) == b"i"
    line.write(b"g")
    assert line.read_line() == b"gisrc2,isnk1,vn0,vp1"


def test_the_board_obeys_the_first_byte_of_what_comes_together(bench, line):
    line.write(b"iii")
    assert line.read(1) == b"i"
    assert line.read_available() == b""
    assert counter(bench) == 1


def test_the_board_s_counter_comes_late_without_a_line_end_and_glued_to_a_log_line(line):
    line.write(b"c")
    assert line.read(1) == b"c"
    assert line.read_line().startswith(b"0\x1b[0;32mI (")


@pytest.mark.rest
def test_the_board_logs_between_its_answers(bench, line):
    time = RealClock()
    for steps in range(1, 101):
        line.write(b"i")
        while counter(bench) < steps:
            assert time.now() < 5
    said = b""
    while said.count(b"\n") < 2 or not said.endswith(b"\n"):
        said += line.read(1)
    assert len(re.findall(rb"\x1b\[0;32mI \(\d+\) mux: \d+ steps so far, i\x1b\[0m\r\n", said)) == 2
    assert re.sub(rb"\x1b.*?\n", b"", said) == 100 * b"i"


def test_the_board_says_when_it_starts_and_is_at_its_first_combination(bench, line):
    line.write(b"i")
    line.read(1)
    bench.arm("multiplexer", Fault.RESET)
    line.write(b"g")
    said = [line.read_line() for _ in range(6)]
    assert b"POWERON_RESET" in said[2]
    assert said[-1] == b"gisrc1,isnk0,vn0,vp1"


# --- the driver ---


@pytest.mark.parametrize("inner", ["current", "voltage"])
def test_it_connects_every_combination_in_its_declared_order(inner):
    with Scanning(multiplexer={"inner": inner}) as bench:
        scanner = bench.started()
        seen = []
        for expected in scanner.order():
            seen.append(connected(bench))
            assert seen[-1] == expected
            scanner.step()
        assert len(set(seen)) == 256
        assert scanner.position() == 0
        scanner.alive()


def test_a_step_waits_until_it_has_settled(bench):
    scanner = bench.open_multiplexer(settle_ms=4)
    before_s = bench.clock.now()
    scanner.step()
    assert bench.clock.now() - before_s == pytest.approx(0.0042, abs=1e-6)


def test_start_goes_on_to_the_first_combination_from_anywhere(bench):
    scanner = bench.started()
    for _ in range(40):
        scanner.step()
    assert scanner.position() == 40
    scanner.start()
    assert connected(bench) == (0, 0)


def test_a_start_where_it_knows_where_it_is_costs_nothing(bench):
    scanner = bench.started()
    before_s = bench.clock.now()
    scanner.start()
    assert bench.clock.now() == before_s


def test_a_declared_order_that_the_board_has_not_is_refused_at_opening(bench):
    with pytest.raises(InstrumentError, match=r"after the first step it connects drive pair 1 and measure pair 0"):
        bench.open_multiplexer(inner="voltage")  # the board was made with current as the inner pair


def test_a_board_whose_pairs_are_others_is_refused_at_opening():
    with Scanning(multiplexer={"current_skip": 1}) as bench:
        with pytest.raises(InstrumentError, match=r"drives from electrode 0 to 2 .* not pairs of the sensor type"):
            bench.open_multiplexer(current_skip=0)
        with pytest.raises(ConfigError, match="pair 0-2 is not among the sensor type's"):
            bench.open_multiplexer()


def test_a_counter_that_contradicts_is_refused(bench, monkeypatch):
    late = emulated.EmulatedMultiplexer._later
    monkeypatch.setattr(emulated.EmulatedMultiplexer, "_later", lambda self, digits: late(self, b"17"))
    with pytest.raises(InstrumentError, match="its counter is at 17, and it connects combination number 1"):
        bench.open_multiplexer()


def test_a_counter_that_stays_out_is_let_pass(bench, monkeypatch):
    monkeypatch.setattr(emulated.EmulatedMultiplexer, "_later", lambda self, digits: None)
    bench.open_multiplexer()


@pytest.mark.parametrize("fault", [Fault.GARBLE, Fault.DELAY])
def test_a_step_whose_echo_is_lost_may_be_tried_again_from_the_start(hasty, fault, monkeypatch):
    monkeypatch.setattr(streams, "LATE_S", 0.45)
    scanner = hasty.started()
    hasty.arm("multiplexer", fault)
    with pytest.raises(InstrumentError) as lost:
        scanner.step()
    assert lost.value.retryable
    scanner.start()
    assert connected(hasty) == (0, 0)
    assert scanner.position() == 0


def test_an_old_echo_ahead_of_the_right_one_is_not_taken_for_the_next_step(bench):
    scanner = bench.started()
    scanner.step()
    bench.arm("multiplexer", Fault.STALE)
    for _ in range(5):
        scanner.step()
    assert scanner.position() == 6


def test_an_old_position_ahead_of_the_right_one_is_not_taken_for_it(bench):
    scanner = bench.started()
    bench.emulation.ports["multiplexer"]._last = b"gisrc5,isnk4,vn0,vp1\r\n"
    bench.arm("multiplexer", Fault.STALE)
    assert scanner.position() == 0


def test_a_restart_in_between_is_noticed_by_asking(hasty):
    scanner = hasty.started()
    for _ in range(3):
        scanner.step()
    hasty.arm("multiplexer", Fault.RESET)
    assert scanner.position() == 0
    for _ in range(3):
        scanner.step()
    hasty.arm("multiplexer", Fault.RESET)
    with pytest.raises(InstrumentError, match="restarted") as noticed:
        scanner.alive()
    assert noticed.value.retryable


@pytest.mark.parametrize("fault", [Fault.DROP, Fault.SILENCE])
def test_a_board_that_is_gone_is_an_error_with_role_and_address(hasty, fault):
    scanner = hasty.started(boot_s=0.1)
    hasty.arm("multiplexer", fault)
    for attempt in range(2):
        with pytest.raises(InstrumentError, match="multiplexer at /dev/") as gone:
            scanner.step()
        assert gone.value.retryable == (attempt == 0)
        assert gone.value.reason.count("multiplexer at") == 1
    scanner.safe_state()


def test_a_board_that_was_unplugged_is_opened_again(bench, monkeypatch):
    scanner = bench.started()
    port = scanner._link._port
    monkeypatch.setattr(port, "write", lambda data: (_ for _ in ()).throw(OSError("device not configured")))
    with pytest.raises(InstrumentError, match="the link is down") as lost:
        scanner.step()
    assert lost.value.retryable
    scanner.start()
    assert scanner._link._port is not port
    assert connected(bench) == (0, 0)


def test_it_tests_itself_by_a_whole_round(bench, monkeypatch):
    scanner = bench.open_multiplexer()
    (line,) = scanner.self_test()
    assert line.outcome is CheckOutcome.OK
    board = bench.emulation.instruments["multiplexer"]
    connect, steps = board._connect, []
    monkeypatch.setattr(board, "_connect", lambda n: (steps.append(n), len(steps) == 100 or connect(n)))
    (line,) = scanner.self_test()
    assert line.outcome is CheckOutcome.FAILED
    assert line.said == "256 steps lead from the first combination to number 256"


def opened(address, **options):
    made = StationContext(
        "mux", WatchedClock(), SENSOR, MATERIAL, Indenter(13.0), 1,
        {"address": address, "inner": "current", "timeout_s": 0.05, "boot_s": 0.1, **options},
    )  # fmt: skip
    return open_multiplexer(made)


def test_another_instrument_at_the_address_is_refused_with_what_it_said(stranger):
    address = stranger(PtyPort, b"", b"start\necho:Marlin 2.1\n")  # a printer's board
    for _ in range(2):  # and the port is given back
        with pytest.raises(InstrumentError, match=r"it says b'start\\necho:Marlin") as refused:
            opened(address)
        assert "command firmware is expected" in refused.value.remedy


def test_an_address_where_nobody_answers_is_said_so(stranger):
    with pytest.raises(InstrumentError, match="it says nothing"):
        opened(stranger(PtyPort, b"", b""))


def test_no_port_at_the_address():
    with pytest.raises(InstrumentError, match="mux at /dev/nothing: there is no port"):
        opened("/dev/nothing")


def test_more_electrodes_in_between_than_there_are_are_refused():
    with pytest.raises(ConfigError, match="voltage_skip is 15"):
        opened("/dev/nothing", voltage_skip=15)
