"""Clocks: the virtual one passes only when somebody sleeps, the real one never steps back."""

from datetime import UTC, datetime, timedelta

import pytest

from cbsr_qa.clock import RealClock, VirtualClock


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
