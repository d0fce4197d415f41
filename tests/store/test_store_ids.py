"""Identifiers rise whatever the clock does, and are UUIDs of version 7."""

from datetime import UTC, datetime, timedelta
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from cbsr_qa.store.types import IdSource, time_of_id

START = datetime(2026, 11, 21, tzinfo=UTC)


@given(st.lists(st.integers(-10_000, 10_000), min_size=2, max_size=200))
def test_they_rise_even_where_the_clock_is_set_back(steps_ms):
    at = [START]

    def wall():
        at[0] += timedelta(milliseconds=steps_ms.pop() if steps_ms else 0)
        return at[0]

    source = IdSource(wall)
    made = [source.new() for _ in range(len(steps_ms))]
    assert made == sorted(made)
    assert len(set(made)) == len(made)


def test_many_within_one_millisecond_still_rise():
    source = IdSource(lambda: START)
    made = [source.new() for _ in range(20_000)]
    assert made == sorted(set(made))


def test_they_are_version_7_and_tell_their_millisecond():
    made = UUID(IdSource(lambda: START).new())
    assert (made.version, made.variant) == (7, "specified in RFC 4122")
    assert made.int >> 80 == int(START.timestamp() * 1000)


def test_two_stations_do_not_collide_within_one_millisecond():
    one, other = IdSource(lambda: START), IdSource(lambda: START)
    assert not {one.new() for _ in range(1000)} & {other.new() for _ in range(1000)}


@pytest.mark.parametrize(
    ("milliseconds", "year"), [(253_402_300_799_000, 9999), (253_402_300_800_000, None), (2**48 - 1, None)]
)
def test_an_identifier_of_a_year_that_no_date_has_says_no_time(milliseconds, year):
    made = time_of_id(str(UUID(int=milliseconds << 80 | 7 << 76 | 2 << 62)))
    assert (None if made is None else made.year) == year
