"""People read a run's time by their own clock, with its zone."""

from datetime import UTC, datetime

from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.run.changes import VerdictOverride
from cbsr_qa.domain.run.run import run_named
from cbsr_qa.domain.run.station import StationCheck
from cbsr_qa.report.station import station_blocks

AT = datetime(2026, 7, 1, 22, 30, tzinfo=UTC)


def test_a_run_is_named_by_the_local_day(in_zurich):
    assert run_named("S-1", AT, "01a2") == "S-1, 2026-07-02 00:30 CEST (01a2)"
    assert run_named("S-1", None, "01a2") == "S-1 (01a2)"


def test_an_override_and_the_check_of_a_station_have_the_local_time(in_zurich):
    override = VerdictOverride("01a1", "01a2", "01a3", Outcome.FAIL, Outcome.PASS, "Ada", AT, "seen twice")
    assert " on 2026-07-02 00:30 CEST: seen twice" in override.words
    check = StationCheck("c", "bench", "", AT, "disc", "0" * 64, (), (), ())
    assert "on 2026-07-02 00:30 CEST" in station_blocks("bench", check, AT)[0].text
