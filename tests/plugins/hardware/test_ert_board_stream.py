"""The ERT board's driver against an emulated board on a pseudo terminal."""

import os
import pty
import tty
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from simulated_setting import HEAD, MOTION, held, larger_sensor, material, scene, sensor_type, world
from tiers import rest_but

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.plan.plan import EMULATED, InstrumentSpec
from cbsr_qa.domain.readings.frames import ReadingFlag, VoltageUnit
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.simulate.instruments.rig import EmulatedRig, Emulation
from cbsr_qa.simulate.instruments.streams import Fault, WatchedClock
from cbsr_qa.system.clock import RealClock, VirtualClock
from cbsr_qa_plugins.hardware._board_stream import stream_order
from cbsr_qa_plugins.hardware.ert_board_stream import open_board

PERIOD_S = 0.25
USABLE = sensor_type().pattern.usable()
ASCII = {"format": "ascii", "baud": 230_400}
TABLE = {"address": EMULATED, "frame_period_s": PERIOD_S, "zero_counts": 32_768}


def told(options, clock, of=None):
    return StationContext("frames", clock, of or sensor_type(), material(), HEAD, 1, options, motion=MOTION)


class Bench:
    """An emulated board over a sheet without noise, and the driver that reads it."""

    def __init__(self, *effects, board=None, kind=None, began_s=0.0, **options):
        table, board = TABLE | options, dict(board or {})
        self.clock = WatchedClock()
        memory = {"share": board.pop("memory", 0.0), "inner": table.get("order", "measure")}
        effects = (*effects, "reading-memory") if memory["share"] else effects
        self.world = world(replace(scene(*effects, reading_memory=memory), frame_period_s=PERIOD_S), kind=kind)
        self.world.setting = replace(self.world.setting, began_s=began_s)
        spec = InstrumentSpec("frames", "ert-board-stream", ("frame_source",), table | board, None)
        self.emulation = Emulation([spec], EmulatedRig(self.clock, self.world, MOTION))
        options = table | {"address": self.emulation.ports["frames"].address}
        try:
            self.driver = open_board(told(options, self.clock, kind))
        except BaseException:
            self.emulation.close()
            raise

    def arm(self, fault):
        self.emulation.arm("frames", fault)

    def counts(self, block):
        """What the board must have sent for each frame of a block, of a sheet that stands still."""
        emulated = self.emulation.instruments["frames"]
        return np.rint(emulated._scale * self.world.frame(float(block.time_s[0]), 0).voltages)

    def check(self, block):
        """Hold the frames of a block, of a sheet that stands still, against what the board must have sent."""
        usable = self.world.setting.sensor_type.pattern.usable()
        for frame in block.voltages:
            np.testing.assert_array_equal(frame[usable], self.counts(block)[usable])


@pytest.fixture
def opened():
    benches = []

    def make(*effects, **options):
        benches.append(Bench(*effects, **options))
        return benches[-1]

    yield make
    for bench in benches:
        bench.driver.close()
        bench.emulation.close()


@pytest.mark.parametrize(
    "options",
    [
        {},
        pytest.param(ASCII, marks=pytest.mark.rest),
        ASCII | {"signed": True, "zero_counts": 0},
        pytest.param({"order": "drive"}, marks=pytest.mark.rest),
        pytest.param({"order": "measure", "first_reading": 1}, marks=pytest.mark.rest),
        ASCII | {"order": "drive", "first_reading": 17},
    ],
    ids=lambda options: ", ".join(f"{key}={value}" for key, value in options.items()) or "binary",
)
def test_frames_arrive_as_the_sheet_is_in_canonical_order(opened, options):
    bench = opened(**options)
    block = bench.driver.acquire(3)
    assert (block.unit, block.current_A, block.voltages.shape) == (VoltageUnit.COUNT, None, (3, 16, 16))
    bench.check(block)
    assert not block.flags[:, USABLE].any()
    assert bench.driver.frames_lost == 0


def test_frames_are_consecutive_on_the_stations_clock(opened):
    bench = opened()
    start_s = bench.clock.now()
    times_s = np.concatenate([bench.driver.acquire(count).time_s for count in (1, 1, 3, 1)])
    row_s = PERIOD_S / 16
    np.testing.assert_allclose(np.diff(times_s), PERIOD_S, atol=1.1 * row_s)
    assert bench.clock.now() - start_s < 7.2 * PERIOD_S
    assert bench.driver.frames_lost == 0


def test_no_frame_begins_before_it_was_asked_for(opened):
    bench = opened()
    bench.driver.acquire(1)
    for pause_s in (0.06, 0.2, 0.9, 60.0, 61.03):
        bench.clock.sleep(pause_s)
        asked_s = bench.clock.now()
        block = bench.driver.acquire(1)
        assert block.time_s[0] - PERIOD_S / 2 >= asked_s - 1.1 * PERIOD_S / 16
        assert bench.clock.now() - asked_s <= 2.2 * PERIOD_S
    assert bench.driver.frames_lost == 0


def test_a_press_is_in_the_frames_after_it_and_in_none_before(opened):
    bench = opened("piezoresistivity")
    before = bench.driver.acquire(2).voltages[-1]
    bench.world.presses.append(held(0, 10.0, 5.0, 0.2, start_s=bench.clock.now()))
    bench.clock.sleep(2.0)
    after = bench.driver.acquire(1)
    change = after.voltages[0] - before
    assert np.abs(change).max() > 20
    bench.check(after)


def test_noise_repeats_with_the_seed_and_not_in_a_session_that_goes_on(opened):
    first, again, later = (
        opened("measurement-noise", began_s=began_s).driver.acquire(2).voltages for began_s in (0.0, 0.0, 100.0)
    )
    np.testing.assert_array_equal(first, again)
    assert (first[0] != first[1]).any()
    assert not any((before == after).all() for before in first for after in later)


def test_counts_at_the_ends_of_the_range_are_flagged(opened):
    bench = opened(zero_counts=0)
    block = bench.driver.acquire(1)
    cut = bench.counts(block) <= 0
    assert cut.any()
    assert (block.voltages[0][cut] == 0).all()
    np.testing.assert_array_equal((block.flags[0] & ReadingFlag.SATURATED) > 0, cut | (block.voltages[0] >= 65_535))


@pytest.mark.parametrize("options", [{}, ASCII], ids=["binary", "ascii"])
def test_ends_of_the_range_may_lie_elsewhere(opened, options):
    """One board of the lab's recordings clips at 4600."""
    bench = opened(range_counts=[32_000, 33_000], **options)
    block = bench.driver.acquire(1)
    sent = block.voltages[0] + 32_768
    np.testing.assert_array_equal(block.flags[0] > 0, (sent <= 32_000) | (sent >= 33_000))


def test_each_reading_has_its_time_in_the_order_of_the_scan(opened):
    bench = opened(order="drive")
    block = bench.driver.acquire(1)
    own_s = block.reading_time_s[0]
    assert own_s.T.ravel().argsort().tolist() == list(range(256))
    assert own_s.mean() == pytest.approx(block.time_s[0])
    assert np.ptp(own_s) == pytest.approx(PERIOD_S * 255 / 256)


@pytest.mark.parametrize("order", rest_but({"drive"}, ["measure", "drive"]))
def test_the_memory_of_the_readings_can_be_taken_out(opened, order):
    share = 0.12
    plain, remembered, corrected = (
        opened(order=order, board=memory, **own).driver.acquire(2).select(slice(1, 2))
        for memory, own in (({}, {}), ({"memory": share}, {}), ({"memory": share}, {"memory_share": share}))
    )
    assert (
        np.abs(remembered.voltages - plain.voltages)[0, USABLE].max() > 0.05 * np.abs(plain.voltages[0, USABLE]).max()
    )
    # What follows a driven pair that was cut keeps a share of nobody knows what; whole counts are rounded.
    order = stream_order(16, order, 0)
    follows_cut = np.zeros(256, dtype=bool)
    follows_cut[order[1:]] = corrected.flags[0].ravel()[order[:-1]] > 0
    known = USABLE & ~follows_cut.reshape(16, 16) & (corrected.flags[0] == 0)
    assert 170 <= known.sum() < USABLE.sum()
    assert np.abs(corrected.voltages - plain.voltages)[0, known].max() < 2.0


@pytest.mark.parametrize("options", [{}, ASCII], ids=["binary", "ascii"])
def test_a_garbled_frame_is_left_out_and_the_loss_is_noticed(opened, options, caplog):
    bench = opened(**options)
    bench.driver.acquire(1)
    bench.arm(Fault.STALE)  # a row comes twice
    block = bench.driver.acquire(3)
    bench.check(block)
    assert bench.driver.frames_lost == 1
    assert "1 frames were lost" in caplog.text


@pytest.mark.parametrize("fault", [Fault.STALE, Fault.GARBLE, Fault.RESET])
def test_a_fault_in_any_row_gives_the_right_frame_or_none(opened, fault):
    bench = opened()
    expected = bench.counts(bench.driver.acquire(1))[USABLE]
    for row in (0, 7, 15) if fault is Fault.RESET else range(16):
        bench.clock.sleep(row * PERIOD_S / 16 + 0.06)
        bench.arm(fault)
        start_s = bench.clock.now()
        block = bench.driver.acquire(2)
        np.testing.assert_array_equal(block.voltages[:, USABLE], [expected, expected])
        assert block.time_s[0] - PERIOD_S / 2 >= start_s - 1.1 * PERIOD_S / 16
    assert not bench.emulation.ports["frames"].faults.take()


def test_a_silent_board_is_an_error_that_may_be_tried_again(opened):
    bench = opened()
    bench.arm(Fault.SILENCE)
    with pytest.raises(InstrumentError, match=r"frames at /dev/pts/\d+: sent nothing for") as raised:
        bench.driver.acquire(1)
    assert raised.value.retryable
    assert "has power" in raised.value.remedy


def test_a_pulled_cable_is_an_error_and_the_next_call_opens_the_port_again(opened):
    bench = opened()
    bench.arm(Fault.DROP)
    with pytest.raises(InstrumentError, match="frames at") as raised:
        bench.driver.acquire(1)
    assert raised.value.retryable
    other = opened()
    other.driver.close()
    bench.driver._address = bench.driver._link.address = other.emulation.ports["frames"].address
    bench.driver._clock = other.clock
    assert len(bench.driver.acquire(1)) == 1


def test_the_board_is_alive_as_long_as_it_sends(opened):
    bench = opened()
    bench.driver.acquire(1)
    bench.clock.sleep(60.0)
    start_s = bench.clock.now()
    bench.driver.alive()
    assert bench.clock.now() - start_s < 0.2 * PERIOD_S
    assert len(bench.driver.acquire(1)) == 1
    bench.arm(Fault.SILENCE)
    with pytest.raises(InstrumentError, match="sent nothing for"):
        bench.driver.alive()


def test_a_board_of_another_period_is_refused_at_opening(opened):
    with pytest.raises(InstrumentError, match=r"a frame came after 0\.\d+ s; frame_period_s is 0\.25"):
        opened(board={"frame_period_s": 0.5})


@pytest.mark.parametrize(
    ("options", "board", "expected"),
    [
        ({}, {"format": "ascii"}, "frames of 770 bytes"),
        (ASCII, {"format": "binary"}, "A and 16 lines of 16 counts"),
    ],
)
def test_a_board_that_sends_another_format_is_refused_at_opening(opened, options, board, expected):
    with pytest.raises(InstrumentError, match=rf"sent \d+ bytes, but no whole frame.*{expected} every 0\.25 s"):
        opened(board=board, **options)


def test_a_port_without_a_board_is_refused():
    with pytest.raises(InstrumentError, match="frames at /dev/none: there is no port"):
        open_board(told(TABLE | {"address": "/dev/none"}, RealClock()))


@pytest.mark.rest
@pytest.mark.parametrize("options", [{}, ASCII | {"order": "drive"}], ids=["binary", "ascii"])
def test_a_board_of_32_pairs_sends_what_the_sensor_type_has(opened, options):
    bench = opened(kind=larger_sensor(32), **options)
    block = bench.driver.acquire(3)
    assert block.voltages.shape == (3, 32, 32)
    bench.check(block)
    assert (np.diff(np.sort(block.reading_time_s[0].ravel())) > 0).all()


def test_a_board_of_other_pairs_than_the_sensor_type_is_refused_at_opening():
    bench = Bench()
    bench.driver.close()
    with pytest.raises(InstrumentError, match=r"no whole frame, .* frames of 3074 bytes every 0\.25 s"):
        open_board(told(TABLE | {"address": bench.emulation.ports["frames"].address}, bench.clock, larger_sensor(32)))
    bench.emulation.close()


def test_a_line_too_slow_for_32_pairs_is_refused():
    with pytest.raises(ConfigError, match=r"frame_period_s is 0\.01, but 3074 bytes at 1400000 baud take 0\.022 s"):
        open_board(told(TABLE | {"address": "/dev/none", "frame_period_s": 0.01}, RealClock(), larger_sensor(32)))


def test_a_sensor_of_other_readings_is_refused():
    of = replace(sensor_type(), pattern=replace(sensor_type().pattern, drive=sensor_type().pattern.drive[:8]))
    with pytest.raises(ConfigError, match="sends 16 x 16 or 32 x 32 readings; sensor type 'disc-100mm' has 8 x 16"):
        open_board(told(TABLE | {"address": "/dev/none"}, RealClock(), of))


class Feeding(VirtualClock):
    """A clock on which a board sends a row at every look."""

    def __init__(self, line, frame):
        super().__init__()
        self.line, self.frame, self.row = line, frame, 0

    def sleep(self, duration_s):
        super().sleep(duration_s)
        first = 48 * (self.row % 16)
        os.write(self.line, self.frame[first : first + 48] + (b"A\r" if first == 720 else b""))
        self.row += 1


def test_a_backlog_of_minutes_is_thrown_away():
    """The computer holds tens of kilobytes that nobody read: old frames must not be taken for new ones."""
    line, slave = pty.openpty()
    tty.setraw(slave)
    os.set_blocking(line, False)
    old, new = (bytes([value, 0, 13] * 256) + b"A\r" for value in (1, 2))
    clock = Feeding(line, new)
    driver = open_board(told(TABLE | {"address": os.ttyname(slave), "zero_counts": 0}, clock))
    written = 0
    with suppress(BlockingIOError):
        while written < 60_000:
            written += os.write(line, old)
    assert written > 8192
    clock.sleep(1.0)
    clock.row = 0
    assert (driver.acquire(1).voltages == 2).all()
    driver.close()
    os.close(line)
    os.close(slave)
