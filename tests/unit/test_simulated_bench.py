"""The simulated bench: time, head, surface, load cell, and numbers that repeat."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from simulated_setting import MOTION, base_scene, context, installed, scene

from cbsr_qa.clock import VirtualClock, in_ticks
from cbsr_qa.config.loader import load_station
from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.domain.frames import FrameBlock, SampleBlock
from cbsr_qa.domain.kinematics import stroke_s, surface_search_s, travel_s
from cbsr_qa.domain.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.outcome import EndReason
from cbsr_qa.domain.plan import PluginChoice, Scene
from cbsr_qa.domain.run_events import LoadFinished
from cbsr_qa.domain.scene import Moment, SceneSetting
from cbsr_qa.domain.steps import FindSurface, Hold, Press, Release
from cbsr_qa.interfaces import ForceApplicator, FrameSource, Sampler
from cbsr_qa.runner.bench import Bench, Mounted
from cbsr_qa.runner.execute import execute
from cbsr_qa.testing.bench import example_identity, example_plan
from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench, open_bench

SPEED = 40 / 60


def _bench(of=None, **more) -> tuple[VirtualClock, SimulatedBench]:
    clock = more.pop("clock", None) or VirtualClock()
    return clock, open_bench(context(of or base_scene(), clock=clock, **more))


def lying(error_mm: float | None) -> Scene:
    """The base scene with the sheet off nominal by this much; None for a sheet that lies flat."""
    others = tuple(effect for effect in base_scene().effects if effect.name != "sheet-seat")
    seat = () if error_mm is None else (PluginChoice("sheet-seat", {"error_mm": error_mm}),)
    return replace(base_scene(), effects=(*seat, *others))


def _session(bench: SimulatedBench) -> tuple[FrameBlock, SampleBlock]:
    bench.home()
    bench.find_surface(10.0, 5.0)
    bench.press(0.8, SPEED)
    frames = bench.acquire(3)
    bench.release()
    return frames, bench.samples_since(-1.0)


# --- numbers that repeat ---


def test_one_object_fills_all_three_roles():
    _, bench = _bench()
    for role in (FrameSource, ForceApplicator, Sampler):
        assert isinstance(bench, role)


def test_two_benches_of_one_seed_give_identical_numbers():
    (one, force), (other, other_force) = (_session(_bench(seed=4)[1]) for _ in range(2))
    np.testing.assert_array_equal(one.voltages, other.voltages)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(force.values, other_force.values)


def test_another_seed_gives_another_noise():
    one, other = (_bench(seed=seed)[1].acquire(1).voltages for seed in (1, 2))
    assert (one != other).all()


def test_an_effect_more_changes_no_number_of_the_others():
    class Shift:
        needs, perturbs = (), "force"

        def __init__(self, setting: SceneSetting) -> None:
            self._draw = np.random.default_rng(setting.seed)

        def apply(self, moment: Moment) -> None:
            self._draw.standard_normal()

    more = replace(base_scene(), effects=(PluginChoice("shift"), *base_scene().effects))
    found = context(more, effect_factory=lambda name: Shift if name == "shift" else installed(name))
    (one, force), (other, other_force) = _session(_bench()[1]), _session(open_bench(found))
    np.testing.assert_array_equal(one.voltages, other.voltages)
    np.testing.assert_array_equal(force.values, other_force.values)


def _load(bench: SimulatedBench, number: int) -> tuple[FrameBlock, SampleBlock]:
    """One press as the runner makes it, as step numbers from a given one on."""
    bench.begin_step(0, number)
    bench.move_to(12.0, -7.0)
    start = bench.samples_since(-1.0).time_s.max(initial=0.0)
    bench.press(0.8, SPEED)
    bench.begin_step(0, number + 1)
    frames = bench.acquire(3)
    bench.begin_step(0, number + 2)
    bench.release()
    return frames, bench.samples_since(start)


def _quiet_but_for_noise() -> Scene:
    return scene("piezoresistivity", "elastic-stress", "measurement-noise", "load-cell-noise", "time-skew",
                 "applicator-position-error", load_cell_noise={"rms_N": 0.01},
                 applicator_position_error={"error_mm": 0.1, "depth_error_mm": 0.01})  # fmt: skip


@pytest.mark.parametrize("earlier_s", [0.1, 77.7777, 12345.678])
def test_a_step_gives_the_same_numbers_whenever_it_is_done_and_wherever_the_head_came_from(earlier_s: float):
    _, bench = _bench(_quiet_but_for_noise())
    bench.begin_step(0, 4)
    first, force = _load(bench, 5)
    began_s = first.time_s[0]
    later_clock, later = _bench(_quiet_but_for_noise(), resumed_at_s=99.0)
    later_clock.sleep(earlier_s)
    later.begin_step(0, 4)
    later.move_to(9.0, -9.0)
    later.acquire(2)
    later.press(0.5, SPEED)  # on some of the nodes of the place that follows
    later.acquire(1)
    later.move_to(14.0, -3.0)
    later.press(0.5, SPEED)
    later.acquire(1)
    later.release()
    second, second_force = _load(later, 5)
    shift_s = second.time_s[0] - began_s
    assert shift_s > 0
    np.testing.assert_array_equal(second.time_s - shift_s, first.time_s)
    np.testing.assert_array_equal(second.reading_time_s - shift_s, first.reading_time_s)
    np.testing.assert_array_equal(second.voltages, first.voltages)
    # Samples from the press on; before it the head travelled for another time.
    count = len(force.between(force.time_s[-1] - 8.0, 1e9))
    assert count > 50
    np.testing.assert_array_equal(second_force.time_s[-count:] - shift_s, force.time_s[-count:])
    np.testing.assert_array_equal(second_force.values[-count:], force.values[-count:])
    assert bench.world.presses[-1].steps[0].change == later.world.presses[-1].steps[0].change


def test_no_two_steps_share_their_numbers():
    _, bench = _bench(scene("measurement-noise"))
    frames = []
    for phase, number in [(0, 0), (0, 1), (1, 0), (0, 99_999), (2046, 99_999)]:
        bench.begin_step(phase, number)
        frames += [*bench.acquire(2).voltages]
        bench.move_to(1.0, 0.0)
        frames += [*bench.acquire(1).voltages]
    assert len({frame.tobytes() for frame in frames}) == len(frames) == 15


def test_what_drifts_with_the_time_of_a_run_goes_on_in_a_resumed_session():
    of = scene("temperature-drift", temperature_drift={"coefficient_per_K": 0.02, "rate_K_per_h": 10.0})
    clock, whole = _bench(of)
    clock.sleep(600.0)
    resumed = _bench(of, resumed_at_s=600.0)[1]
    assert whole.acquire(1).voltages.tolist() == resumed.acquire(1).voltages.tolist()


def test_no_two_frames_share_their_noise_whenever_they_begin():
    clock, bench = _bench()
    frames = []
    for pause in (0.0, 0.3, 1.1, 1.249999, 0.0, 2.4999999, 1e-9, 0.7):
        clock.sleep(pause)
        frames.append(bench.acquire(1).voltages[0])
    assert len({frame.tobytes() for frame in frames}) == len(frames)


# --- frames ---


def test_frames_take_their_period_and_are_stamped_in_the_middle():
    clock, bench = _bench()
    clock.sleep(7.0)
    block = bench.acquire(4)
    np.testing.assert_allclose(block.time_s, 7.0 + 2.5 * (np.arange(4) + 0.5))
    assert clock.now() == pytest.approx(17.0)
    assert block.voltages.shape == (4, 16, 16)
    assert not block.flags.any()
    assert block.current_A == pytest.approx(0.4e-3)


def test_frames_meet_the_press_that_is_on():
    silent = scene("piezoresistivity")
    _, bench = _bench(silent)
    unloaded = bench.acquire(1).voltages[0]
    bench.press(0.8, SPEED)
    loaded = bench.acquire(1).voltages[0]
    bench.release()
    again = bench.acquire(1).voltages[0]
    assert np.abs(loaded - unloaded).max() > 1e-5 * np.abs(unloaded).max()
    np.testing.assert_allclose(again, unloaded, rtol=0, atol=1e-12 * np.abs(unloaded).max())


def test_the_current_leaves_headroom_below_the_source_limit():
    _, bench = _bench(scene())
    diagonal = np.abs(np.diagonal(bench.acquire(1).voltages[0]))
    assert diagonal.max() * (18.1 + 2 * 9.8) / 18.1 < 0.78 * 20.0


# --- head ---


def test_press_and_release_take_the_time_the_dry_run_counts():
    clock, bench = _bench(lying(None))
    bench.move_to(30.0, 0.0)
    assert clock.now() == pytest.approx(travel_s(MOTION, 30.0))
    start = clock.now()
    bench.press(0.8, SPEED)
    assert clock.now() - start == pytest.approx(stroke_s(MOTION, 0.8))
    start = clock.now()
    bench.release()
    assert clock.now() - start == pytest.approx(stroke_s(MOTION, 0.8))


def test_a_press_is_a_ramp_of_the_asked_strain_rate():
    clock, bench = _bench(lying(None))
    bench.press(0.8, SPEED)
    (press,) = bench.world.presses
    (ramp,) = press.steps
    assert ramp.change == pytest.approx(0.2)
    assert ramp.change / ramp.ramp_s == pytest.approx(1 / 6)  # the paper's 16.67 %/s
    assert ramp.start_s + ramp.ramp_s == pytest.approx(clock.now())
    bench.release()
    assert press.strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)


def test_travelling_lifts_the_head_first():
    clock, bench = _bench(lying(None))
    bench.press(0.8, SPEED)
    bench.move_to(20.0, 0.0)
    bench.press(0.4, SPEED)
    first, second = bench.world.presses
    assert first.strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)
    assert (second.index, second.x_mm, second.strain_at(clock.now())) == (1, 20.0, pytest.approx(0.1))


def test_the_safe_state_lifts_at_once_and_may_be_called_again():
    clock, bench = _bench(lying(None))
    bench.press(0.8, SPEED)
    before = clock.now()
    bench.safe_state()
    bench.safe_state()
    assert clock.now() == before
    clock.sleep(1.0)
    assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)
    bench.press(0.8, SPEED)  # waits until the head is up, then goes down as ever
    assert clock.now() == pytest.approx(before + 25.8 / 10.0 + stroke_s(MOTION, 0.8))


@pytest.mark.parametrize("seed", range(6))
def test_the_surface_is_found_to_a_hundredth_of_a_millimetre(seed: int):
    clock, bench = _bench(lying(0.08), seed=seed)
    start = clock.now()
    found = bench.find_surface(20.0, -10.0)
    took_s = clock.now() - start - travel_s(MOTION, np.hypot(20.0, 10.0))
    true = MOTION.hover_mm + bench.world.surface_mm(20.0, -10.0, 0.0)
    assert found == pytest.approx(true, abs=0.015)
    assert took_s == pytest.approx(surface_search_s(MOTION), rel=0.25)


def test_in_a_scene_that_says_nothing_of_it_the_sheet_lies_exactly_flat():
    for of in (scene(), scene("elastic-stress")):
        clock, bench = _bench(of)
        assert {bench.world.surface_mm(x, y, 3.0) for x in (-30.0, 0.0, 20.0) for y in (0.0, 15.0)} == {0.0}
        bench.press(0.8, SPEED)
        assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.2, abs=1e-15)


def test_a_press_starts_from_the_surface_that_was_found():
    clock, bench = _bench(lying(0.1), seed=3)
    bench.find_surface(0.0, 0.0)
    bench.press(0.8, SPEED)
    assert bench.world.presses[-1].strain_at(clock.now()) == pytest.approx(0.2, abs=0.004)


def test_finding_the_surface_leaves_a_residue_that_a_rest_takes_away():
    clock, bench = _bench()
    bench.find_surface(0.0, 0.0)
    fresh = abs(bench.world.truth(clock.now())[0].relative_change)
    assert fresh > 1e-3
    assert abs(bench.world.truth(clock.now() + 240.0)[0].relative_change) < 1e-3 * fresh


def test_without_a_sheet_that_resists_the_surface_is_not_found():
    clock, bench = _bench(scene())
    with pytest.raises(InstrumentError, match=r"bench at \(5, 0\) mm: no contact force of 0.2 N") as lost:
        bench.find_surface(5.0, 0.0)
    assert "elastic-stress" in lost.value.remedy
    assert bench.world.presses[0].strain_at(clock.now()) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("strain", [0.05, 0.2, 0.3])
def test_loads_record_when_the_head_left_the_sheet(strain: float):
    clock, bench = _bench()
    loads = [Load(f"L{i}", *place, strain, 0) for i, place in enumerate(NINE_LOCATIONS_MM[:3])]
    surfaces = [FindSurface(load.x_mm, load.y_mm) for load in loads]
    cycles = [(Press(load), Hold(10.0, acquire=False), Release(), Hold(10.0, acquire=False)) for load in loads]
    told: list[object] = []
    plan = example_plan([*surfaces, *chain.from_iterable(cycles)])
    mounted = Mounted(load_station("simulated").value.instruments[0], bench)
    ended = execute(plan, example_identity(), Bench([mounted]), clock, [told.append])
    assert ended.end is EndReason.FINISHED, ended.detail
    records = [event.record for event in told if isinstance(event, LoadFinished)]
    presses = bench.world.presses[-len(loads) :]  # after those of the surface search
    for record, press in zip(records, presses, strict=True):
        up = press.steps[-1]
        assert press.strain_at(record.release_start_s) == pytest.approx(strain, abs=0.004)
        assert up.change < 0
        assert record.clear_s == pytest.approx(up.start_s + up.ramp_s, abs=0.05)


def test_an_eased_press_goes_straight_to_its_depths_and_the_world_knows_from_where():
    """Strains up and down in one press of the world; the loop's upper branch is seen on the way back alone."""
    width = 0.1
    clock, bench = _bench(scene("piezoresistivity", "hysteresis", hysteresis={"width": width}))
    gauge, changes, strains = bench.world.setting.material.against_strain.slope.value, [], []
    for strain in (0.05, 0.1, 0.2, 0.1, 0.05):
        bench.press(strain * 4.0, SPEED)
        (truth,) = bench.world.truth(clock.now())
        strains.append(truth.strain)
        changes.append(truth.relative_change)
    assert strains == pytest.approx([0.05, 0.1, 0.2, 0.1, 0.05])
    above = [0.0, 0.0, 0.0, width * gauge * 0.2, 0.75 * width * gauge * 0.2]
    assert changes == pytest.approx([gauge * s + more for s, more in zip(strains, above, strict=True)])
    (press,) = bench.world.presses
    assert [step.ramp_s * SPEED for step in press.steps] == pytest.approx([0.2, 0.2, 0.4, 0.4, 0.2])


# --- load cell ---


def test_samples_come_eight_a_second_each_once():
    clock, bench = _bench()
    clock.sleep(2.06)
    first = bench.samples_since(-1.0)
    clock.sleep(1.0)
    second = bench.samples_since(float(first.time_s[-1]))
    times = np.concatenate([first.time_s, second.time_s])
    np.testing.assert_array_equal(times, np.arange(1, 25) / 8)
    assert (first.channel, first.unit) == ("force", "N")
    assert len(bench.samples_since(clock.now())) == 0


def test_a_held_press_ends_at_the_relaxed_force():
    clock, bench = _bench(scene("elastic-stress", "stress-relaxation"))
    bench.press(0.8, SPEED)
    pressed_s = clock.now()
    clock.sleep(300.0)
    block = bench.samples_since(pressed_s)
    relaxed_N = 132.5e3 * 0.2 * np.pi * 6.5e-3**2
    assert block.values[-1] == pytest.approx(relaxed_N, rel=1e-6)
    assert 1.1 * relaxed_N < block.values.max() < 1.25 * relaxed_N
    assert (np.diff(block.values) < 0).all()
    bench.release()
    clock.sleep(1.0)
    assert (bench.samples_since(clock.now() - 1.0).values == 0).all()


# --- refusals and identity ---


def test_it_says_that_it_is_simulated_and_of_what():
    identity = _bench(seed=12)[1].identity()
    assert identity.simulated
    assert identity.role == "bench"
    assert "scene base" in identity.model
    assert "seed 12" in identity.model


def test_a_place_off_the_sheet_is_refused_before_anything_moves():
    clock, bench = _bench()
    with pytest.raises(InstrumentError, match="outside the sheet"):
        bench.move_to(40.0, 40.0)
    with pytest.raises(InstrumentError, match="outside the sheet"):
        bench.move_to(float("nan"), 0.0)
    assert clock.now() == 0.0


@pytest.mark.parametrize(("depth_mm", "speed_mm_s"), [(4.0, 1.0), (-0.1, 1.0), (0.8, 0.0), (float("nan"), 1.0)])
def test_an_impossible_press_is_refused(depth_mm: float, speed_mm_s: float):
    with pytest.raises(InstrumentError, match="cannot press"):
        _bench()[1].press(depth_mm, speed_mm_s)


def test_no_frames_cannot_be_taken():
    with pytest.raises(InstrumentError, match="at least 1"):
        _bench()[1].acquire(0)


def test_a_closed_bench_takes_no_orders_but_still_goes_safe():
    _, bench = _bench()
    bench.close()
    for order in (
        bench.identity,
        bench.home,
        bench.release,
        lambda: bench.acquire(1),
        lambda: bench.samples_since(0.0),
    ):
        with pytest.raises(InstrumentError, match="closed"):
            order()
    bench.safe_state()
    bench.close()


def test_an_unknown_option_is_refused_with_the_nearest():
    with pytest.raises(ConfigError, match="no option 'hover'") as refused:
        _bench(options={"hover": 3.0})
    assert "did you mean 'hover_mm'" in refused.value.remedy


@pytest.mark.parametrize("value", [0.0, "25", True, float("inf")])
def test_an_option_out_of_range_is_refused(value: object):
    with pytest.raises(ConfigError, match="hover_mm is"):
        _bench(options={"hover_mm": value})


def test_without_a_scene_it_cannot_open():
    with pytest.raises(ConfigError, match="no scene"):
        open_bench(context(None))


def test_a_head_told_to_stay_stays_whatever_its_position_errors():
    of = scene(
        "elastic-stress",
        "applicator-position-error",
        applicator_position_error={"error_mm": 0.1, "depth_error_mm": 0.05},
    )
    clock = VirtualClock()
    bench = open_bench(context(of, clock=clock))
    bench.press(0.8, 0.5)
    before = [list(press.steps) for press in bench.world.presses]
    bench.press(0.8, 0.5)
    assert [list(press.steps) for press in bench.world.presses] == before
    assert np.isfinite(bench.world.force_N(clock.now(), 0))


def test_samples_of_a_step_begin_again_with_what_the_head_is_told():
    clock, bench = _bench(lying(None))
    clock.sleep(0.3)
    bench.begin_step(0, 1)
    bench.move_to(10.0, 0.0)  # a second
    clock.sleep(0.05)
    bench.begin_step(0, 2)
    clock.sleep(0.15)
    times = bench.samples_since(-1.0).time_s
    at_s = in_ticks(0.3)
    after_s = at_s + 1.0 + in_ticks(0.05)
    expected = [0.125, 0.25, *(at_s + np.arange(1, 9) / 8), after_s + 0.125]
    np.testing.assert_array_equal(times, expected)
