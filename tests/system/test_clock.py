"""Clocks: the virtual one passes only when somebody sleeps, the real one never steps back."""

from datetime import UTC, datetime, timedelta

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.system import clock as clocks
from cbsr_qa.system.clock import TICK_S, RealClock, VirtualClock, WallWatch, on_tick, round_to_ticks


def test_virtual_time_passes_by_sleeping_alone():
    clock = VirtualClock(datetime(2026, 1, 1, tzinfo=UTC))
    assert clock.now() == 0
    clock.sleep(3600.5)
    clock.sleep(-5)
    assert clock.now() == 3600.5
    assert clock.wall() == datetime(2026, 1, 1, tzinfo=UTC) + timedelta(seconds=3600.5)


def test_real_time_passes_by_itself():
    clock = RealClock()
    clock.sleep(-1)
    clock.sleep(0)
    before = clock.now()
    clock.sleep(0.02)
    assert 0.02 <= clock.now() - before < 5
    assert clock.now() >= before


@pytest.mark.parametrize("clock", [RealClock(), VirtualClock()])
def test_wall_time_has_its_zone(clock):
    assert clock.wall().tzinfo is not None


@given(st.lists(st.floats(0, 4e5), min_size=1, max_size=20), st.floats(0, 1e7))
def test_differences_of_virtual_times_do_not_depend_on_when(durations_s, later_s):
    early, late = VirtualClock(), VirtualClock()
    late.sleep(later_s)
    begun_s = late.now()
    for duration_s in durations_s:
        early.sleep(duration_s)
        late.sleep(duration_s)
    assert late.now() - begun_s == early.now()


@pytest.mark.parametrize("duration_s", [5e-324, 1e-9, TICK_S / 2, TICK_S])
def test_the_shortest_sleep_is_one_tick(duration_s):
    clock = VirtualClock()
    clock.sleep(duration_s)
    assert clock.now() == TICK_S


def test_durations_become_the_nearest_ticks_and_times_the_next_one():
    assert (round_to_ticks(2.5), round_to_ticks(0.0), round_to_ticks(1.4 * TICK_S)) == (2.5, 0.0, TICK_S)
    assert (on_tick(7.25), on_tick(1.1 * TICK_S)) == (7.25, 2 * TICK_S)


def test_real_times_are_ticks_too():
    clock = RealClock()
    for _ in range(20):
        assert clock.now() % TICK_S == 0
        clock.sleep(1e-12)


@pytest.mark.parametrize("hours", [-20_000.0, -1.0, 0.0, 2.0, 80_000.0])
def test_a_clock_that_is_set_is_noticed(hours, monkeypatch):
    class Set(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime.now(tz) + timedelta(hours=hours)

    watch = WallWatch()
    monkeypatch.setattr(clocks, "datetime", Set)
    assert watch.clock_change() / timedelta(hours=1) == pytest.approx(hours, abs=0.01)
