"""The simulated bench: numbers that repeat, step by step, and noise that never does."""

import numpy as np
import pytest
from simulated_benches import SPEED, opened
from simulated_setting import scene

from cbsr_qa.domain.plan.plan import Scene
from cbsr_qa.domain.readings.frames import FrameBlock, SampleBlock
from cbsr_qa_plugins.hardware.simulated_bench import SimulatedBench


def _session(bench: SimulatedBench) -> tuple[FrameBlock, SampleBlock]:
    bench.home()
    bench.find_surface(10.0, 5.0)
    bench.press(0.8, SPEED)
    frames = bench.acquire(3)
    bench.release()
    return frames, bench.samples_since(-1.0)


def test_two_benches_of_one_seed_give_identical_numbers():
    (one, force), (other, other_force) = (_session(opened(seed=4)[1]) for _ in range(2))
    np.testing.assert_array_equal(one.voltages, other.voltages)
    np.testing.assert_array_equal(one.time_s, other.time_s)
    np.testing.assert_array_equal(force.values, other_force.values)


def test_another_seed_gives_another_noise():
    one, other = (opened(seed=seed)[1].acquire(1).voltages for seed in (1, 2))
    assert (one != other).all()


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


@pytest.mark.rest
@pytest.mark.parametrize("earlier_s", [0.1, 77.7777, 12345.678])
def test_a_step_gives_the_same_numbers_whenever_it_is_done_and_wherever_the_head_came_from(earlier_s: float):
    _, bench = opened(_quiet_but_for_noise())
    bench.begin_step(0, 4)
    first, force = _load(bench, 5)
    began_s = first.time_s[0]
    later_clock, later = opened(_quiet_but_for_noise(), resumed_at_s=99.0)
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
    count = len(force.select_interval(force.time_s[-1] - 8.0, 1e9))
    assert count > 50
    np.testing.assert_array_equal(second_force.time_s[-count:] - shift_s, force.time_s[-count:])
    np.testing.assert_array_equal(second_force.values[-count:], force.values[-count:])
    assert bench.world.presses[-1].steps[0].change == later.world.presses[-1].steps[0].change


def test_no_two_steps_share_their_numbers():
    _, bench = opened(scene("measurement-noise"))
    frames = []
    for phase, number in [(0, 0), (0, 1), (1, 0), (0, 99_999), (2046, 99_999)]:
        bench.begin_step(phase, number)
        frames += [*bench.acquire(2).voltages]
        bench.move_to(1.0, 0.0)
        frames += [*bench.acquire(1).voltages]
    assert len({frame.tobytes() for frame in frames}) == len(frames) == 15


def test_what_drifts_with_the_time_of_a_run_goes_on_in_a_resumed_session():
    of = scene("temperature-drift", temperature_drift={"coefficient_per_K": 0.02, "rate_K_per_h": 10.0})
    clock, whole = opened(of)
    clock.sleep(600.0)
    resumed = opened(of, resumed_at_s=600.0)[1]
    assert whole.acquire(1).voltages.tolist() == resumed.acquire(1).voltages.tolist()


def test_no_two_frames_share_their_noise_whenever_they_begin():
    clock, bench = opened()
    frames = []
    for pause in (0.0, 0.3, 1.1, 1.249999, 0.0, 2.4999999, 1e-9, 0.7):
        clock.sleep(pause)
        frames.append(bench.acquire(1).voltages[0])
    assert len({frame.tobytes() for frame in frames}) == len(frames)
