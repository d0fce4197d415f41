"""Frames scanned reading by reading, over the emulated meter and multiplexer."""

import logging

import numpy as np
import pytest
from scanning_rig import OHM, Scanning, TabledWorld
from simulated_setting import larger_sensor
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.readings.frames import ReadingFlag, VoltageUnit
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa.simulate.instruments import streams
from cbsr_qa.simulate.instruments.streams import Fault
from cbsr_qa_plugins.hardware import esp32_multiplexer


def with_open_pin(pin, ohm=1e8):
    world = TabledWorld()
    for pair in ((pin - 1) % 16, pin):
        world.ohm[pair, pair] = world.drive_ohm[pair] = ohm
    return world


@pytest.mark.parametrize("inner", ["current", "voltage"])
def test_a_frame_is_in_canonical_order_whatever_the_board_s(inner):
    with Scanning(multiplexer={"inner": inner}) as bench:
        frames = bench.open_frames(current_mA=0.2)
        block = frames.acquire(2)
        assert block.voltages.shape == (2, 16, 16)
        assert block.unit is VoltageUnit.VOLT
        assert block.current_A == 0.2e-3
        assert np.allclose(block.voltages, 0.2e-3 * OHM, rtol=1e-6)
        assert not block.flags.any()
        first, second = block.reading_time_s[0, :2, :2].T.ravel()[:2], block.reading_time_s[0]
        rising = second if inner == "voltage" else second.T
        assert (np.diff(rising.ravel()) > 0).all()
        assert first[0] < first[1] or inner == "voltage"


@pytest.mark.rest
def test_frames_of_32_electrodes_come_through_a_multiplexer_of_so_many_channels(monkeypatch):
    """The shipped multiplexer refuses them; another is a plugin, here the same firmware on a larger board."""
    ohm = np.add.outer(100.0 * np.arange(1, 33), np.arange(1, 33)) + np.diag(np.full(32, 18e3))
    with Scanning(TabledWorld(ohm, kind=larger_sensor(32))) as bench:
        with pytest.raises(ConfigError, match="connects 16 electrodes; sensor type 'disc of 32' has 32"):
            bench.open_multiplexer()
        monkeypatch.setattr(esp32_multiplexer, "_CHANNELS", 32)
        block = bench.open_frames(current_mA=0.2).acquire(1)
        assert block.voltages.shape == (1, 32, 32)
        assert np.allclose(block.voltages, 0.2e-3 * ohm, rtol=1e-6)


def test_times_are_those_of_the_readings_and_the_period_is_what_a_frame_takes(bench):
    frames = bench.open_frames(current_mA=0.2)
    expected_s = frames.frame_period_s
    before_s = bench.clock.now()
    block = frames.acquire(1)
    took_s = bench.clock.now() - before_s
    assert expected_s == pytest.approx(took_s, rel=0.02)
    assert frames.frame_period_s == took_s
    own = block.reading_time_s[0]
    assert before_s < own.min() < own.max() < before_s + took_s
    assert block.time_s[0] == pytest.approx(before_s + took_s / 2, abs=0.01 * took_s)


def test_the_sheet_is_solved_once_a_frame_of_the_moment_in_its_middle(bench):
    frames = bench.open_frames(current_mA=0.2)
    bench.world.asked.clear()
    block = frames.acquire(3)
    assert len(bench.world.asked) == 3
    assert [time_s for time_s, _ in bench.world.asked] == pytest.approx(
        block.time_s, abs=0.02 * frames.frame_period_s
    )
    assert len({index for _, index in bench.world.asked}) == 3


@pytest.mark.rest
def test_the_noise_of_a_session_that_goes_on_with_a_run_is_another():
    first, later = (Scanning(TabledWorld(began_s=began_s)) for began_s in (0.0, 12.3456))
    with first, later:
        for bench in (first, later):
            bench.open_frames(current_mA=0.2).acquire(2)
        indices = [{index for _, index in bench.world.asked} for bench in (first, later)]
    assert not indices[0] & indices[1]
    assert min(indices[1]) >= 12346 << 32


@pytest.mark.parametrize(
    ("limit_V", "largest_mA", "chosen_mA"), rest_but({10}, [(10, 1, 0.3), (20, 0.5, 0.5), (20, 1, 0.6)])
)
def test_the_current_is_chosen_to_leave_a_quarter_of_the_limit(limit_V, largest_mA, chosen_mA):
    # The largest driven pair reads 19.6 kΩ; 0.8 and 0.4 mA would take more than 15 and 7.5 V.
    with Scanning(meter={"compliance_V": limit_V, "range_V": 20}) as bench:
        frames = bench.open_frames(current="auto", largest_current_mA=largest_mA)
        assert frames.acquire(1).current_A == chosen_mA * 1e-3
        assert ("current", f"{chosen_mA:g} mA") in frames.identity().notes
    with Scanning(meter={"compliance_V": 40, "range_V": 40}) as bench:
        assert bench.open_frames(headroom_percent=50).acquire(1).current_A == 1e-3


def test_a_stated_current_that_leaves_too_little_is_refused_with_what_would_do(bench):
    with pytest.raises(
        InstrumentError, match=r"0\.9 mA need 17\.7 V on pair 15-0; the source gives at most 20 V"
    ) as refused:
        bench.open_frames(current_mA=0.9)
    assert "state at most 0.6 mA" in refused.value.remedy
    assert bench.rig.wiring.current_A is None


def test_an_open_pin_is_named_before_anything_moves():
    with Scanning(with_open_pin(7)) as bench:
        with pytest.raises(
            InstrumentError, match="pin 7 open: pairs 6-7 and 7-8 read more than the source can drive"
        ):
            bench.open_frames()
        assert bench.rig.wiring.current_A is None


def test_a_station_may_measure_open_pins_all_the_same(caplog):
    with Scanning(with_open_pin(7)) as bench, caplog.at_level(logging.WARNING):
        frames = bench.open_frames(contacts="warn", current_mA=0.2)
        assert "pin 7 open" in caplog.text
        assert "pin 7 open" in dict(frames.identity().notes)["contacts"]
        flags = frames.acquire(1).flags[0]
        assert (flags[6:8] & ReadingFlag.COMPLIANCE).all()
        assert not flags[:6].any()
        assert not flags[8:].any()


def test_a_poor_contact_is_said_and_measured(caplog):
    with Scanning(with_open_pin(3, ohm=45e3)) as bench, caplog.at_level(logging.WARNING):
        bench.open_frames()
        assert "pin 3 poor: pairs 2-3 and 3-4 read 45 kΩ and 45 kΩ" in caplog.text


def test_no_sensor_at_all(bench):
    bench.world.drive_ohm[:] = 1e9
    with pytest.raises(InstrumentError, match="no driven pair takes the current within 20 V") as refused:
        bench.open_frames(contacts="warn")
    assert "is a sensor connected" in refused.value.remedy


def test_leads_the_other_way_round_are_noticed_and_can_be_told():
    with Scanning(TabledWorld(-OHM)) as bench, pytest.raises(InstrumentError, match="the other way round"):
        bench.open_frames()
    with Scanning(TabledWorld(-OHM)) as bench:
        block = bench.open_frames(polarity="reversed", current_mA=0.2).acquire(1)
        assert np.allclose(block.voltages[0], 0.2e-3 * OHM, rtol=1e-6)


def test_it_tests_itself_by_the_contacts(bench):
    frames = bench.open_frames(current_mA=0.2)
    contacts, current = frames.self_test()
    assert contacts.outcome is current.outcome is CheckOutcome.OK
    assert contacts.said == "pairs of 18.1 to 19.6 kΩ"
    assert current.value == pytest.approx(0.2)
    assert "3.92 V of the source's 20 V" in current.said
    assert bench.rig.wiring.current_A is None
    for pair, ohm, outcome in ((4, 45e3, CheckOutcome.WARNING), (9, 1e9, CheckOutcome.FAILED)):
        bench.world.drive_ohm[pair] = bench.world.ohm[pair, pair] = ohm
        contacts, _ = frames.self_test()
        assert contacts.outcome is outcome
        assert f"pair {pair}-{pair + 1} reads" in contacts.said


def lose_a_step(bench, at):
    """The board echoes one step and does not do it."""
    board = bench.emulation.instruments["multiplexer"]
    connect, steps = board._connect, []

    def connected(counter):
        steps.append(counter)
        if len(steps) != at:
            connect(counter)

    board._connect = connected


def test_a_lost_step_gives_no_frame_and_the_next_attempt_a_whole_one(bench):
    frames = bench.open_frames(current_mA=0.2)
    lose_a_step(bench, 100)
    with pytest.raises(InstrumentError, match="after 256 steps the multiplexer is 1 combinations from") as lost:
        frames.acquire(1)
    assert lost.value.retryable
    assert np.allclose(frames.acquire(1).voltages[0], 0.2e-3 * OHM, rtol=1e-6)


def within_three_attempts(frames):
    """Take a frame as the runner does, which tries again twice."""
    for _ in range(2):
        try:
            return frames.acquire(1)
        except InstrumentError as error:
            if not error.retryable:
                raise
    return frames.acquire(1)


@pytest.mark.rest
@pytest.mark.parametrize("role", ["meter", "multiplexer"])
def test_a_fault_anywhere_in_a_frame_gives_the_right_frame_or_none(hasty, role, monkeypatch):
    monkeypatch.setattr(streams, "LATE_S", 0.45)
    frames = hasty.open_frames(current_mA=0.2)
    instrument = hasty.meter if role == "meter" else hasty.multiplexer
    name = "measure" if role == "meter" else "step"
    operation, left = getattr(instrument, name), [0, Fault.DROP]

    def counted():
        left[0] -= 1
        if left[0] == 0:
            hasty.arm(role, left[1])
        return operation()

    monkeypatch.setattr(instrument, name, counted)
    for fault in (Fault.GARBLE, Fault.STALE, Fault.DELAY, Fault.RESET):
        for at in (1, 130, 256):
            left[:] = at, fault
            block = within_three_attempts(frames)
            assert left[0] <= 0
            assert np.allclose(block.voltages[0], 0.2e-3 * OHM, rtol=1e-6), (fault, at)
            assert not block.flags.any()


def test_compliance_that_comes_in_a_run_is_flagged_in_every_reading_from_then_on(bench):
    frames = bench.open_frames(current_mA=0.2)
    bench.arm("meter", Fault.COMPLIANCE)
    assert (frames.acquire(1).flags & ReadingFlag.COMPLIANCE).all()


def test_a_frame_after_the_safe_state_switches_the_source_on_again(bench):
    frames = bench.open_frames(current_mA=0.2)
    frames.acquire(1)
    bench.meter.safe_state()
    assert bench.rig.wiring.current_A is None
    assert np.allclose(frames.acquire(1).voltages[0], 0.2e-3 * OHM, rtol=1e-6)


@pytest.mark.parametrize("lacks", ["source_meter", "multiplexer"])
def test_a_bench_without_meter_or_multiplexer_is_refused(bench, lacks):
    frames = bench.open_frames()
    peers = {"source_meter": bench.meter, "multiplexer": bench.multiplexer}
    with pytest.raises(ConfigError, match=f"provides '{lacks}'") as refused:
        frames.link({role: one for role, one in peers.items() if role != lacks})
    assert f'provides = ["{lacks}"]' in refused.value.remedy


def test_less_than_one_frame_is_refused(bench):
    with pytest.raises(InstrumentError, match="0 frames were asked for"):
        bench.open_frames().acquire(0)
