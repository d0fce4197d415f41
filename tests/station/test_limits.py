"""What the station allows, each limit by its name: in the dry run before anything moves, and while a run goes on."""

from dataclasses import replace

import numpy as np
import pytest

from cbsr_qa.config.loader import load_sensor_type
from cbsr_qa.domain.errors import ConfigError, InstrumentError, RefusedError, SafetyError
from cbsr_qa.domain.plan.plan import InstrumentSpec
from cbsr_qa.domain.plan.steps import AcquireFrames, FindSurface, Hold, Press, Release, StrainStep
from cbsr_qa.domain.readings.frames import FrameBlock, ReadingFlag, SampleBlock, VoltageUnit
from cbsr_qa.domain.readings.loads import Load
from cbsr_qa.domain.run.events import FramesTaken, SamplesTaken, StepRetried
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.station.bench import Bench, Mounted
from cbsr_qa.station.dry_runs import dry_run
from cbsr_qa.station.execution import execute
from cbsr_qa.station.limits import TEMPERATURE_STALE_S, Limits
from cbsr_qa.system.clock import VirtualClock
from cbsr_qa.testing.bench import (
    Script,
    ScriptedInstrument,
    example_identity,
    example_plan,
    make_scripted_bench,
    raising,
)

SAFE = [f"{role}.safe_state" for role in ("force_applicator", "frame_source", "load_cell")]


def load(strain=0.2, x_mm=0.0):
    return Load("L0", x_mm, 0.0, strain, 0)


def pressed(hold_s, *, acquire=False):
    return (Press(load()), Hold(hold_s, acquire=acquire), Release())


def allowing(steps, **limits):
    plan = example_plan(steps)
    return replace(plan, safety=replace(plan.safety, **limits))


def run(plan, *, script=None, bench=None):
    script = script or Script(VirtualClock())
    bench = bench or make_scripted_bench(script, plan.sensor_type)
    told = []
    ended = execute(plan, example_identity(), bench, script.clock, [told.append])
    return ended, told, script


# --- refused before anything moves -----------------------------------------------------------------------

TOO_MUCH = {
    "force": (pressed(10), {"force_N": 2.0}, "N expected; the station allows 2 N"),
    "force of an ease": (
        (Press(load(0.1)), StrainStep(0.3), Release()),
        {"force_N": 5.0},
        "N expected; the station allows 5 N",
    ),
    "strain": (pressed(10), {"strain": 0.15}, "20 % strain; the station allows up to 15 %"),
    "strain of an ease": (
        (Press(load(0.1)), StrainStep(0.3), Release()),
        {"strain": 0.25},
        "30 % strain; the station allows up to 25 %",
    ),
    "travel": ((Press(load(x_mm=30.0)), Release()), {"travel_radius_mm": 25.0}, "30 mm from the centre"),
    "travel to feel": ((FindSurface(30.0, 0.0), *pressed(1)), {"travel_radius_mm": 25.0}, "30 mm from the centre"),
    "dwell": (pressed(61), {"dwell_s": 60.0}, "the head is down for 61 s; the station allows 60 s"),
    "duration": (pressed(1000), {"duration_s": 900.0}, "the run takes 17 min; the station allows 15 min"),
}


@pytest.mark.parametrize("what", TOO_MUCH)
def test_a_recipe_beyond_a_limit_is_refused_before_anything_is_told_or_moved(what):
    steps, limits, said = TOO_MUCH[what]
    plan, script, told = allowing(steps, **limits), Script(VirtualClock()), []
    bench = make_scripted_bench(script, plan.sensor_type)
    with pytest.raises(RefusedError) as refused:
        execute(plan, example_identity(), bench, script.clock, [told.append])
    assert said in refused.value.reason
    assert (script.calls, told) == ([], [])
    assert dry_run(example_plan(steps), 2.5).violations == ()  # as the shipped station has it, nothing is wrong


def test_the_dry_run_counts_all_that_is_done_with_the_head_down():
    steps = (
        Press(load(0.1)),
        Hold(20, acquire=False),
        StrainStep(0.2),
        Hold(10.3, acquire=True),
        AcquireFrames(4),
        Release(),
    )
    ease_s = 0.4 / (40 / 60)
    dwell_s = 20 + ease_s + 12.5 + 10  # 10.3 s take five frames of 2.5 s
    assert dry_run(allowing(steps, dwell_s=dwell_s), 2.5).violations == ()
    (said,) = dry_run(allowing(steps, dwell_s=dwell_s - 0.01), 2.5).violations
    assert "taking 4 frames" in said


def test_a_press_that_is_held_too_long_is_said_once_and_the_next_one_counted():
    long = (Press(load()), Hold(70, acquire=False), Hold(70, acquire=False), Release(), Hold(500, acquire=False))
    (said,) = dry_run(allowing((*long, *pressed(50), *long), dwell_s=60.0), 2.5).violations
    assert said.endswith("(also at 1 later step)")


# --- dwell -----------------------------------------------------------------------------------------------


def test_a_head_that_is_down_for_too_long_is_lifted():
    """Frames take twice as long as the source has said, so that only the run itself can know."""
    script = Script(VirtualClock(), {"frame_source.acquire": 30.0})
    ended, _, script = run(allowing((Press(load()), AcquireFrames(10), Release()), dwell_s=60.0), script=script)
    assert ended.end is EndReason.BROKEN
    assert "rule 'dwell': the head is down for 65 s; the station allows 60 s, while taking 10 frames" in ended.detail
    assert script.count("frame_source.acquire") == 2
    assert script.names()[-3:] == SAFE


def test_a_dwell_as_long_as_the_station_allows_is_none_too_long():
    ended, _, _ = run(allowing((*pressed(60), Hold(300, acquire=False), *pressed(60)), dwell_s=60.0))
    assert ended.end is EndReason.FINISHED


# --- compliance ------------------------------------------------------------------------------------------


class Flagged:
    """A frame source whose frames are flagged from one on."""

    def __init__(self, inner, flags, first):
        self.inner, self.flags, self.left = inner, flags, first

    def __getattr__(self, name):
        return getattr(self.inner, name)

    def acquire(self, count):
        block = self.inner.acquire(count)
        self.left -= 1
        return block if self.left > 0 else replace(block, flags=np.broadcast_to(self.flags, block.flags.shape))


def flags_of_an_open_lead(electrode, *, flag=ReadingFlag.COMPLIANCE):
    flags = np.zeros((16, 16), np.uint8)
    flags[[electrode - 1, electrode]] = flag.value
    return flags


def run_flagged(flags, *, first=3, **limits):
    plan, script = allowing(pressed(60, acquire=True), **limits), Script(VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)
    bench.frame_source = Flagged(bench.frame_source, flags, first)
    return run(plan, script=script, bench=bench)


@pytest.mark.parametrize("flag", [ReadingFlag.COMPLIANCE, ReadingFlag.SATURATED])
def test_an_open_lead_stops_the_run_with_its_frame_stored(flag):
    ended, told, script = run_flagged(flags_of_an_open_lead(7, flag=flag))
    assert ended.end is EndReason.BROKEN
    assert "rule 'compliance': electrode 7 may be open: 26 of 208 readings of a frame" in ended.detail
    assert "(12.5 %)" in ended.detail
    assert ended.detail.endswith("; check leads and contacts of these electrodes, and the drive current")
    assert "driven through electrodes 6–7, 7–8; the station stops at 5 %" in ended.detail
    frames = [d.frames for d in told if isinstance(d, FramesTaken)]
    assert [int((block.flags > 0).sum()) for block in frames] == [0, 0, 32]
    assert script.names()[-3:] == SAFE


@pytest.mark.parametrize(
    ("flags", "limits"),
    [
        (np.eye(16, dtype=np.uint8), {}),  # the driven pairs themselves, which are not imaged
        (flags_of_an_open_lead(7), {"compliance": 0.13}),
        (flags_of_an_open_lead(7, flag=ReadingFlag.MISSING), {}),  # not a matter of safety
    ],
)
def test_what_is_allowed_goes_on(flags, limits):
    ended, told, _ = run_flagged(flags, **limits)
    assert ended.end is EndReason.FINISHED
    assert sum(isinstance(d, FramesTaken) for d in told) == 24


def test_the_share_is_of_readings_that_touch_no_driven_electrode_and_of_the_worst_frame():
    limits = Limits(allowing((), compliance=11 / 208), 0.0)
    usable = np.argwhere(example_plan(()).sensor_type.pattern.usable())
    flags = np.zeros((3, 16, 16), np.uint8)

    def check():
        frames = FrameBlock(np.arange(3.0), np.ones(flags.shape), flags, VoltageUnit.VOLT, 1e-3)
        limits.check_frame(frames, "the meter")

    flags[1][tuple(usable[:10].T)] = ReadingFlag.SATURATED
    check()
    flags[2][tuple(usable[:11].T)] = ReadingFlag.SATURATED | ReadingFlag.MISSING
    with pytest.raises(SafetyError, match="11 of 208 readings of a frame of the meter") as broken:
        check()
    assert broken.value.rule == "compliance"


def test_on_a_strip_with_two_pins_the_driven_ones_count():
    """Every reading touches a driven electrode there."""
    plan = replace(allowing(()), sensor_type=load_sensor_type("strip-40x20mm").value)
    flags = np.full((1, *plan.sensor_type.pattern.shape), ReadingFlag.COMPLIANCE.value, np.uint8)
    frames = FrameBlock(np.zeros(1), np.ones(flags.shape), flags, VoltageUnit.VOLT, 1e-3)
    with pytest.raises(SafetyError, match=r"1 of 1 readings .* all of those driven through electrodes 0–1;"):
        Limits(plan, 0.0).check_frame(frames, "the meter")


# --- temperature -----------------------------------------------------------------------------------------


class Thermometer(ScriptedInstrument):
    """A sample a minute of what it is told, as long as it has a battery."""

    channel, unit = "temperature", "°C"

    def __init__(self, script, temperature_C=lambda t: 22.0):
        super().__init__("thermometer", script)
        self._temperature_C = temperature_C

    def samples_since(self, time_s):
        times = np.arange(60.0, self.script.clock.now() + 1e-9, 60.0)
        told = [(t, self._temperature_C(t)) for t in times if t > time_s]
        times_s, values = np.array([pair for pair in told if pair[1] is not None], np.float64).reshape(-1, 2).T
        return SampleBlock(self.channel, self.unit, times_s, values)


def with_thermometer(thermometer, plan, script):
    mounted = make_scripted_bench(script, plan.sensor_type).mounted
    return Bench([*mounted, Mounted(InstrumentSpec("room", "scripted", ("temperature",), {}, None), thermometer)])


REST = (Hold(1200, acquire=False), *pressed(10))


def run_at(temperature_C, **limits):
    plan, script = allowing(REST, temperature_C=(18.0, 26.0), **limits), Script(VirtualClock())
    return run(plan, script=script, bench=with_thermometer(Thermometer(script, temperature_C), plan, script))


@pytest.mark.parametrize("wrong_C", [26.5, 17.9, float("nan")])
def test_a_temperature_out_of_range_stops_the_run_with_the_evidence_stored(wrong_C):
    ended, told, script = run_at(lambda t: 22.0 if t < 500 else wrong_C)
    assert ended.end is EndReason.BROKEN
    assert f"rule 'temperature': {wrong_C:.4g} °C measured by room (scripted)" in ended.detail
    assert "the station allows 18 to 26 °C" in ended.detail
    stored = [d.samples.values[-1] for d in told if isinstance(d, SamplesTaken) and d.samples.unit == "°C"]
    np.testing.assert_equal(stored[-1], wrong_C)
    assert ended.time_s < 540 + 5 + 0.1
    assert script.names()[-4:] == [*SAFE, "thermometer.safe_state"]


def test_a_thermometer_that_falls_silent_stops_the_run():
    ended, _, _ = run_at(lambda t: 22.0 if t <= 300 else None)
    assert "rule 'stale temperature': the last temperature sample is" in ended.detail
    assert 300 + TEMPERATURE_STALE_S < ended.time_s <= 300 + TEMPERATURE_STALE_S + 5


def test_a_temperature_within_its_range_goes_on_and_without_a_range_any_does():
    assert run_at(lambda t: 18.0 if t % 120 else 26.0)[0].end is EndReason.FINISHED
    plan, script = example_plan(REST), Script(VirtualClock())
    bench = with_thermometer(Thermometer(script, lambda t: 90.0), plan, script)
    assert run(plan, script=script, bench=bench)[0].end is EndReason.FINISHED


@pytest.mark.parametrize("unit", [None, "K"])
def test_a_range_that_nothing_can_be_held_against_is_refused(unit):
    plan, script = allowing(REST, temperature_C=(18.0, 26.0)), Script(VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)
    if unit is not None:
        thermometer = Thermometer(script)
        thermometer.unit = unit
        bench = with_thermometer(thermometer, plan, script)
    with pytest.raises(ConfigError, match="temperature_C limits the temperature, but") as refused:
        run(plan, script=script, bench=bench)
    assert ("no instrument samples it" if unit is None else "its unit is 'K'") in refused.value.reason
    assert script.calls == []


# --- heartbeat -------------------------------------------------------------------------------------------


def run_alive(steps, *, clock=None, alive=lambda: None, **limits):
    plan, script = allowing(steps, **limits), Script(clock or VirtualClock())
    bench = make_scripted_bench(script, plan.sensor_type)

    def ask():
        script.record_call("force_applicator.alive")
        alive()

    bench.force_applicator.alive = ask
    return run(plan, script=script, bench=bench)


def test_an_instrument_is_asked_whether_it_is_there_while_the_runner_waits():
    ended, _, script = run_alive((Hold(240, acquire=False), *pressed(60, acquire=True)), heartbeat_s=8.0)
    assert ended.end is EndReason.FINISHED
    asked = [call.time_s for call in script.calls if call.name == "force_applicator.alive"]
    # While resting at the latest when it is due; while frames are taken after the frame in which it fell due.
    assert max(np.diff([0.0, *(t for t in asked if t <= 240)])) <= 8.0
    assert max(np.diff([t for t in asked if t >= 240])) <= 8.0 + 2.5
    assert 36 <= len(asked) <= 40


def test_an_applicator_that_falls_silent_is_noticed_in_the_rest():
    clock = VirtualClock()

    def alive():
        if clock.now() > 100:
            raise InstrumentError("force_applicator", "COM3", "no reply")

    ended, _, script = run_alive((Hold(240, acquire=False), *pressed(1)), clock=clock, alive=alive)
    assert ended.end is EndReason.BROKEN
    assert "rule 'heartbeat': force_applicator at COM3: no reply, while holding still for 240 s" in ended.detail
    assert 100 < ended.time_s <= 110
    assert script.names()[-3:] == SAFE


def test_a_heartbeat_that_was_lost_on_the_way_is_asked_for_again():
    lost = [InstrumentError("force_applicator", "COM3", "no reply", retryable=True)]
    ended, told, _ = run_alive((Hold(60, acquire=False),), alive=lambda: lost and raising(lost.pop())())
    assert ended.end is EndReason.FINISHED
    assert sum(isinstance(d, StepRetried) for d in told) == 1
