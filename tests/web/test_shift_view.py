"""The shift view draws the charts of its stations, those that signal first, and fetches nothing for them."""

import re
from base64 import b64decode
from dataclasses import replace
from datetime import timedelta
from xml.etree import ElementTree

import numpy as np
import pytest
from filled_databases import filled
from stored_lots import store_run
from stored_runs import SETTING

from cbsr_qa.domain.plan.limits import Limit, Outcome
from cbsr_qa.domain.results.measurement import Measurement, Verdict
from cbsr_qa.domain.run.events import RunStarted
from cbsr_qa.domain.run.states import EndReason
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.charts.charts import control_charts
from cbsr_qa.studies.charts.request import ChartsRequest, ReferencePeriod
from cbsr_qa.web.line import Line
from cbsr_qa.web.pages import Pages
from cbsr_qa.web.shift import run_page, sensor_page, shift_page

_STEADY, _SHIFTED = Limit("drift", "1", None, 1.0), Limit("force_gain", "N/V", 8.0, 12.0)


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    """Thirty runs of station A that are well, then ten with another gain: its second chart signals."""
    random = np.random.default_rng(3)
    runs = []
    for number in range(40):
        gain, drift = 10 + 0.1 * random.standard_normal(2)
        gain += 0.8 * (number >= 30)
        values = Measurement("drift", drift / 100, "1").judge(_STEADY), Measurement("force_gain", gain, "N/V")
        measured = (values[0], values[1].judge(_SHIFTED))
        runs.append((f"S-{number:03d}", measured, {"station": "A", "day": number}))
    path = str(tmp_path_factory.mktemp("shift") / "runs.db")
    filled(path, runs)
    control_charts(ChartsRequest("A", period=ReferencePeriod(None, 30, None), operator="q"), database=path)
    return path


def test_charts_are_drawn_the_one_that_signals_first(database):
    (view,) = shift_page(database, ("A", "B"))["charts"]
    assert (view.station, view.banner.tone, view.left) == ("A", "fail", 0)
    assert [picture.title for picture in view.pictures] == ["Force gain, chart i-mr [N/V]", "Drift, chart i-mr"]
    for picture in view.pictures:
        svg = b64decode(picture.source.removeprefix("data:image/svg+xml;base64,"))
        assert ElementTree.fromstring(svg).tag.endswith("svg")
    assert shift_page(database, ("B",))["charts"] == ()


def test_the_page_says_how_stations_stand_and_fetches_no_chart(database):
    pages = Pages(Line((), database))
    shown = pages.page("shift", control=True, here="shift", **shift_page(database, ("A",)))
    assert shown.count("Out of control") == 2  # among the stations, and at the charts
    assert all(source.startswith("data:") for source in re.findall(r'<img src="([^"]*)"', shown))
    without = pages.page("shift", control=True, here="shift", **shift_page(database, ("B",)))
    assert "No station has control charts yet" in without


def test_a_run_over_midnight_is_of_both_days(tmp_path, monkeypatch):
    """Runs take 201 s here; one that ended before midnight is of today only if it was resumed, or still runs."""
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        names = [store_run(store, f"S-{number}", (), station="A", end=EndReason.ABORTED) for number in range(3)]
        began = store.live.find_run(names[0]).started_at
        resumed = replace(store.runs.read_identity(names[1]), started_at=began + timedelta(hours=2))
        store.open_journal(configuration=store.runs.read_configuration(names[1]), **SETTING)(RunStarted(resumed))

    def listed(midnight, *in_progress):
        monkeypatch.setattr("cbsr_qa.app.shift.summary.local_day", lambda: (midnight, midnight + timedelta(days=1)))
        return [run.run for run in shift_page(url, ("A",), frozenset(in_progress))["runs"]]

    assert listed(began - timedelta(hours=1)) == names[::-1]
    assert listed(began + timedelta(seconds=200)) == names[::-1]
    assert listed(began + timedelta(seconds=202)) == [names[1]]
    assert listed(began + timedelta(seconds=202), names[0]) == [names[1], names[0]]
    assert listed(began + timedelta(hours=3)) == []


def test_a_failed_sensor_has_failed_while_it_is_tested_again(tmp_path, monkeypatch):
    """Of four sensors one passed, one failed, one failed and is tested again, one was stopped."""
    codes = {
        "drift": {"code": "N2", "text": "drifts", "disposition": "scrap"},
        "aborted": {"code": "M2", "text": "s"},
    }
    codes["aborted"]["disposition"] = "retest"
    own = {"station": "A", "tables": {"failure_codes": codes}}
    drifts = tuple(Measurement("drift", value, "1", location=f"L{value:g}").judge(_STEADY) for value in (2.0, 3.0))
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        store_run(store, "S-1", (), **own, verdict=Verdict(Outcome.PASS, "so"))
        store_run(store, "S-2", drifts, **own)
        store_run(store, "S-3", drifts, **own)
        again = store_run(store, "S-3", (), end=EndReason.ABORTED, **own)
        store_run(store, "S-4", (), end=EndReason.ABORTED, **own)
        began = store.live.find_run(again).started_at
    midnight = began - timedelta(hours=1)
    monkeypatch.setattr("cbsr_qa.app.shift.summary.local_day", lambda: (midnight, midnight + timedelta(days=1)))
    content = shift_page(url, ("A",), frozenset([again]))
    handover, total = content["handover"], content["summary"].total
    assert (handover.passed, len(handover.failed), len(handover.running)) == (1, 2, 1)
    assert (total.test_yield.passed, total.test_yield.count) == (1, 3)
    assert (total.first_pass_yield.passed, total.first_pass_yield.count) == (1, 3)
    assert [(code.code, code.sensors) for code in content["codes_given"]] == [("N2", 2)]
    assert content["sentence"].endswith(" Failed: S-3 N2: scrap; S-2 N2: scrap.")
    shown = Pages(Line((), url)).page("shift", control=True, here="shift", **content)
    assert "2 limits failed; the worst: " in shown
    undecided = shown.partition("Sensors without a verdict</h2>")[2].partition("</table>")[0]
    assert "S-4" in undecided
    assert "resume the run" in undecided
    assert "Retest" not in undecided


def test_the_pages_of_a_sensor_that_passed_say_which_failure_stands_and_what_to_do(tmp_path):
    codes = {"drift": {"code": "N2", "text": "drifts", "disposition": "scrap"}}
    drifts = (Measurement("drift", 2.0, "1").judge(_STEADY),)
    passed, url = Verdict(Outcome.PASS, "so"), f"sqlite:///{tmp_path / 'runs.db'}"
    words = "This sensor failed with strict at line-7, just now: a pass with usual does not change that. "
    words += "What to do: Scrap."
    with open_store(url, durable=False) as store:
        store_run(store, "S-1", drifts, recipe="strict", station="line-7", tables={"failure_codes": codes})
        run = store_run(store, "S-1", (), recipe="usual", verdict=passed)
        assert (run_page(url, run)["standing"], sensor_page(url, "S-1")["standing"]) == (words, words)
        for view, content in (("run", run_page(url, run)), ("sensor", sensor_page(url, "S-1"))):
            shown = Pages(Line((), url)).page(view, control=True, here="", **content)
            assert (words in shown, "those that passed" in shown) == (True, False)
        store_run(store, "S-1", (), recipe="strict", verdict=passed)
        assert (run_page(url, run)["standing"], sensor_page(url, "S-1")["standing"]) == ("", "")


def test_a_sensor_that_passed_today_is_handed_over_as_failed_while_an_earlier_failure_stands(tmp_path, monkeypatch):
    drifts = (Measurement("drift", 2.0, "1").judge(_STEADY),)
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        failed = store_run(store, "S-1", drifts, recipe="strict", station="A")
        runs = [
            store_run(store, f"S-{number}", (), recipe="usual", station="A", day=1, verdict=Verdict(Outcome.PASS, ""))
            for number in (1, 2)
        ]
        midnight = store.live.find_run(runs[0]).started_at - timedelta(hours=1)
    monkeypatch.setattr("cbsr_qa.app.shift.summary.local_day", lambda: (midnight, midnight + timedelta(days=1)))
    content = shift_page(url, ("A",))
    assert [run.run for run in content["runs"]] == runs[::-1]
    assert ([state.last.run for state in content["handover"].failed], content["handover"].passed) == ([failed], 1)


def test_the_page_of_a_run_has_all_limits_that_decided_it_and_what_to_do(tmp_path):
    codes = {"drift": {"code": "N2", "text": "drifts", "disposition": "scrap"}}
    drifts = tuple(
        Measurement("drift", value, "1", location=f"L{value:g}").judge(_STEADY) for value in (2.0, 3.0, 0.0)
    )
    url = f"sqlite:///{tmp_path / 'runs.db'}"
    with open_store(url, durable=False) as store:
        failed = store_run(store, "S-1", drifts, tables={"failure_codes": codes})
        passed = store_run(store, "S-2", drifts[-1:], verdict=Verdict(Outcome.PASS, "so"))
    content = run_page(url, failed)
    assert [limit.partition(" (allowed")[0] for limit in content["limits"]] == ["drift (L3) is 3", "drift (L2) is 2"]
    shown = Pages(Line((), url)).page("run", control=True, here="", **content)
    assert "Failed limits: 2, the worst first" in shown
    assert "What to do: <strong>Scrap.</strong>" in shown
    assert run_page(url, passed)["limits"] == ()
