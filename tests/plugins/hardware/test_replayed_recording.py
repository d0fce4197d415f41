"""A recording played back as a bench."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from simulated_setting import HEAD, MOTION, base_scene, context, material, sensor_type
from station_files import station_file

from cbsr_qa.domain.errors import ConfigError, InstrumentError, RecordingError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Home, MarkUnloaded, Press, Release
from cbsr_qa.domain.readings.frames import (
    FrameBlock,
    Recording,
    SampleBlock,
    ScanKind,
    VoltageUnit,
    join_frames,
    join_samples,
)
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import FramesTaken, LoadFinished, SamplesTaken
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.plugin.instruments import StationContext
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.execution import execute
from cbsr_qa.station.setup import configure, open_station, station_clock
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import example_identity, example_plan
from cbsr_qa_plugins.hardware.replayed_recording import open_replay
from cbsr_qa_plugins.hardware.simulated_bench import open_bench

PERIOD_S = 0.5
STEPS = (
    Home(),
    AcquireFrames(4),
    MarkUnloaded(),
    FindSurface(0.0, 0.0),
    Press(Load("press", 10.0, 5.0, 0.2, 1)),
    Hold(12.0, acquire=True),
    Release(),
    Hold(20.0, acquire=True),
)


def recording(count=10, *, shape=(16, 16), samples=True, **more):
    """Frames of their own number; the force counts tenths of a second, from 2 s before the first frame."""
    values = np.arange(count, dtype=float)[:, None, None] * np.ones(shape)
    frames = FrameBlock(
        PERIOD_S * np.arange(count), values, np.zeros(values.shape, np.uint8), VoltageUnit.COUNT, None
    )
    times_s = np.arange(-20, 10 * count) / 10
    force = (SampleBlock("force", "N", times_s, 10 * times_s),) if samples else ()
    made = Recording(
        Path("taken.csv"), "ert-board-csv", "", ScanKind.FULL, frames, None, False, False, "board", samples=force
    )
    return replace(made, **more)


def told(of, clock, **options):
    read = of if callable(of) else lambda path, format_, dataset: of
    table = {"file": "taken.csv"} | options
    return StationContext(
        "bench", clock, sensor_type(), material(), HEAD, 1, table, motion=MOTION, read_recording=read
    )


def replay(of=None, **options):
    clock = VirtualClock()
    return clock, open_replay(told(of or recording(), clock, **options))


def test_it_says_that_it_is_a_replay():
    _, one = replay(recording(simulated=("scene base",)))
    said = one.identity()
    assert said.simulated
    assert said.model == "replay of taken.csv (ert-board-csv); itself of scene base"


def test_frames_come_in_order_each_at_its_end():
    clock, one = replay()
    first = one.acquire(1)
    assert (first.voltages == 0).all()
    # It begins with its first force sample, 2 s before the first frame's middle.
    assert first.time_s[0] == pytest.approx(2.0)
    assert clock.now() == pytest.approx(2.0 + PERIOD_S / 2)
    block = one.acquire(3)
    assert block.voltages[:, 0, 0].tolist() == [1, 2, 3]
    assert clock.now() == pytest.approx(2.0 + 3.5 * PERIOD_S)


def test_without_a_station_it_begins_with_its_first_frame():
    clock = VirtualClock()
    one = open_replay(replace(told(recording(), clock), motion=None))
    assert one.acquire(1).time_s[0] == pytest.approx(PERIOD_S / 2)


def test_what_nobody_asked_for_is_passed_over():
    clock, one = replay(start_s=-PERIOD_S / 2)
    clock.sleep(3.1 * PERIOD_S)  # a tenth into the fourth frame: it counts
    assert one.acquire(1).voltages[0, 0, 0] == 3
    clock.sleep(0.6 * PERIOD_S)  # beyond the middle of the fifth
    assert one.acquire(1).voltages[0, 0, 0] == 5


def test_samples_come_at_their_times_and_none_twice():
    clock, one = replay()
    clock.sleep(1.05)
    early = one.samples_since(0.0)
    np.testing.assert_allclose(early.values, 10 * (early.time_s - 2.0))
    assert early.time_s[-1] == pytest.approx(1.0)
    clock.sleep(1.0)
    assert one.samples_since(early.time_s[-1]).time_s[0] == pytest.approx(1.1)


def test_the_end_of_the_recording_is_said_and_not_tried_again():
    _, one = replay()
    one.acquire(9)
    with pytest.raises(
        InstrumentError, match=r"the recording is over: at 4.25 s of it 1 of 10 frames are left, 2 asked for"
    ) as raised:
        one.acquire(2)
    assert not raised.value.retryable
    assert len(one.acquire(1)) == 1
    with pytest.raises(InstrumentError, match=r"bench at taken\.csv: the recording is over: .* 0 of 10"):
        one.acquire(1)


def test_a_session_that_resumes_goes_on_where_the_run_was():
    clock = VirtualClock()
    one = open_replay(replace(told(recording(), clock, start_s=-PERIOD_S / 2), resumed_at_s=4 * PERIOD_S))
    assert one.acquire(1).voltages[0, 0, 0] == 4


def test_the_head_takes_the_time_of_the_stations_motion():
    clock, one = replay()
    one.press(0.8, MOTION.press_speed_mm_s)
    down_s = clock.now()
    assert down_s == pytest.approx(24.8 / 10 + 1.0 / MOTION.press_speed_mm_s, abs=1e-5)
    one.press(0.4, MOTION.press_speed_mm_s)
    assert clock.now() - down_s == pytest.approx(0.4 / MOTION.press_speed_mm_s, abs=1e-5)
    one.release()
    one.release()
    up_s = clock.now()
    one.move_to(30.0, 40.0)
    assert clock.now() - up_s == pytest.approx(5.0, abs=1e-5)
    assert one.find_surface(30.0, 40.0) == MOTION.hover_mm


def documents_of(instrument, clock):
    taken = []
    spec = InstrumentSpec("bench", "any", ("frame_source", "force_applicator", "force"), {}, None)
    ended = execute(
        example_plan(STEPS), example_identity(), Bench([Mounted(spec, instrument)]), clock, [taken.append]
    )
    assert ended.end is EndReason.FINISHED, ended.detail
    frames = join_frames([event.frames for event in taken if isinstance(event, FramesTaken)])
    samples = join_samples([event.samples for event in taken if isinstance(event, SamplesTaken)])
    return frames, samples, [event.record for event in taken if isinstance(event, LoadFinished)]


def test_a_run_played_back_to_its_own_recipe_is_the_run():
    clock = VirtualClock()
    frames, samples, loads = documents_of(open_bench(context(base_scene(), clock=clock)), clock)
    assert len(loads) == 1
    kept = replace(recording(), frames=frames, samples=(samples,))
    clock = VirtualClock()
    again = documents_of(open_replay(told(kept, clock, start_s=0.0)), clock)
    np.testing.assert_array_equal(again[0].voltages, frames.voltages)
    np.testing.assert_allclose(again[0].time_s, frames.time_s, atol=1e-3)
    np.testing.assert_array_equal(again[1].values, samples.values)
    assert [load.load for load in again[2]] == [load.load for load in loads]


@pytest.mark.parametrize(
    ("of", "options", "match"),
    [
        (recording(shape=(16, 13)), {}, "frames of taken.csv have 16 x 13 readings; sensor type 'disc-100mm' has 16"),
        (recording(shape=(1, 16), scan=ScanKind.DRIVEN_PAIRS), {}, "1 x 16 readings"),
        (recording(still=True), {}, "whose times say nothing"),
        (recording(1), {}, "holds 1 frames"),
    ],
)
def test_what_cannot_be_played_is_refused_by_name(of, options, match):
    with pytest.raises(ConfigError, match=match) as raised:
        replay(of, **options)
    assert "instrument 'bench' (replayed-recording)" in raised.value.reason


def test_a_file_that_cannot_be_read_is_refused_with_its_role():
    def broken(path, format_, dataset):
        raise RecordingError(f"{path} {format_} {dataset}", remedy="look for it")

    with pytest.raises(ConfigError, match=r"instrument 'bench' .*: taken.csv None a") as raised:
        replay(broken, dataset="a")
    assert raised.value.remedy == "look for it"
    with pytest.raises(ConfigError, match="given no way to read"):
        open_replay(replace(told(recording(), VirtualClock()), read_recording=None))


def test_a_station_of_a_recording_without_force_is_refused(tmp_path):
    _, one = replay(recording(samples=False))
    spec = InstrumentSpec("bench", "replayed-recording", ("frame_source", "force_applicator", "force"), {}, None)
    with pytest.raises(ConfigError, match=r"taken\.csv holds no channel 'force'"):
        Bench([Mounted(spec, one)])


INSTRUMENTS = """
[instruments.bench]
driver = "replayed-recording"
provides = ["frame_source", "force_applicator", "force"]
file = '{file}'
"""


def test_a_station_file_names_the_recording(tmp_path):
    from cbsr_qa.analysis.recording_files import write_recording

    write_recording(tmp_path / "kept.h5", recording(clock="station"))
    station = tmp_path / "replay.toml"
    station.write_text(station_file("replay", INSTRUMENTS.format(file=tmp_path / "kept.h5")))
    configuration = configure(str(station), "nine-locations", sensor_type=None, material=None, seed=1)
    bench = open_station(configuration, discover(), station_clock(configuration))
    (identity,) = bench.identities()
    assert identity.simulated
    assert "replay of kept.h5 (cbsr-recording)" in identity.model
    assert len(bench.frame_source.acquire(2)) == 2
    bench.close()
