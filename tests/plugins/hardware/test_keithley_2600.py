"""The source-measure unit's driver over the emulated instrument's socket."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from scanning_rig import OHM, Scanning, TabledWorld, context

from cbsr_qa.domain.errors import InstrumentError
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.simulate.instruments import source_meter, streams
from cbsr_qa.simulate.instruments.streams import Fault, TcpPort
from cbsr_qa.system.clock import RealClock
from cbsr_qa_plugins.hardware.keithley_2600 import open_source_meter


def attribute(bench, name):
    return bench.emulation.instruments["meter"]._attributes[name]


def test_it_says_who_it_is(bench):
    said = bench.open_meter().identity()
    assert (said.role, said.driver, said.serial, said.firmware) == ("meter", "keithley-2600", "4123456", "3.2.2")
    assert said.model == "Keithley Instruments Inc. Model 2634B"
    assert not said.simulated


def test_opening_switches_a_source_off_that_was_left_on(bench):
    bench.emulation.instruments["meter"].receive(
        b"smub.source.func = 0\nsmub.source.leveli = 1e-3\nsmub.source.output = 1\n"
    )
    assert bench.rig.wiring.current_A == 1e-3
    bench.open_meter()
    assert bench.rig.wiring.current_A is None


def test_prompts_that_another_program_switched_on_do_no_harm(bench):
    assert bench.emulation.instruments["meter"].receive(b"localnode.prompts = 1\n") == b"TSP>\n"
    bench.emulation.ports["meter"].send(b"TSP>\n")
    meter = bench.sourcing()
    assert meter.measure().volts == pytest.approx(1e-4 * OHM[0, 0], rel=1e-6)


def test_a_measurement_is_the_mean_of_its_readings_with_their_current_and_time(bench):
    meter = bench.open_meter(readings=3, nplc=0.5)
    meter.source(2e-4)
    bench.rig.wiring.drive, bench.rig.wiring.measure = 2, 9
    before_s = bench.clock.now()
    reading = meter.measure()
    assert reading.volts == pytest.approx(2e-4 * OHM[2, 9], rel=1e-6)
    assert reading.current_A == pytest.approx(2e-4, rel=1e-6)
    assert not reading.compliance
    assert not reading.saturated
    took_s = bench.clock.now() - before_s
    assert took_s == pytest.approx(3 * 0.501 / 50, rel=1e-4)
    assert took_s == pytest.approx(meter.reading_period_s, rel=0.02)
    assert reading.time_s == pytest.approx(before_s + took_s / 2, abs=1e-9)


def test_small_currents_keep_their_digits(bench):
    meter = bench.open_meter()
    meter.source(1.23456e-7)
    assert bench.rig.wiring.current_A == pytest.approx(1.23456e-7, rel=1e-9)


def test_a_source_at_its_limit_is_flagged_with_the_current_that_flows(bench):
    bench.world.drive_ohm[0] = 1e5
    meter = bench.open_meter(compliance_V=20)
    meter.source(1e-3)
    reading = meter.measure()
    assert reading.compliance
    assert reading.current_A == pytest.approx(2e-4, rel=1e-6)
    bench.rig.wiring.drive = 1
    assert not meter.measure().compliance


def test_a_reading_at_the_end_of_the_range_is_saturated_and_stays_a_number():
    ohm = OHM.copy()
    ohm[0, 0], ohm[1, 1] = 40e3, 19.9e3
    with Scanning(TabledWorld(ohm)) as bench:
        bench.world.drive_ohm[:] = 1e3
        meter = bench.open_meter(compliance_V=20, range_V=20)
        meter.source(1e-3)
        at_its_end = meter.measure()
        assert at_its_end.saturated
        assert at_its_end.volts == pytest.approx(20)
        bench.rig.wiring.drive = bench.rig.wiring.measure = 1
        assert meter.measure().saturated  # 99 % of the limit, as in the rig's script
        bench.rig.wiring.measure = 0
        assert not meter.measure().saturated
        meter_20 = bench.emulation.instruments["meter"]
        meter_20.receive(b"smua.measure.rangev = 2\nsmua.source.limitv = 100\n")
        bench.rig.wiring.drive = bench.rig.wiring.measure = 1
        beyond = meter.measure()  # the instrument says 9.91e37
        assert beyond.saturated
        assert beyond.volts == pytest.approx(20)


def test_more_current_than_the_station_allows_is_refused(bench):
    meter = bench.open_meter(largest_current_mA=0.5)
    with pytest.raises(InstrumentError, match=r"0\.6 mA were asked for; the station allows 0\.5 mA"):
        meter.source(0.6e-3)
    assert bench.rig.wiring.current_A is None


def test_a_setting_that_is_not_taken_is_refused_by_the_error_queue(bench, monkeypatch):
    # An instrument whose aperture ends earlier than its driver knows.
    monkeypatch.setitem(source_meter._ATTRIBUTES, "smua.measure.nplc", (1.0, 0.001, 10.0))
    with pytest.raises(InstrumentError, match=r"refused its settings: -222 Parameter data out of range"):
        bench.open_meter(nplc=25)


@pytest.mark.parametrize(
    ("name", "value", "wanted"), [("source.limitv", 21.0, "20"), ("source.leveli", 0.0, "0.0001")]
)
def test_a_value_that_reads_back_otherwise_is_refused(bench, monkeypatch, name, value, wanted):
    instrument = bench.emulation.instruments["meter"]
    taken = instrument.assign
    monkeypatch.setattr(instrument, "assign", lambda at, given: taken(at, value if at == f"smub.{name}" else given))
    with pytest.raises(InstrumentError, match=rf"smub\.{name} was set to {wanted}, and reads back as {value:g}"):
        bench.open_meter().source(1e-4)


def test_one_that_is_too_warm_is_not_used(bench, monkeypatch):
    meter = bench.sourcing()
    bench.world.drive_ohm[0] = 1e6  # at its limit, so that a status bit is there; and it is that of the heat
    monkeypatch.setattr(source_meter, "_COMPLIANCE", 0x02)
    with pytest.raises(InstrumentError, match="too warm") as refused:
        meter.measure()
    assert not refused.value.retryable


@pytest.mark.parametrize("fault", [Fault.GARBLE, Fault.STALE, Fault.DELAY, Fault.RESET])
def test_a_lost_answer_may_be_asked_for_again_and_is_never_taken_for_the_next(hasty, fault, monkeypatch):
    monkeypatch.setattr(streams, "LATE_S", 0.45)
    meter = hasty.sourcing()
    hasty.rig.wiring.drive, hasty.rig.wiring.measure = 4, 4
    meter.measure()
    hasty.rig.wiring.drive, hasty.rig.wiring.measure = 5, 11
    hasty.arm("meter", fault)
    with pytest.raises(InstrumentError) as lost:
        meter.measure()
    assert lost.value.retryable
    assert lost.value.role == "meter"
    meter.source(1e-4)
    assert meter.measure().volts == pytest.approx(1e-4 * OHM[5, 11], rel=1e-6)


def test_after_a_lost_answer_the_source_is_off_until_it_is_asked_for(hasty):
    meter = hasty.sourcing()
    hasty.arm("meter", Fault.GARBLE)
    with pytest.raises(InstrumentError):
        meter.measure()
    with pytest.raises(InstrumentError, match="while the source is off") as off:
        meter.measure()
    assert off.value.retryable
    assert hasty.rig.wiring.current_A is None


def test_one_that_was_reset_in_the_rest_is_noticed(hasty):
    meter = hasty.sourcing()
    meter.alive()
    hasty.arm("meter", Fault.RESET)
    with pytest.raises(InstrumentError, match="it has been reset"):
        meter.alive()


def test_a_source_that_somebody_switched_off_gives_no_reading(bench):
    meter = bench.sourcing()
    bench.emulation.instruments["meter"].receive(b"smub.source.output = 0\n")
    with pytest.raises(InstrumentError, match=r"the source gives 0 mA where 0\.1 mA were asked for") as off:
        meter.measure()
    assert off.value.retryable
    meter.source(1e-4)
    assert meter.measure().current_A == pytest.approx(1e-4, rel=1e-6)


@pytest.mark.parametrize("fault", [Fault.DROP, Fault.SILENCE])
def test_an_instrument_that_is_gone_is_an_error_with_role_and_address(hasty, fault):
    meter = hasty.sourcing()
    hasty.arm("meter", fault)
    for _ in range(2):
        with pytest.raises(InstrumentError, match="meter at TCPIP::") as gone:
            meter.measure()
        assert gone.value.remedy


def test_it_tests_itself_without_current_and_is_off_after_it(bench, monkeypatch):
    meter = bench.sourcing()
    lines = {line.name: line for line in meter.self_test()}
    assert [line.outcome for line in lines.values()] == [CheckOutcome.OK] * 3
    assert lines["zero voltage"].allowed == "within 0.02 V"
    assert bench.rig.wiring.current_A is None
    meter.source(1e-4)  # and may be used again
    instrument = bench.emulation.instruments["meter"]
    instrument.receive(b"?\n")
    monkeypatch.setattr(instrument, "_volts", lambda channel: 0.05)
    lines = {line.name: line for line in meter.self_test()}
    assert lines["errors"].outcome is CheckOutcome.FAILED
    assert lines["errors"].said.startswith("-285 TSP Syntax error")
    assert lines["zero voltage"].outcome is CheckOutcome.FAILED
    assert lines["zero voltage"].value == pytest.approx(0.05)
    assert lines["zero current"].outcome is CheckOutcome.OK


# --- safe state ---


def test_the_safe_state_is_off_again_and_again(bench):
    meter = bench.sourcing()
    for _ in range(2):
        meter.safe_state()
        assert bench.rig.wiring.current_A is None
        assert attribute(bench, "smua.source.output") == 0
    meter.source(1e-4)
    assert bench.rig.wiring.current_A == 1e-4


@pytest.mark.parametrize("fault", [Fault.GARBLE, Fault.STALE, Fault.DELAY, Fault.RESET])
def test_the_safe_state_is_reached_and_confirmed_whatever_the_link_does(hasty, fault, monkeypatch):
    monkeypatch.setattr(streams, "LATE_S", 0.45)
    meter = hasty.sourcing()
    hasty.arm("meter", fault)
    meter.safe_state()
    assert hasty.rig.wiring.current_A is None


def test_a_silent_instrument_is_switched_off_and_said_not_to_have_confirmed_it(hasty):
    meter = hasty.sourcing()
    hasty.arm("meter", Fault.SILENCE)
    with pytest.raises(InstrumentError, match="no answer"):
        meter.safe_state()
    assert hasty.rig.wiring.current_A is None


def test_the_safe_state_goes_around_a_thread_that_hangs(hasty):
    meter = hasty.sourcing(timeout_s=0.6)
    hasty.arm("meter", Fault.SILENCE)
    with ThreadPoolExecutor() as others:
        hanging = others.submit(meter.measure)
        time = RealClock()
        stopping = others.submit(meter.safe_state)
        while hasty.rig.wiring.current_A is not None:
            assert time.now() < 0.5, "only after the other thread gave up"
        assert hanging.running()
        assert isinstance(hanging.exception(), InstrumentError)
        meter.close()
        assert isinstance(stopping.exception(), InstrumentError)


# --- refused at opening ---


def test_another_instrument_at_the_address_is_refused_by_name(stranger):
    address = stranger(TcpPort, b"*IDN?", b"HEWLETT-PACKARD,34401A,0,11-5-2\n")
    for _ in range(2):  # it was given back: not "in use"
        with pytest.raises(InstrumentError, match=r"HEWLETT-PACKARD.*Keithley 2600 series") as refused:
            open_source_meter(context(address=address, timeout_s=0.1))
        assert refused.value.address == address


def test_another_unit_of_the_series_that_comes_back_in_its_place_is_refused(hasty, monkeypatch):
    meter = hasty.open_meter()
    monkeypatch.setattr(source_meter, "_IDENTITY", "Keithley Instruments Inc., Model 2636B, 7, 3.2.2")
    meter.source(1e-4)
    hasty.arm("meter", Fault.GARBLE)
    with pytest.raises(InstrumentError):
        meter.measure()
    with pytest.raises(InstrumentError, match=r"was Model 2634B 4123456 .* now Model 2636B 7 answers"):
        meter.source(1e-4)
    assert hasty.rig.wiring.current_A is None


def test_an_instrument_that_is_switched_off_is_refused():
    with pytest.raises(InstrumentError, match="nothing listens there"):
        open_source_meter(context(address="TCPIP::127.0.0.1::1::SOCKET", timeout_s=0.1))
