"""What was tested: verdicts that count, yields, reasons for failure, and lists as JSON and CSV."""

import csv
import io
import json
from datetime import timedelta

import pytest
from stored_lots import LIMITS, store_run

from cbsr_qa.app.shift.lists import LATEST_RUNS, ListRequest, list_sensors, sensor_runs
from cbsr_qa.app.shift.summary import local_day, shift_summary
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.stats.process_capability import pass_rate
from cbsr_qa.store.opening import open_store

ERROR, DRIFT = "centre_of_mass_error", "drift"


def values(*, error=2.0, drift=0.0):
    places = [
        Measurement(ERROR, value, "mm", 0.02, "nine locations", f"L{k}", 0, load=k, strain=0.2)
        for k, value in enumerate((error, 2.0))
    ]
    return tuple(m.judge(LIMITS[m.name]) for m in (*places, Measurement(DRIFT, drift, "%/min")))


@pytest.fixture(scope="module")
def shift(tmp_path_factory):
    """Two days: A fails and passes on the second try, B fails both limits, C is aborted, D is overridden."""
    url = f"sqlite:///{tmp_path_factory.mktemp('shift') / 'shift.db'}"
    with open_store(url, durable=False) as store:
        names = {
            "A0": store_run(store, "A", values(error=9.0), day=0, operator="=Ada"),
            "A1": store_run(store, "A", values(), day=1),
            "B1": store_run(store, "B", values(error=9.0, drift=3.0), day=1, station="S2"),
            "C1": store_run(store, "C", values(), day=1, end=EndReason.ABORTED),
            "D1": store_run(store, "D", values(), day=1, batch="42"),
            "E1": store_run(store, "E", values(drift=3.0), day=1),
        }
        store.changes.override_verdict(names["D1"], Outcome.FAIL, operator="Bob", why="scratched")
        store.changes.override_verdict(names["E1"], Outcome.PASS, operator="Bob", why="draught")
        yield url, store, names


def day_of(store, run):
    return store.runs.read_identity(run).started_at.date()


def test_a_shift_counts_verdicts_as_they_were_overridden(shift):
    _, store, _ = shift
    total = shift_summary(store, RunSelection()).total
    assert (total.runs, total.decided, total.passed, total.failed, total.not_finished) == (6, 5, 2, 3, 1)
    assert (total.overridden, total.sensors) == (2, 5)
    assert total.test_yield == pass_rate(2, 4)  # A and E of A, B, D, E
    assert total.first_pass_yield == pass_rate(1, 4)  # A failed first


def test_the_second_day_s_first_pass_leaves_out_a_sensor_first_tested_the_day_before(shift):
    _, store, names = shift
    day = day_of(store, names["A1"])
    summary = shift_summary(store, RunSelection(since=day, until=day))
    assert summary.total.test_yield == pass_rate(2, 4)
    assert summary.total.first_pass_yield == pass_rate(1, 3)
    assert [(part.name, part.runs, part.passed) for part in summary.stations] == [("S2", 1, 0), ("bench-α", 4, 2)]


def test_reasons_count_sensors_and_not_places_or_overridden_failures(shift):
    _, store, _ = shift
    reasons = shift_summary(store, RunSelection()).reasons
    assert [(reason.words, reason.sensors) for reason in reasons] == [
        ("centre of mass error (nine locations)", 2),
        ("decided by an operator", 1),
        ("drift", 1),
    ]


def test_sensors_have_the_verdict_of_their_last_decided_run(shift):
    _, store, _ = shift
    found = list_sensors(store, ListRequest(RunSelection(checks=False)))
    assert [(s.serial, s.verdict, s.first_pass) for s in found.sensors] == [
        ("A", Outcome.PASS, False),
        ("B", Outcome.FAIL, False),
        ("C", None, None),
        ("D", Outcome.FAIL, False),
        ("E", Outcome.PASS, True),
    ]
    failed = list_sensors(
        store, ListRequest(RunSelection(checks=False), limit="centre of mass error (nine locations)")
    )
    assert [s.serial for s in failed.sensors] == ["B"]  # A has passed since


def test_runs_are_chosen_by_failure_station_and_limit(shift, capsys):
    url, _, names = shift

    def listed(*options):
        assert run_guarded(["runs", *options, "--json", "--database", url]) == 0
        return [run["run"] for run in json.loads(capsys.readouterr().out)["runs"]]

    assert listed("--failed") == [names["A0"], names["B1"], names["D1"]]
    assert listed("--limit", "drift") == [names["B1"]]
    assert listed("--failed", "--latest", "1") == [names["D1"]]
    assert listed("--station", "S2") == [names["B1"]]
    assert listed("--batch", "42") == [names["D1"]]
    assert listed("--latest", "2") == [names["D1"], names["E1"]]
    assert listed("--today") == []  # their clocks say 2026-11-21 and 22


def test_a_sensor_s_runs_are_numbered_by_those_that_finished_before(shift):
    _, store, names = shift
    assert [(run.run, run.earlier) for run in sensor_runs(store, "A")] == [(names["A0"], 0), (names["A1"], 1)]


def test_today_is_the_local_day():
    begins, ends = local_day()
    assert begins.utcoffset() is not None
    assert (begins.hour, begins.minute, ends.hour) == (0, 0, 0)
    assert timedelta(hours=22) < ends - begins < timedelta(hours=26)


def test_csv_is_safe_to_open_in_a_spreadsheet(shift, capsys, tmp_path):
    url, _, names = shift
    assert run_guarded(["runs", "--csv", str(tmp_path / "runs.csv"), "--database", url]) == 0
    text = (tmp_path / "runs.csv").read_bytes().decode()
    assert text.count("\r\n") == text.count("\n") == 7
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["run"] for row in rows] == list(names.values())
    assert rows[0]["operator"] == "'=Ada"
    assert (rows[2]["failed_limits"], rows[3]["verdict"]) == (f"{DRIFT}; {ERROR} (nine locations)", "")
    capsys.readouterr()
    assert run_guarded(["sensors", "--csv", "-", "--database", url]) == 0
    assert capsys.readouterr().out.startswith("serial,batch,")
    assert run_guarded(["runs", "--csv", str(tmp_path / "runs.csv"), "--database", url]) == 2  # never overwritten


def test_an_unknown_name_is_refused_and_a_limit_nobody_failed_is_said(shift, capsys):
    url, _, _ = shift
    assert run_guarded(["runs", "--station", "bench-a", "--database", url]) == 2
    assert "did you mean 'bench-α'?" in capsys.readouterr().err
    assert run_guarded(["runs", "--limit", "drifts", "--database", url]) == 0
    assert "did you mean 'drift'?" in capsys.readouterr().out


def test_a_table_shows_verdicts_yields_and_reasons(shift, capsys):
    url, _, _ = shift
    assert run_guarded(["runs", "--database", url]) == 0
    out = capsys.readouterr().out
    assert "– 6 runs: 2 passed, 3 failed, 1 not finished" in out
    assert "2 of 4, 50 %" in out
    assert "overridden by Bob: scratched" in " ".join(out.split())
    assert "Reasons for failure" in out


def test_plain_runs_lists_the_latest_and_says_how_many_there_are(tmp_path, capsys):
    database = str(tmp_path / "many.db")
    with open_store(f"sqlite:///{database}", durable=False) as store:
        for number in range(LATEST_RUNS + 3):
            store_run(store, f"S-{number:02d}", values())

    def printed(*options):
        assert run_guarded(["runs", "--database", database, *options]) == 0
        return " ".join(capsys.readouterr().out.split())

    plain = printed()
    assert f"the latest {LATEST_RUNS} of {LATEST_RUNS + 3} runs are listed and counted" in plain
    assert ("S-02 " in plain, "S-03 " in plain, "S-52 " in plain) == (False, True, True)
    assert "of 53 runs" in printed("--latest", "2")
    assert "the latest" not in printed("--latest", "53")
    assert len(json.loads(printed("--json"))["runs"]) == LATEST_RUNS + 3
    assert "the latest" not in printed("--station", "bench-α")


def test_sensors_say_who_overrode_the_verdict_that_they_show(shift, capsys):
    url, store, _ = shift
    sensors = list_sensors(store, ListRequest(RunSelection())).sensors
    overridden = {one.serial: (one.overridden_by, one.overridden_why) for one in sensors if one.overridden_by}
    assert overridden == {"D": ("Bob", "scratched"), "E": ("Bob", "draught")}
    run_guarded(["sensors", "--database", url])
    assert "overridden by Bob: draught" in " ".join(capsys.readouterr().out.split())


def test_a_terminal_shows_local_times_with_their_zone_and_a_file_has_utc(shift, capsys, tmp_path, in_zurich):
    url, _, _ = shift
    assert run_guarded(["runs", "--database", url]) == 0
    said = capsys.readouterr().out
    assert "times are CET." in said
    assert "2026-11-21 09:00" in said
    assert run_guarded(["runs", "--csv", str(tmp_path / "runs.csv"), "--database", url]) == 0
    assert "2026-11-21T08:00:00.123456+00:00" in (tmp_path / "runs.csv").read_text()
