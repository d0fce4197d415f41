"""``gauge STUDY.toml``: the file says what is studied, and what is wrong with it is said with its line."""

import hashlib
import html
import json
import re
from pathlib import Path

import pytest
from stored_lots import store_run
from test_gauge_command import LIMIT, expected, fill, measured, runs

from cbsr_qa.cli.main import run_guarded
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.stats.gauge.anova import gauge_anova
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.gauge.references import ReferenceTable
from cbsr_qa.studies.gauge.request import MetricTable, StudyFile, StudyTable

STUDY = """\
[study]
name = "gain, autumn"
recipe = "short"
serials = ["S-01", "S-02", "S-03", "S-04"]
stations = ["bench-a", "bench-c"]
since = 2026-11-01
until = 2026-11-30

[[metrics]]
name = "force_gain"
unit = "N/V"
lower = 9.0
upper = 11.0

[[reference]]
serial = "S-01"
metric = "force_gain"
unit = "N/V"
value = 10.0
uncertainty = 0.02
"""


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    """Six sensors on three stations twice in autumn, and once more a year later."""
    path = tmp_path_factory.mktemp("study") / "runs.db"
    fill(path, runs())
    with open_store(f"sqlite:///{path}", durable=False) as store:
        for serial, station, _, values in runs(seed=4, trials=1):
            store_run(store, serial, measured(values), station=station, day=365)
        store_run(store, "S-09", measured((9.0, 9.1)), station="bench-d", recipe="other")
    return path


@pytest.fixture
def studied(crossed, tmp_path, run_command):
    """Study a file; returns exit code, stdout and stderr."""

    def run(text, *arguments):
        path = tmp_path / "gain.toml"
        path.write_text(text)
        return run_command("gauge", path, "--database", crossed, *arguments)

    return run


@pytest.fixture
def document(studied):
    """Study a file; returns the document."""

    def run(text):
        code, out, err = studied(text, "--json")
        assert code == 0, err
        return json.loads(out)

    return run


def changed(*replacements):
    text = STUDY
    for old, new in replacements:
        assert old in text, old
        text = text.replace(old, new, 1)
    return text


@pytest.mark.rest
def test_the_study_is_of_what_the_file_names(document, tmp_path):
    found = document(STUDY)
    assert found["study"] == {
        "name": "gain, autumn",
        "file": str(tmp_path / "gain.toml"),
        "sha256": hashlib.sha256(STUDY.encode()).hexdigest(),
    }
    assert (found["since"], found["until"]) == ("2026-11-01", "2026-11-30")
    assert (found["sensors"], found["stations"]) == (["S-01", "S-02", "S-03", "S-04"], ["bench-a", "bench-c"])
    assert len(found["runs"]) == 4 * 2 * 2
    (metric,) = found["metrics"]
    limits = [metric[key] for key in ("tolerance", "tolerance_of", "lower", "upper")]
    assert limits == [2.0, "study", 9.0, 11.0]
    of = [row for row in runs() if row[0] in found["sensors"] and row[1] in found["stations"]]
    truth = gauge_anova(expected(of), tolerance=2.0).components.gauge
    gauge = metric["anova"]["components"]["gauge"]
    assert gauge["variance"] == pytest.approx(truth.variance, rel=1e-9)
    assert gauge["percent_tolerance"] == pytest.approx(truth.percent_tolerance, rel=1e-9)
    assert {(b["serial"], b["reference"], b["unit"]) for b in metric["references"]["bias"]} == {("S-01", 10.0, "N/V")}


@pytest.mark.rest
def test_page_and_terminal_say_what_was_studied(studied, tmp_path):
    code, out, err = studied(STUDY, "--output", tmp_path / "page.html")
    assert code == 0, err
    digest = hashlib.sha256(STUDY.encode()).hexdigest()
    for said in ((tmp_path / "page.html").read_text(), out):
        words = re.sub(r"\s+", " ", html.unescape(said))
        for wanted in ("gain, autumn", "gain.toml", digest, "from 2026-11-01 to 2026-11-30 (UTC)"):
            assert wanted in words
        assert "of the study's tolerance of 2.00 N/V" in words
        assert "10.000 ± 0.020" in words


@pytest.mark.parametrize(
    ("stated", "tolerance"),
    [("", (LIMIT.upper - LIMIT.lower, "recipe", LIMIT.lower)), ("tolerance = 2.0\n", (2.0, "study", None))],
)
def test_a_tolerance_is_a_width_alone_or_the_recipes(document, stated, tolerance):
    (metric,) = document(changed(("lower = 9.0\nupper = 11.0\n", stated)))["metrics"]
    assert (metric["tolerance"], metric["tolerance_of"], metric["lower"]) == tolerance


def test_without_metrics_stations_and_days_it_is_what_the_options_give(document, printed, crossed):
    by_file = document('[study]\nname = "all"\nrecipe = "short"\nby_location = true\nconfidence_percent = 90\n')
    options = ["--recipe", "short", "--by-location", "--confidence", "90", "--database", crossed]
    by_options = printed("gauge", *options)
    assert by_options.pop("study") is None
    assert by_file.pop("study")["name"] == "all"
    assert by_file == by_options
    assert by_file["by_location"] is True


@pytest.mark.parametrize("option", [("--recipe", "short"), ("--by-location",), ("--until", "2026-11-30")])
def test_options_beside_a_study_are_refused(studied, option):
    code, _, err = studied(STUDY, *option)
    assert code == 2
    assert f"{option[0]} cannot be given together with it" in re.sub(r"[\s│]+", " ", err)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("since = 2026-11-01", "since = 2026-12-01", "line 6: study.since is 2026-12-01, after until = 2026-11-30"),
        ("since = 2026-11-01", 'since = "2026-11-01"', "line 6: study.since is '2026-11-01'"),
        ("stations =", "station =", "line 5: study.station is not a known key; did you mean 'stations'?"),
        ('"bench-c"]', '"bench-a"]', "line 5: study.stations has 'bench-a' 2 times"),
        ('unit = "N/V"\nlower', "lower", "metrics[1].unit is missing: lower and upper of force_gain must have one"),
        ('unit = "N/V"\nvalue', "value", "reference[1].unit is missing"),
        ("lower = 9.0\n", "", "line 12: metrics[1].upper has no lower"),
        ("lower = 9.0", "lower = 12.0", "line 12: metrics[1].lower is 12, not below upper = 11"),
        ("lower = 9.0", "lower = 9.0\ntolerance = 2.0", "metrics[1].tolerance is given beside lower or upper"),
        ("lower = 9.0", "lower = nan", "line 12: metrics[1].lower is not a finite number"),
        ("[[reference]]", '[[metrics]]\nname = "force_gain"\n[[reference]]', "metrics[2].name is 'force_gain'"),
        ('serial = "S-01"', 'serial = "S-07"', "line 16: reference[1].serial is 'S-07'"),
        ('metric = "force_gain"', 'metric = "drift"', "line 17: reference[1].metric is 'drift', which is not among"),
        ('name = "gain, autumn"', "", "study.name is missing"),
        ('recipe = "short"\nserials = ["S-01", "S-02", "S-03", "S-04"]', "", "has neither recipe nor serials"),
        ('name = "gain, autumn"', 'appraiser = "robot"\nname = "x"', "line 2: study.appraiser is 'robot'"),
        ("[study]", "[study", "is not valid TOML"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_with_its_line(studied, old, new, words):
    code, out, err = studied(changed((old, new)))
    assert (code, out) == (2, "")
    assert "gain.toml" in err
    assert words in err


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"bench-c"]', '"bench-x"]', ["line 5: study.stations: ", "'bench-x'", "did you mean"]),
        ('"bench-c"]', '"bench-d"]', ["line 5: study.stations: station bench-d "]),
        ('"S-04"]', '"S-09"]', ["line 4: study.serials: sensor S-09 "]),
        ('"S-04"]', '"S-44", "T-1"]', ["study.serials: ", "'S-44'", "of sensor 'T-1'"]),
        ('recipe = "short"', 'recipe = "shirt"', ["line 3: study.recipe: ", "'shirt'", "'short'?"]),
        ("until = 2026-11-30", "until = 2026-11-02", ["line 1: study: ", "began from 2026-11-21 to 2027-11-21"]),
        (
            "until =",
            'operators = ["Zoë Otani"]\nuntil =',
            ["line 7: study.operators: ", "did you mean 'Zoë Ōtani'?"],
        ),
        ("unit", 'phase = "gird"\nunit', ["metrics[1].name: ", "phase 'gird'", "phase 'grid'"]),
        ('unit = "N/V"', 'unit = "mm"', ["line 11: metrics[1].unit: ", "'mm'", "measured in N/V"]),
        ('unit = "N/V"\nvalue', 'unit = "kN/V"\nvalue', ["reference[1].unit: ", "'kN/V'"]),
    ],
)
def test_what_no_run_fits_is_said_with_its_line(studied, old, new, words):
    code, out, err = studied(changed((old, new)).replace("since = 2026-11-01\n", "since = 2026-10-01\n"))
    assert (code, out) == (2, "")
    for said in words:
        assert said in err


def test_a_metric_nobody_measured_is_refused_with_the_nearest(studied):
    code, _, err = studied(STUDY.replace('"force_gain"', '"force_gian"'))
    assert code == 2
    assert "line 10: metrics[1].name: no run of these measured 'force_gian'" in err
    assert "did you mean 'force_gain'?" in err


@pytest.mark.rest
def test_a_metric_without_qualifier_is_the_one_that_has_none(tmp_path, capsys):
    """As in limits: a tolerance of one variant is not put on another."""
    path = tmp_path / "runs.db"
    with open_store(f"sqlite:///{path}", durable=False) as store:
        for serial, station, trial, values in runs():
            plain = measured(values, limit=None)
            masked = Measurement("force_gain", 2 * values[0], "N/V", None, "grid", qualifier="mask 25 %")
            store_run(store, serial, (*plain, masked), station=station, day=trial)
    study = tmp_path / "gain.toml"
    found = []
    for extra in ("", 'qualifier = "mask 25 %"\n'):
        study.write_text(f'[study]\nname = "g"\nrecipe = "short"\n[[metrics]]\nname = "force_gain"\n{extra}')
        assert run_guarded(["gauge", str(study), "--database", str(path), "--json"]) == 0
        found.append([one["qualifier"] for one in json.loads(capsys.readouterr().out)["metrics"]])
    assert found == [[""], ["mask 25 %"]]


def test_a_file_that_is_not_there_is_said(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run_guarded(["gauge", "S-01"]) == 2
    assert "gauge study file 'S-01' does not exist" in capsys.readouterr().err


def test_every_key_of_a_study_is_documented():
    page = (Path(__file__).parents[3] / "docs" / "reference" / "configuration.md").read_text()
    section = re.search(r"^## Gauge study$(.*?)(?=^## |\Z)", page, re.M | re.S)[1]
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", section))))
    tables = (StudyFile, StudyTable, MetricTable, ReferenceTable)
    keys = {key for table in tables for key in table.model_fields}
    assert keys - named == set()
    first_column = re.findall(r"^\| (`[^|]*?) \|", section, re.M)
    assert {key for cell in first_column for key in re.findall(r"`([a-z]\w*)`", cell)} - keys == set()
