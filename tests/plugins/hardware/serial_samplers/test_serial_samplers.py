"""Drivers of load cells and thermometers that send lines, over emulated ones: what is read, tare and self test."""

from contextlib import closing

import numpy as np
import pytest
from emulated_bench import EmulatedStation
from line_samplers import CELL, skipped, true_N
from simulated_setting import base_scene, held, world

from cbsr_qa.domain.errors import InstrumentError, SafetyError
from cbsr_qa.domain.run.station import CheckOutcome
from cbsr_qa_plugins.hardware import _line_sampler
from cbsr_qa_plugins.hardware.serial_samplers import open_load_cell, open_thermometer

# --- what is read ---


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"time": "arrival"},
        {"unit": "g", "sign": -1},
        {"unit": "g", "scale": 2.5, "offset": 70.13, "sign": -1},
        {"unit": "counts", "scale": 1e-5, "offset": -3.0},
    ],
)
def test_the_force_is_the_worlds_whatever_the_line_says_it_in(make, one_world, options):
    station = make(**options)
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=2.0))
    cell = station.open("cell", open_load_cell)
    for _ in range(16):
        station.clock.sleep(0.25)
    block = cell.samples_since(1.0)
    assert len(block) >= 23
    np.testing.assert_allclose(block.values, true_N(station, block.time_s), atol=2e-4)
    assert block.values.max() > 1.0
    assert skipped(cell) == 0


def test_all_that_was_sent_up_to_now_is_there_at_once(station, cell):
    for _ in range(200):
        before = station.clock.now()
        station.clock.sleep(0.5)
        assert len(cell.samples_since(before)) in (4, 5)


def test_samples_come_after_the_time_asked_for_and_each_once(station, cell):
    seen, last = [], -1.0
    for pause in np.random.default_rng(7).uniform(0.01, 2.0, 100):
        station.clock.sleep(pause)
        block = cell.samples_since(last)
        seen += list(block.time_s)
        last = seen[-1] if seen else last
    assert (np.diff(seen) > 0).all()
    assert len(seen) == pytest.approx(8 * station.clock.now(), abs=4)
    np.testing.assert_array_equal(cell.samples_since(-1.0).time_s, seen)


def test_times_are_the_stations_though_the_device_has_its_own_clock(station, cell):
    random = np.random.default_rng(3)
    while station.clock.now() < 1200.0:  # by then the device is 48 ms ahead of itself
        station.clock.sleep(random.uniform(0.5, 5.0))
        cell.samples_since(station.clock.now())
    times = cell.samples_since(station.clock.now() - 60.0).time_s
    late_s = times - np.round(times * 8) / 8
    assert abs(late_s).max() < 0.02
    assert times[-1] <= station.clock.now()


def test_a_long_pause_is_read_whole(station, cell):
    before = station.clock.now()
    station.clock.sleep(60.0)  # more than the kernel's first buffer holds; it has room for a minute and a half
    assert len(cell.samples_since(before)) == pytest.approx(480, abs=1)


def test_what_was_an_hour_ago_is_forgotten(station, cell, monkeypatch):
    monkeypatch.setattr(_line_sampler, "KEPT_S", 60.0)
    for _ in range(90):
        station.clock.sleep(2.0)
        cell.samples_since(station.clock.now())
    kept = cell.samples_since(-1.0).time_s
    assert 59.0 <= station.clock.now() - kept[0] <= 123.0


def test_the_temperature_is_read(station):
    one = station.open("thermometer", open_thermometer, scale=2.0, offset=-1.5)  # the emulated one says °C
    station.clock.sleep(10.0)
    block = one.samples_since(-1.0)
    assert (block.channel, block.unit) == ("temperature", "°C")
    assert len(block) >= 10
    np.testing.assert_allclose(block.values, 2 * 22.0 - 1.5, atol=0.2)
    assert (np.diff(block.time_s) > 0.5).all()
    assert len(one.samples_since(station.clock.now())) == 0


def test_a_resumed_session_draws_noise_of_its_own(station, cell):
    station.clock.sleep(5.0)
    before = cell.samples_since(-1.0).values
    with closing(EmulatedStation(world(base_scene(), began_s=7.5), cell=dict(CELL))) as again:
        resumed = again.open("cell", open_load_cell)
        again.clock.sleep(5.0)
        after = resumed.samples_since(-1.0).values
    shared = min(len(before), len(after))  # the lines of the resumed session begin elsewhere in their rhythm
    assert shared >= 40
    assert (before[:shared] != after[:shared]).all()


# --- tare, limit, dead weight ---


def test_a_tare_makes_the_unloaded_cell_zero(make):
    station = make(unit="g", sign=-1)
    cell = station.open("cell", open_load_cell, offset=30.0, tare_s=1.0)  # the emulated one has no such offset
    station.clock.sleep(5.0)
    assert abs(cell.samples_since(station.clock.now() - 4).values.mean()) < 0.02


def test_a_load_is_no_zero(make, one_world):
    station = make()
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=-20.0))
    with pytest.raises(InstrumentError, match=r"reads \d\.\d+ N before it is tared; more than 0\.5 N is not a zero"):
        station.open("cell", open_load_cell, tare_s=1.0)


def test_a_cell_at_its_limit_is_said_and_is_well_again_after(make, one_world):
    station = make(limit_N=2.0)
    cell = station.open("cell", open_load_cell)
    press = held(0, 0.0, 0.0, 0.25, start_s=station.clock.now())
    one_world.presses.append(press)
    station.clock.sleep(0.5)
    cell.samples_since(-1.0)
    station.clock.sleep(1.5)
    with pytest.raises(SafetyError, match=r"stands at its limit of 2 N") as caught:
        cell.samples_since(station.clock.now() - 0.1)
    assert caught.value.rule == "force"
    one_world.presses.clear()
    station.clock.sleep(1.0)
    assert cell.samples_since(-1.0).values.max() == pytest.approx(2.0)


def test_a_self_test_looks_at_zero_and_noise_and_says_what_it_did_not_do(station, cell):
    zero, noise, weight = cell.self_test()
    assert (zero.name, noise.name, weight.name) == ("zero", "noise", "dead weight")
    assert zero.outcome is CheckOutcome.OK
    assert abs(zero.value) < 0.02
    assert 0 < noise.value < 0.01
    assert weight.outcome is CheckOutcome.NOT_DONE
    assert "dead_weight_g" in weight.remedy


@pytest.mark.parametrize(("share", "outcome"), [(1.0, "ok"), (1.05, "failed")])
def test_a_self_test_with_a_known_mass_asks_for_it(station, one_world, share, outcome):
    press = held(0, 0.0, 0.0, 0.2, start_s=-5000.0)  # relaxed: a steady force
    asked = []

    def ask(text):
        asked.append(text)
        one_world.presses[:] = [press] if "Put" in text else []
        return ""

    one_world.presses.append(press)
    force_N = float(np.mean([one_world.force_N(2.0, n) for n in range(100)]))
    one_world.presses.clear()
    cell = station.open("cell", open_load_cell, ask=ask, dead_weight_g=share * force_N / 9.80665e-3)
    _, _, weight = cell.self_test()
    assert weight.outcome == outcome
    assert weight.value == pytest.approx(force_N, rel=0.01)
    assert weight.allowed == f"{share * force_N:.4g} N ± {0.01 * share * force_N:.2g} N"
    assert [text.split()[0] for text in asked] == ["Put", "Take"]
    assert abs(cell.self_test()[0].value) < 0.02


def test_a_self_test_warns_of_a_load(station, one_world):
    one_world.presses.append(held(0, 0.0, 0.0, 0.2, start_s=-20.0))
    zero = station.open("cell", open_load_cell).self_test()[0]
    assert zero.outcome is CheckOutcome.WARNING
    assert zero.value > 1.0
