"""What ``gauge`` says of runs that are no study, and of numbers that were meant otherwise."""

import json
import re
from functools import partial

import numpy as np
import pytest
from matplotlib.figure import Figure as Canvas
from stored_lots import store_run
from test_gauge_command import LIMIT, SENSORS, STATIONS, expected, fill, measured, runs

from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.stats.gauge.anova import gauge_anova
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.gauge import figures

pytestmark = pytest.mark.rest


@pytest.fixture
def command(run_in_words):
    return partial(run_in_words, "gauge")


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    fill(path := tmp_path_factory.mktemp("gauge") / "runs.db", runs(trials=3))
    return path


@pytest.mark.parametrize("wrong", ["0.95", "0", "50", "100", "nan"])
def test_a_confidence_is_in_per_cent(crossed, refusal, tmp_path, wrong):
    said = refusal("gauge", "--recipe", "short", "--confidence", wrong, "--database", crossed)
    assert "allowed: above 50 and below 100 %; give per cent, 95 for 95 %" in said
    study = tmp_path / "study.toml"
    study.write_text(f'[study]\nname = "g"\nrecipe = "short"\nconfidence_percent = {wrong}\n')
    assert "line 4: study.confidence_percent is" in refusal("gauge", study, "--database", crossed)


@pytest.mark.parametrize("option", [(), ("--largest-balanced",)])
@pytest.mark.parametrize("whole", [True, False])
def test_sensors_that_were_run_once_have_no_repeatability(tmp_path, refusal, option, whole):
    """Crossed once, or each sensor on one station: no choice of these runs is a study."""
    rows = [row for row in runs(trials=1) if whole or STATIONS[int(row[0][2:]) % 3] == row[1]]
    fill(tmp_path / "runs.db", rows)
    said = refusal("gauge", "--recipe", "short", "--database", tmp_path / "runs.db", *option)
    assert "every sensor was run once on a station: repeatability needs at least two runs of each" in said
    assert "uneven" not in said
    assert "--largest-balanced" not in said


def test_no_two_sensors_on_the_same_two_stations_is_said(tmp_path, refusal):
    rows = [row for row in runs() if STATIONS[int(row[0][2:]) % 3] == row[1]]
    fill(tmp_path / "runs.db", rows)
    said = refusal("gauge", "--recipe", "short", "--largest-balanced", "--database", tmp_path / "runs.db")
    assert "no two sensors were run twice each on the same two stations: nothing is crossed" in said


def test_a_metric_in_several_units_in_every_run_has_no_study(tmp_path, refusal):
    odd = (*measured((9.0,) * 2)[:1], Measurement("force_gain", 9e-3, "kN/V", None, "grid", "L1"))
    fill(other := tmp_path / "other.db", [])
    with open_store(f"sqlite:///{other}", durable=False) as store:
        names = [store_run(store, serial, odd, station=station) for serial, station, *_ in runs()]
    said = refusal("gauge", "--recipe", "short", "--metric", "force_gain", "--database", other)
    assert "none of these runs has a value of it; left out: its values are in several units" in said
    assert names[0] in said


def test_stability_of_few_runs_has_no_verdict_of_a_chart(tmp_path, crossed, command):
    given = ("--recipe", "short", "--reference", "S-01.force_gain=10±0.02", "--database")
    out = command(*given, crossed)[1]
    assert out.count("fewer than 8 runs") == 3
    assert "in control" not in out
    (metric,) = json.loads(command("--json", *given, crossed)[1])["metrics"]
    assert {line["in_control"] for line in metric["references"]["stability"]} == {None}
    fill(tmp_path / "runs.db", [row for row in runs(trials=8) if row[0] in SENSORS[:2]])
    out = command(*given, tmp_path / "runs.db")[1]
    assert "fewer than" not in out
    (metric,) = json.loads(command("--json", *given, tmp_path / "runs.db")[1])["metrics"]
    assert None not in {line["in_control"] for line in metric["references"]["stability"]}


def test_a_stated_uncertainty_widens_the_bias_and_is_said(crossed, command):
    found = []
    for stated in ("", "±0.001", "±0.02", "±0.2"):
        given = ("--recipe", "short", "--reference", f"S-01.force_gain=10{stated} N/V", "--database", crossed)
        (metric,) = json.loads(command("--json", *given)[1])["metrics"]
        found.append([(b["bias"]["high"] - b["bias"]["low"], b["bias"]["p"]) for b in metric["references"]["bias"]])
    assert np.all(np.diff(np.array(found), axis=0) > 0)
    assert re.search(r"S-01 +bench-a +10\.00 ± 0\.20 +3 ", command(*given)[1])


def test_the_page_has_references_in_tables(crossed, command, tmp_path):
    given = ["--reference", "S-01.force_gain=10±0.02", "--reference", "S-02.force_gain=9"]
    code, _, err = command("--recipe", "short", *given, "--output", tmp_path / "page.html", "--database", crossed)
    assert code == 0, err
    page = (tmp_path / "page.html").read_text()
    tables = re.findall(r"<table.*?</table>", page, re.S)
    for caption, rows in (("Bias against reference", 6), ("Linearity of the bias", 3), ("Stability over time", 6)):
        (table,) = [one for one in tables if caption in one]
        assert table.count("<tr") == rows + 1
    assert "Bias of S-01 on" not in page


@pytest.mark.parametrize(("known", "depends"), [("", "yes"), ("±1", "not significant")])
def test_the_page_says_whether_the_bias_depends_on_the_value_measured(crossed, command, tmp_path, known, depends):
    given = ["--reference", f"S-01.force_gain=11{known}", "--reference", f"S-02.force_gain=8{known}"]
    command("--recipe", "short", *given, "--output", tmp_path / "page.html", "--database", crossed)
    table = (tmp_path / "page.html").read_text().partition("Linearity of the bias")[2].partition("</table>")[0]
    rows = [re.findall("<bdi>(.*?)</bdi>", row) for row in table.split("<tr")[2:]]
    assert [cells[-2] for cells in rows] == [depends] * 3


def test_legends_cover_no_panel_and_every_panel_has_its_axis_named(monkeypatch):
    drawn: list[Canvas] = []
    keep = figures.canvas
    monkeypatch.setattr(figures, "canvas", lambda height: drawn.append(keep(height)) or drawn[-1])
    study = expected()
    figures.draw_panels(study, gauge_anova(study, tolerance=LIMIT.upper - LIMIT.lower).components, "N/V")
    (figure,) = drawn
    renderer = figure.canvas.get_renderer() if hasattr(figure.canvas, "get_renderer") else None
    panels = [axes.get_window_extent() for axes in figure.axes]
    legends = [axes.get_legend().get_window_extent(renderer) for axes in figure.axes if axes.get_legend()]
    assert len(legends) == 2
    assert not any(legend.overlaps(panel) for legend in legends for panel in panels)
    assert all(legend.y0 >= 0 for legend in legends)
    assert {axes.get_ylabel() for axes in figure.axes} == {
        "share [%]", "each run [N/V]", "range [N/V]", "mean [N/V]"
    }  # fmt: skip
