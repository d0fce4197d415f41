"""The simulated bench: its roles, frames and load cell, what it refuses, and what it says it is."""

import numpy as np
import pytest
from simulated_benches import SPEED, lying, opened
from simulated_setting import context, scene

from cbsr_qa.domain.errors import ConfigError, InstrumentError
from cbsr_qa.system.clock import round_to_ticks
from cbsr_qa_plugins.hardware.simulated_bench import open_bench

# --- frames ---


def test_frames_take_their_period_and_are_stamped_in_the_middle():
    clock, bench = opened()
    clock.sleep(7.0)
    block = bench.acquire(4)
    np.testing.assert_allclose(block.time_s, 7.0 + 2.5 * (np.arange(4) + 0.5))
    assert clock.now() == pytest.approx(17.0)
    assert block.voltages.shape == (4, 16, 16)
    assert not block.flags.any()
    assert block.current_A == pytest.approx(0.4e-3)


def test_frames_meet_the_press_that_is_on():
    silent = scene("piezoresistivity")
    _, bench = opened(silent)
    unloaded = bench.acquire(1).voltages[0]
    bench.press(0.8, SPEED)
    loaded = bench.acquire(1).voltages[0]
    bench.release()
    again = bench.acquire(1).voltages[0]
    assert np.abs(loaded - unloaded).max() > 1e-5 * np.abs(unloaded).max()
    np.testing.assert_allclose(again, unloaded, rtol=0, atol=1e-12 * np.abs(unloaded).max())


def test_the_current_leaves_headroom_below_the_source_limit():
    _, bench = opened(scene())
    diagonal = np.abs(np.diagonal(bench.acquire(1).voltages[0]))
    assert diagonal.max() * (18.1 + 2 * 9.8) / 18.1 < 0.78 * 20.0


# --- load cell ---


def test_samples_come_eight_a_second_each_once():
    clock, bench = opened()
    clock.sleep(2.06)
    first = bench.samples_since(-1.0)
    clock.sleep(1.0)
    second = bench.samples_since(float(first.time_s[-1]))
    times = np.concatenate([first.time_s, second.time_s])
    np.testing.assert_array_equal(times, np.arange(1, 25) / 8)
    assert (first.channel, first.unit) == ("force", "N")
    assert len(bench.samples_since(clock.now())) == 0


def test_a_held_press_ends_at_the_relaxed_force():
    clock, bench = opened(scene("elastic-stress", "stress-relaxation"))
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


def test_samples_of_a_step_begin_again_with_what_the_head_is_told():
    clock, bench = opened(lying(None))
    clock.sleep(0.3)
    bench.begin_step(0, 1)
    bench.move_to(10.0, 0.0)  # a second
    clock.sleep(0.05)
    bench.begin_step(0, 2)
    clock.sleep(0.15)
    times = bench.samples_since(-1.0).time_s
    at_s = round_to_ticks(0.3)
    after_s = at_s + 1.0 + round_to_ticks(0.05)
    expected = [0.125, 0.25, *(at_s + np.arange(1, 9) / 8), after_s + 0.125]
    np.testing.assert_array_equal(times, expected)


# --- refusals and identity ---


def test_it_says_that_it_is_simulated_and_of_what():
    identity = opened(seed=12)[1].identity()
    assert identity.simulated
    assert identity.role == "bench"
    assert "scene base" in identity.model
    assert "seed 12" in identity.model


@pytest.mark.parametrize(
    ("order", "arguments", "said"),
    [
        ("move_to", (40.0, 40.0), "outside the sheet"),
        ("move_to", (float("nan"), 0.0), "outside the sheet"),
        ("press", (4.0, 1.0), "cannot press"),
        ("press", (-0.1, 1.0), "cannot press"),
        ("press", (0.8, 0.0), "cannot press"),
        ("press", (float("nan"), 1.0), "cannot press"),
        ("acquire", (0,), "at least 1"),
    ],
)
def test_an_impossible_order_is_refused_before_anything_moves(order, arguments, said):
    clock, bench = opened()
    with pytest.raises(InstrumentError, match=said):
        getattr(bench, order)(*arguments)
    assert clock.now() == 0.0


def test_a_closed_bench_takes_no_orders_but_still_goes_safe():
    _, bench = opened()
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


def test_without_a_scene_it_cannot_open():
    with pytest.raises(ConfigError, match="no scene"):
        open_bench(context(None))
