"""What ``charts`` says: where a shift began, whose limits hold, what is retired, and why there are none."""

import json
from datetime import timedelta
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from stored_lots import store_run
from stored_runs import identity
from test_charts_command import NEW, STATION, fill, judged, values

from cbsr_qa.app.station_charts import charts_after
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.charts.report import _banner

pytestmark = pytest.mark.rest


@pytest.fixture
def command(run_in_words):
    return partial(run_in_words, "charts", "--station", STATION, "--database")


@pytest.fixture
def refused(refusal):
    return partial(refusal, "charts", "--station", STATION, "--database")


@pytest.mark.parametrize("sign", [1, -1])
def test_a_sum_says_when_the_change_began(tmp_path, command, sign):
    """Ten runs the other way, then 1.5 deviations: the sum left zero at the first of them, and signals later."""
    numbers = np.concatenate([values(count=30), 10 - sign * 0.1 * np.ones(10), 10 + sign * 0.15 * np.ones(12)])
    runs = fill(tmp_path / "runs.db", numbers)
    asked = (*NEW, "--dry-run", "--chart", "cusum")
    signal = json.loads(command(tmp_path / "runs.db", *asked, "--json")[1])["charts"][0]["signal"]
    assert signal["began_run"] == runs[40]
    assert runs[40] < signal["since_run"] < runs[51]
    day = (identity("x").started_at + timedelta(days=40)).date()
    assert signal["began"].startswith(f"{day}T")
    said = command(tmp_path / "runs.db", *asked)[1]
    assert f"the change began at about the run of sensor S-040 on {day} " in said
    other = json.loads(command(tmp_path / "runs.db", *NEW, "--dry-run", "--json")[1])["charts"][0]["signal"]
    assert other is None or (other["began_run"], other["began"]) == (None, None)


def test_a_sum_that_was_never_zero_began_with_the_first_run(tmp_path, command):
    runs = fill(tmp_path / "runs.db", np.concatenate([values(count=30), 10.15 * np.ones(12)]))
    asked = (*NEW, "--dry-run", "--chart", "cusum", "--json")
    assert json.loads(command(tmp_path / "runs.db", *asked)[1])["charts"][0]["signal"]["began_run"] == runs[30]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("i-mr", "Limits are three deviations from the mean (i-mr);"),
        ("xbar-r", "Limits are three deviations of a group&#39;s mean from the mean (xbar-r);"),
        ("ewma", "Limits are 3 deviations of the average from the mean (ewma);"),
        ("cusum", "Limits are 5 deviations from zero (cusum);"),
    ],
)
def test_the_page_says_where_limits_are_and_whose(tmp_path, command, kind, words):
    fill(tmp_path / "runs.db", values(shift=0.8))
    out = command(
        tmp_path / "runs.db", "--reference-runs", 30, "--dry-run", "--chart", kind, "--output", tmp_path / "page.html"
    )[1]
    page = (tmp_path / "page.html").read_text()
    assert words in page
    assert "Orange: points that break a rule" in page
    assert f"{kind} set on " in out
    assert f"force gain, chart {kind} N/V " in out


@pytest.mark.parametrize(
    ("kind", "share"),
    [
        ("i-mr", "% of undisturbed runs are beyond them, instead of 0.27 %"),
        ("ewma", "% of undisturbed runs are beyond them, instead of 0.27 %"),
        ("cusum", "and false signals are several times as frequent"),
    ],
)
def test_a_reference_whose_runs_are_like_their_neighbours_is_doubted(tmp_path, command, kind, share):
    random = np.random.default_rng(30)
    noise = random.standard_normal(40)
    wandering = 10 + 0.1 * np.array([0.7 ** np.arange(n + 1) @ noise[n::-1] for n in range(40)])
    fill(tmp_path / "wandering.db", wandering)
    asked = ("--reference-runs", 40, "--dry-run", "--chart", kind)
    said = command(tmp_path / "wandering.db", *asked)[1]
    assert "values of the reference period are alike (correlation 0." in said
    assert share in said
    fill(tmp_path / "steady.db", 10 + 0.1 * noise)
    assert "alike (correlation" not in command(tmp_path / "steady.db", *asked)[1]


def test_other_charts_of_a_metric_hold_on_until_they_are_retired(tmp_path, command, capsys):
    path = tmp_path / "runs.db"
    fill(path, values(shift=0.8))
    for kind in ("i-mr", "cusum"):
        command(path, *NEW, "--chart", kind)
    assert "2 of 2 charts" in command(path)[1]
    code, out, err = command(path, "--retire", "cusum", "--operator", "Ada", "--why", "one chart is enough")
    assert code == 1, err
    assert "retired by Ada: force gain, chart cusum; a new reference starts them again" in out
    assert "1 of 1 chart" in out
    with open_store(f"sqlite:///{path}") as store:
        assert [str(one.chart) for one in store.charts.read_current(STATION)] == ["i-mr"]
        first, _, last = store.charts.read_all(STATION)
        assert (first.retired, last.retired, last.operator, last.why) == (False, True, "Ada", "one chart is enough")
        # What held before holds for what was made before.
        assert len(store.charts.read_current(STATION, until=store.charts.read_all(STATION)[1].reference)) == 2
    assert run_guarded(["db", "changes", "--database", str(path)]) == 0
    assert "retired: nothing is charted against these limits from here on" in capsys.readouterr().out
    page = tmp_path / "page.html"
    assert command(path, "--retire", "i-mr", "--operator", "Ada", "--output", page)[0] == 0
    assert "Nothing is charted now." in page.read_text()
    with open_store(f"sqlite:///{path}") as store:
        assert charts_after(store, store.runs.find()[0].station) is None
    assert "no reference period is stored" in command(path)[2]
    assert command(path, *NEW, "--chart", "cusum")[0] == 1
    assert "1 of 1 chart" in command(path)[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--retire", "cusum", "--operator", "Ada"), "no chart cusum of these metrics holds on this station"),
        (("--retire", "cusum", "--operator", "Ada"), "charts that hold are i-mr"),
        (("--retire", "i-mr"), "the operator who retires these charts is not named"),
        (("--retire", "pie", "--operator", "Ada"), "--retire 'pie' is not known allowed: i-mr, xbar-r, ewma, cusum"),
        (("--retire", "i-mr", *NEW), "--retire beside a new reference period"),
        (
            ("--retire", "i-mr", "--operator", "Ada", "--dry-run"),
            "--dry-run can only be given with a new reference period",
        ),
    ],
)
def test_what_cannot_be_retired_is_refused(tmp_path, command, refused, arguments, words):
    path = tmp_path / "runs.db"
    fill(path, values(count=30))
    command(path, *NEW)
    assert words in refused(path, *arguments)
    with open_store(f"sqlite:///{path}") as store:
        assert len(store.charts.read_all(STATION)) == 1


def test_runs_without_measurements_are_said(tmp_path, refused):
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        for day in range(9):
            store_run(store, "S-01", (), station=STATION, day=day)
    for option in ((), ("--metric", "force_gain")):
        said = refused(tmp_path / "runs.db", "--reference-runs", 8, "--dry-run", *option)
        assert said == "cbsr-qa: none of these runs has measurements choose runs that were finished"


def test_units_that_are_mixed_within_a_run_are_named_with_it(tmp_path, command):
    path = tmp_path / "runs.db"
    fill(path, values(count=20))
    odd = (*judged(11.0)[:1], Measurement("force_gain", 0.01, "kN/V"))
    command(path, "--reference-runs", 15, "--operator", "Zoë")
    with open_store(f"sqlite:///{path}", durable=False) as store:
        run = store_run(store, "S-700", odd, station=STATION, day=30)
        # At the end of a run too: it is no value there, neither of its units alone.
        there = store.runs.read_identity(run)
        assert (
            charts_after(store, there.station).signals == charts_after(store, there.station, there, odd).signals == ()
        )
    out = command(path)[1]
    assert "values are in several units within the run, N/V and kN/V: S-700, " in out
    assert "could not be measured" not in out


def test_what_was_left_out_of_a_reference_that_is_too_short_is_said(tmp_path, refused):
    fill(tmp_path / "runs.db", values(count=20))
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        store_run(store, "S-600", judged(10.0, "kN/V"), station=STATION, day=30)
    asked = ("--reference-runs", 21, "--operator", "Zoë", "--metric", "force_gain")
    said = refused(tmp_path / "runs.db", *asked)
    assert "20 runs in the reference period instead of 21; left out: in kN/V instead of N/V: S-600" in said


def test_a_file_that_is_no_page_is_refused_before_a_reference_is_stored(tmp_path, command, refused):
    database = tmp_path / "runs.db"
    fill(database, values(count=40))
    assert "runs.db: not an HTML page" in refused(database, *NEW, "--output", database)
    with open_store(f"sqlite:///{database}") as store:
        assert store.charts.read_current(STATION) == ()
    command(database, *NEW)
    with open_store(f"sqlite:///{database}") as store:
        assert len(store.charts.read_current(STATION)) == 1


@pytest.mark.parametrize(
    ("count", "words"), [(1, "1 of 3 charts of station A signals"), (2, "2 of 3 charts of station A signal")]
)
def test_several_charts_signal_and_one_signals(count, words):
    signals = tuple(SimpleNamespace(since=k, words=lambda: "drift") for k in range(count))
    found = SimpleNamespace(station="A", in_control=False, signals=signals)
    assert _banner(found, 3).reason == f"{words}; the first: drift"
