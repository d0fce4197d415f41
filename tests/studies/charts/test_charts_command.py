"""``charts`` on stored runs, and what the report of a run says of its station's charts."""

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest
from filled_databases import filled
from stored_lots import store_run
from stored_runs import identity

from cbsr_qa.app.station_charts import charts_after
from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.domain.run.station import StationCheck
from cbsr_qa.report.station import chart_blocks
from cbsr_qa.report.tables import number
from cbsr_qa.stats.control_charts import Standard, cusum, ewma, individuals, means_and_ranges
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.charts.charting import JOINED, STANDS

STATION, LIMIT = "bench-a", Limit("force_gain", "N/V", 8.0, 12.0)


def values(count=40, shift=0.0, after=30, seed=5):
    random = np.random.default_rng(seed)
    return 10 + 0.1 * random.standard_normal(count) + shift * (np.arange(count) >= after)


def measured(value, unit="N/V"):
    return (Measurement("force_gain", value, unit), Measurement("drift", 0.1, "1"))


def judged(value, unit="N/V"):
    first, second = measured(value, unit)
    return (first.judge(LIMIT) if unit == "N/V" else first, second)


def fill(path, numbers, **changes):
    options = ({"station": STATION, "day": k} | changes for k in range(len(numbers)))
    return filled(
        path, [(f"S-{k:03d}", judged(float(x)), of) for k, (x, of) in enumerate(zip(numbers, options, strict=True))]
    )


@pytest.fixture(scope="module")
def shifted(tmp_path_factory):
    """Thirty runs that are well, then ten with 0.8 more: eight deviations."""
    path = tmp_path_factory.mktemp("charts") / "runs.db"
    return path, fill(path, values(shift=0.8))


@pytest.fixture
def command(run_command):
    return partial(run_command, "charts", "--database")


@pytest.fixture
def document(command):
    def run(database, *arguments):
        code, out, err = command(database, "--station", STATION, "--json", *arguments)
        assert code in (0, 1), err
        found = json.loads(out)
        assert found["in_control"] is (code == 0)
        return found

    return run


NEW = ("--reference-runs", 30, "--operator", "Zoë")


def test_without_a_station_the_charts_of_all_are_listed(shifted, tmp_path, command):
    path = tmp_path / "runs.db"
    shutil.copy(shifted[0], path)
    assert "No station is charted" in command(path)[1]
    code, _, err = command(path, "--station", STATION, *NEW)
    assert code in (0, 1), err
    code, out, _ = command(path)
    assert code == 0
    assert "1 station with charts" in out
    assert STATION in out
    (listed,) = json.loads(command(path, "--json")[1])["charted"]
    assert (listed["station"], listed["chart"], listed["golden"]) == (STATION, "i-mr", None)
    assert listed["metrics"] == ["force gain"]
    code, _, err = command(path, "--metric", "force_gain")
    assert code == 2
    assert "--metric without --station" in err


def test_a_shift_is_found_at_its_first_run(shifted, document):
    path, runs = shifted
    (chart,) = document(path, *NEW, "--dry-run")["charts"]
    assert chart["signal"]["since_run"] == runs[30]
    assert (chart["signal"]["runs"], chart["reference_runs"]) == (10, 30)
    assert any(rule.startswith("1: one point beyond 3σ") for rule in chart["signal"]["rules"])
    truth = individuals(values(shift=0.8)[:30])
    assert chart["reference"]["mean"] == pytest.approx(truth.centre, rel=1e-12)
    assert chart["reference"]["deviation"] == pytest.approx(truth.deviation, rel=1e-12)
    assert chart["values"] == pytest.approx(list(values(shift=0.8)))


@pytest.mark.parametrize("kind", ["ewma", "cusum", "xbar-r"])
def test_the_other_charts_have_the_points_of_their_definition(shifted, document, kind):
    path, runs = shifted
    (chart,) = document(path, *NEW, "--dry-run", "--chart", kind)["charts"]
    numbers = values(shift=0.8)
    standard = Standard(chart["reference"]["mean"], chart["reference"]["deviation"])
    truth = {
        "ewma": lambda: ewma(numbers[30:], reference=standard),
        "cusum": lambda: cusum(numbers[30:], reference=standard)[0],
        "xbar-r": lambda: means_and_ranges(numbers[30:].reshape(2, 5), reference=standard)[0],
    }[kind]()
    monitored = next(one for one in chart["charts"] if one["phase"] == "monitored")
    assert monitored["points"] == pytest.approx(list(truth.points))
    assert chart["reference"]["mean"] == pytest.approx(numbers[:30].mean())
    assert chart["signal"] is not None
    if kind == "xbar-r":
        assert monitored["runs"] == [runs[34], runs[39]]


@pytest.mark.rest
def test_a_reference_is_stored_with_who_and_why_and_another_one_beside_it(tmp_path, refusal, document):
    path = tmp_path / "runs.db"
    fill(path, values(shift=0.8, count=70))
    assert "no reference period is stored" in refusal("charts", "--database", path, "--station", STATION)
    assert document(path, *NEW, "--why", "after the move")["stored"]
    assert not document(path)["in_control"]
    second = ("--reference-from", "2026-12-21", "--reference-runs", 30, "--operator", "Ada")
    assert document(path, *second)["in_control"]
    assert document(path)["in_control"]
    with open_store(f"sqlite:///{path}") as store:
        old, new = store.charts.read_all(STATION)
        (holds,) = store.charts.read_current(STATION)
        assert store.charts.read_current(STATION, until=old.reference) == (old,)
    assert (old.operator, old.why, new.operator) == ("Zoë", "after the move", "Ada")
    assert holds == new


@pytest.mark.rest
def test_limits_of_charts_are_listed_with_what_they_were_before(tmp_path, document, capsys):
    path = tmp_path / "runs.db"
    fill(path, values(shift=0.8, count=70))

    def listed(*arguments):
        assert run_guarded(["db", "changes", "--database", str(path), *arguments]) == 0
        return capsys.readouterr().out

    assert "no limits of a control chart set" in listed()
    document(path, *NEW, "--why", "after the move")
    document(path, "--reference-from", "2026-12-21", "--reference-runs", 30, "--operator", "Ada", "--rules", "1")
    first, second = json.loads(listed("--json"))["chart_references"]
    assert (first["operator"], first["why"], first["earlier"]) == ("Zoë", "after the move", None)
    assert (second["operator"], second["why"], second["station"]) == ("Ada", "no reason given", STATION)
    assert second["earlier"]["reference"] == first["reference"]
    said = listed()
    assert f"limits of force gain, chart i-mr, on station {STATION}, by Ada" in said
    assert f"  set: mean {number(values()[:30].mean(), 4)} N/V\n" in said
    assert "  changed: mean " in said
    assert "  changed: settings rules 1, 2 → rules 1\n" in said


@pytest.mark.rest
def test_the_report_of_a_run_says_which_chart_signals(tmp_path, document):
    path = tmp_path / "runs.db"
    fill(path, values(count=30))
    document(path, *NEW)
    with open_store(f"sqlite:///{path}", durable=False) as store:
        run = store.new_id()
        here = replace(identity(run, "S-900"), station=STATION)
        found = charts_after(store, STATION, here, judged(10.9))
        (signal,) = found.signals
        assert (signal.since_run, signal.runs) == (run, 1)
        (warning,) = found.warnings()
        assert f"station {STATION} is out of control: force gain, chart i-mr, signals since" in warning
        assert "sensor S-900 on 2026-11-2" in warning
        assert "rule 1: one point beyond 3σ" in warning
        blocks = chart_blocks(found)
        assert "1 of 1 control chart" in blocks[0].text
        assert "1: one point beyond 3σ" in blocks[1].text
        assert charts_after(store, STATION, here, judged(10.0)).signals == ()
        assert charts_after(store, "bench-b", here, judged(10.9)) is None


@pytest.mark.parametrize(("kind", "runs", "at_least"), [("i-mr", 8, True), ("xbar-r", 6, False)])
def test_a_signal_is_of_at_least_some_runs_only_where_earlier_ones_were_not_looked_at(
    shifted, tmp_path, document, monkeypatch, kind, runs, at_least
):
    path, _ = shifted
    shutil.copy(path, tmp_path / "runs.db")
    document(tmp_path / "runs.db", *NEW, "--chart", kind)
    monkeypatch.setattr("cbsr_qa.app.chart_signals.LOOK_BACK", 8)
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}") as store:
        (signal,) = charts_after(store, STATION).signals
    assert (signal.runs, signal.at_least) == (runs, at_least)


@pytest.mark.rest
def test_a_signal_stands_until_enough_runs_gave_none(tmp_path, document):
    path = tmp_path / "runs.db"
    numbers = np.concatenate([values(count=30), [11.0], 10 + 0.05 * (-1.0) ** np.arange(STANDS)])
    runs = fill(path, numbers[:-1])
    found = document(path, *NEW)["charts"][0]["signal"]
    assert (found["since_run"], found["runs"]) == (runs[30], STANDS)
    assert found["rules"] == ["1: one point beyond 3σ"]
    with open_store(f"sqlite:///{path}", durable=False) as store:
        store_run(store, "S-999", judged(float(numbers[-1])), station=STATION, day=99)
    assert document(path)["in_control"]


@pytest.mark.rest
def test_signals_that_are_near_each_other_belong_together(tmp_path, document):
    path = tmp_path / "runs.db"
    well = 10 + 0.05 * (-1.0) ** np.arange(JOINED)
    near = np.concatenate([values(count=30), [11.0], well[:-1], [11.0]])
    runs = fill(path, near)
    assert document(path, *NEW)["charts"][0]["signal"]["since_run"] == runs[30]
    runs = fill(other := tmp_path / "other.db", np.concatenate([values(count=30), [11.0], well, [11.0]]))
    assert document(other, *NEW)["charts"][0]["signal"]["since_run"] == runs[-1]


@pytest.mark.rest
def test_golden_and_production_runs_have_charts_of_their_own(tmp_path, document):
    path = tmp_path / "runs.db"
    fill(path, values(count=30))
    with open_store(f"sqlite:///{path}", durable=False) as store:
        for k, value in enumerate(5 + 0.1 * np.random.default_rng(1).standard_normal(12)):
            store_run(store, "G-01", judged(float(value)), station=STATION, day=100 + k)
    (chart,) = document(path, "--golden", "G-01", "--reference-runs", 10, "--operator", "Zoë")["charts"]
    assert len(chart["values"]) == 12
    assert chart["reference"]["mean"] == pytest.approx(5, abs=0.2)
    assert "golden sensor G-01" in chart["label"]
    assert any("10 runs are uncertain" in note for note in chart["notes"])


@pytest.mark.rest
def test_runs_of_golden_sensors_are_no_production(tmp_path, document):
    path = tmp_path / "runs.db"
    runs = fill(path, values(count=20))
    with open_store(f"sqlite:///{path}", durable=False) as store:
        check = (store.new_id(), STATION, "Zoë", datetime.now(UTC), "disc-100mm", 64 * "a", (), (), ())
        store.stations.save_check(StationCheck(*check, golden_run=runs[7]))
    found = document(path, "--reference-runs", 15, "--operator", "Zoë")
    assert found["runs"] == 19
    assert runs[7] not in found["charts"][0]["runs"]


@pytest.mark.rest
def test_order_is_that_of_names_and_a_wrong_clock_is_named(tmp_path, document):
    path = tmp_path / "runs.db"
    fill(path, values(count=20))
    with open_store(f"sqlite:///{path}", durable=False) as store:
        late = store_run(store, "S-500", judged(10.0), station=STATION, day=-365)
        last = store_run(store, "S-501", judged(10.1), station=STATION, day=22)
    found = document(path, "--reference-runs", 15, "--operator", "Zoë")
    assert found["charts"][0]["runs"][-2:] == [late, last]
    assert any(f"clock of station {STATION} was wrong by about 1.1 years" in note for note in found["notes"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--station", "bench-q", *NEW), "no stored run is of station 'bench-q' did you mean 'bench-a'?"),
        (("--station", STATION, "--recipe", "shirt", *NEW), "did you mean 'short'?"),
        (("--station", STATION, "--metric", "force_gian", *NEW), "did you mean 'force_gain'?"),
        (("--station", STATION, "--metric", "force_gian"), "did you mean 'force_gain'?"),
        (("--station", STATION, "--metric", "drift", *NEW), "all 30 values of the reference period are 0.1"),
        (("--station", STATION, "--reference-runs", 30), "give --operator"),
        (("--station", STATION, "--reference-runs", 3, "--operator", "Zoë"), "too short"),
        (("--station", STATION, "--reference-runs", 300, "--operator", "Zoë"), "instead of 300"),
        (("--station", STATION, "--reference-from", "2026-11-22", "--operator", "Zoë"), "has no end"),
        (("--station", STATION, *NEW, "--part", "sheet=LOT7"), "holds for all sensors of the station"),
        (("--station", STATION, *NEW, "--chart", "pie"), "allowed: i-mr, xbar-r, ewma, cusum"),
        (("--station", STATION, *NEW, "--rules", "1,9"), "allowed: 1 to 8"),
        (("--station", STATION, *NEW, "--rules", "one"), "numbers from 1 to 8"),
        (("--station", STATION, *NEW, "--subgroup", 4), "none with another chart"),
        (("--station", STATION, *NEW, "--chart", "ewma", "--rules", "1,2"), "--rules with --chart ewma"),
        (("--station", STATION, "--chart", "ewma", "--rules", "1,2,5"), "--chart, --rules can only be given"),
        (("--station", STATION, "--operator", "Zoë", "--dry-run"), "--operator, --dry-run can only be given"),
        (("--station", STATION, "--reference-runs", 12, "--operator", "Zoë", "--chart", "xbar-r"), "of 5 give 15"),
        (("--station", STATION, "--reference-runs", 22, "--operator", "Zoë", "--chart", "xbar-r"), "give 20 or 25"),
        (("--station", STATION, *NEW, "--golden", "G-7"), "no analysed run of sensor 'G-7'"),
        (("--station", STATION, "--reference-from", "2036-11-22", *NEW), "has no run since 2036"),
    ],
)
def test_what_cannot_be_charted_is_refused_by_name(shifted, refusal, arguments, words):
    assert words in refusal("charts", "--database", shifted[0], *arguments)
    with open_store(f"sqlite:///{shifted[0]}") as store:
        assert store.charts.read_all(STATION) == ()


def test_groups_of_a_reference_are_whole_and_what_is_left_is_said(shifted, refusal, document):
    path, runs = shifted
    until = (identity("x").started_at + timedelta(days=21)).date()
    asked = ("--reference-until", until, "--operator", "Zoë", "--dry-run", "--chart", "xbar-r")
    (chart,) = document(path, *asked)["charts"]
    assert (chart["reference"]["runs"], chart["reference"]["last_run"]) == (20, runs[19])
    assert "the last 2 runs of the reference period do not fill a group of 5: taken as after it" in chart["notes"]
    (chart,) = document(path, *asked, "--subgroup", 6)["charts"]
    assert "the latest 4 runs do not fill a group of 6 yet, and make no point" in chart["notes"]
    said = refusal("charts", "--database", path, "--station", STATION, *asked, "--subgroup", 8)
    assert "22 runs in the reference period make 2 whole groups of 8 instead of 3" in said


def test_a_reference_period_is_named_by_its_days(shifted, command):
    path, _ = shifted
    first = identity("x").started_at.date()
    out = command(path, "--station", STATION, *NEW, "--dry-run")[1]
    said = " ".join(out.split())
    assert f"the reference period begins with the station's first run ({first}); --reference-from" in said
    assert f"30 runs, {first} to {first + timedelta(days=29)} 10 signals since {first + timedelta(days=30)}" in said
    later = command(path, "--station", STATION, *NEW, "--reference-from", first + timedelta(days=5), "--dry-run")[1]
    assert "first run (" not in later
    assert f"30 runs, {first + timedelta(days=5)} to" in " ".join(later.split())


def test_a_note_that_every_chart_has_is_on_the_page_once(tmp_path, command):
    noise = 0.01 * np.random.default_rng(6).standard_normal(12)
    runs = (
        (Measurement("force_gain", float(gain), "N/V"), Measurement("drift", 0.1 + float(drift), "1"))
        for gain, drift in zip(values(count=12), noise, strict=True)
    )
    filled(tmp_path / "runs.db", [(f"S-{k}", run, {"station": STATION, "day": k}) for k, run in enumerate(runs)])
    asked = ("--station", STATION, "--reference-runs", 10, "--dry-run")
    assert command(tmp_path / "runs.db", *asked, "--output", tmp_path / "page.html")[0] == 0
    page = (tmp_path / "page.html").read_text()
    assert page.count("<svg") == 2
    assert page.count("runs are uncertain") == 1


def test_the_page_draws_the_charts(shifted, command, tmp_path):
    code, out, _ = command(shifted[0], "--station", STATION, *NEW, "--dry-run", "--output", tmp_path / "page.html")
    assert code == 1
    page = (tmp_path / "page.html").read_text()
    assert "1 of 1 chart of" in page
    assert "moving range" in page
    assert out.startswith("✗ Out of control: 1 of 1 chart of station bench-a signals; the first: force")
    until = (identity("x").started_at + timedelta(days=29)).date()
    other = command(shifted[0], "--station", STATION, "--reference-until", until, "--dry-run")[1]
    assert "30 runs, " in other
