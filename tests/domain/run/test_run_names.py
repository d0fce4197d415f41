"""A run is named with the time of this computer's clock."""

from datetime import UTC, datetime

from cbsr_qa.domain.run.run import run_named


def test_a_run_has_its_local_date_with_the_zone(in_zurich):
    began = datetime(2026, 7, 31, 23, 30, tzinfo=UTC)
    assert run_named("S-1", began, "0192") == "S-1, 2026-08-01 01:30 CEST (0192)"
    assert run_named("S-1", None, "0192") == "S-1 (0192)"
