"""``gauge`` on stored runs: the study is the one of the stored numbers, and what is missing of it is said."""

import re
from functools import partial

import numpy as np
import pytest
from filled_databases import filled
from stored_lots import store_run

from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.stats.gauge.anova import gauge_anova
from cbsr_qa.stats.gauge.balance import largest_balanced, missing_runs
from cbsr_qa.stats.gauge.crossed_study import study
from cbsr_qa.store.opening import open_store

STATIONS, SENSORS = ("bench-a", "bench-b", "bench-c"), tuple(f"S-{k:02d}" for k in range(1, 7))
LIMIT = Limit("force_gain", "N/V", 8.0, 12.0)
LOCATIONS = ("L0", "L1")


def runs(seed=3, offset=0.3, trials=2):
    """(serial, station, trial, values at two locations) of a crossed study: sensors 0.5, stations, repeats 0.1."""
    random = np.random.default_rng(seed)
    of_sensor = dict(zip(SENSORS, 0.5 * random.standard_normal(len(SENSORS)), strict=True))
    for trial in range(trials):
        for number, station in enumerate(STATIONS):
            for serial in SENSORS:
                mean = 10 + of_sensor[serial] + offset * (number - 1) + 0.1 * random.standard_normal()
                yield serial, station, trial, (mean - 0.2, mean + 0.2)


def measured(values, *, limit=LIMIT, name="force_gain", unit="N/V"):
    made = [
        Measurement(name, value, unit, None, "grid", where, 0, load=k, strain=0.2)
        for k, (where, value) in enumerate(zip(LOCATIONS, values, strict=True))
    ]
    return tuple(m.judge(limit) if limit else m for m in made)


def fill(path, rows, recipe="short", operator=None, **changes):
    def options(station, trial):
        who = {"operator": operator[station]} if operator else {}
        return {"recipe": recipe, "station": station, "day": trial, **who}

    filled(path, [(serial, measured(taken, **changes), options(*where)) for serial, *where, taken in rows])


@pytest.fixture(scope="module")
def crossed(tmp_path_factory):
    fill(path := tmp_path_factory.mktemp("gauge") / "runs.db", runs())
    return path


@pytest.fixture
def command(run_command):
    return partial(run_command, "gauge", "--database")


@pytest.fixture
def refused(refusal):
    return partial(refusal, "gauge", "--database")


@pytest.fixture
def document(printed):
    return partial(printed, "gauge", "--database")


def expected(rows=None):
    rows = list(rows or runs())
    return study([r[0] for r in rows], [r[1] for r in rows], [float(np.mean(r[3])) for r in rows])


def test_the_study_is_that_of_the_stored_runs(crossed, document):
    (metric,) = document(crossed, "--recipe", "short")["metrics"]
    truth = gauge_anova(expected(), tolerance=4.0)
    found = metric["anova"]["components"]
    for name in ("repeatability", "reproducibility", "gauge", "sensor", "total"):
        part = getattr(truth.components, name)
        assert found[name]["variance"] == pytest.approx(part.variance, rel=1e-9)
        assert found[name]["percent_tolerance"] == pytest.approx(part.percent_tolerance, rel=1e-9)
    assert metric["anova"]["categories"] == truth.categories
    assert (metric["trials"], metric["appraisers"], metric["missing"]) == (2, list(STATIONS), [])
    # The stations were 0.3 apart: their deviation is 0.3, the repeats' 0.1.
    assert 0.15 < found["reproducibility"]["deviation"] < 0.6
    assert 0.07 < found["repeatability"]["deviation"] < 0.14


def test_each_location_has_a_study_of_its_own(crossed, document):
    metrics = document(crossed, "--recipe", "short", "--by-location")["metrics"]
    assert [metric["location"] for metric in metrics] == list(LOCATIONS)
    whole = document(crossed, "--recipe", "short")["metrics"][0]["anova"]["components"]["gauge"]["variance"]
    assert metrics[0]["anova"]["components"]["gauge"]["variance"] == pytest.approx(whole)  # both moved alike


@pytest.mark.rest
def test_what_is_missing_is_said_and_the_largest_whole_part_taken_only_if_asked(tmp_path, refused, document):
    rows = [row for row in runs(trials=3) if not (row[2] == 2 and row[1] == "bench-c") and row[0] != "S-06"]
    rows = [row for row in rows if not (row[0] == "S-05" and row[1] == "bench-b" and row[2] > 0)]
    fill(tmp_path / "runs.db", rows)
    said = refused(tmp_path / "runs.db", "--recipe", "short")
    assert "S-05 on bench-b has 1 of 3 runs" in said
    assert "--largest-balanced" in said
    (metric,) = document(tmp_path / "runs.db", "--recipe", "short", "--largest-balanced")["metrics"]
    # 4 sensors × 3 stations × 2 trials and 4 × 2 × 3 have 24 runs, 5 × 2 × 2 has 20.
    kept = len(metric["sensors"]), len(metric["appraisers"]), metric["trials"]
    assert kept == (4, 3, 2)
    assert any("largest balanced part of 38 runs" in said for said in metric["notes"])
    whole = [row for row in rows if row[0] in metric["sensors"] and row[2] < 2]
    truth = gauge_anova(expected(whole)).components.gauge.variance
    assert metric["anova"]["components"]["gauge"]["variance"] == pytest.approx(truth)


@pytest.mark.rest
def test_a_run_too_many_is_that_and_not_all_others_missing(tmp_path, refused, document):
    rows = list(runs())
    fill(tmp_path / "runs.db", [*rows, rows[0]])
    said = refused(tmp_path / "runs.db", "--recipe", "short")
    assert "uneven: S-01 on bench-a has 3 runs instead of 2 " in said
    assert "sensor S-01 has 3 runs on station bench-a, others have 2" in said
    (metric,) = document(tmp_path / "runs.db", "--recipe", "short", "--largest-balanced")["metrics"]
    assert (metric["trials"], metric["missing"]) == (2, ["S-01 on bench-a has 3 runs instead of 2"])


@pytest.mark.rest
def test_a_study_of_operators_speaks_of_operators(tmp_path, command, document):
    names = dict(zip(STATIONS, ("Ada", "Jo", "Zoë"), strict=True))
    fill(tmp_path / "runs.db", runs(offset=0.0, seed=4), operator=names)
    asked = ("--recipe", "short", "--appraiser", "operator", "--reference", "S-01.force_gain=10±0.1")
    out = " ".join(command(tmp_path / "runs.db", *asked, "--output", tmp_path / "page.html")[1].split())
    assert re.search(r"sensor operator reference \[N/V\].* S-01 Ada ", out)
    assert "The estimated operator variance is negative" in out
    assert "station variance" not in out
    assert {row["source"] for row in document(tmp_path / "runs.db", *asked)["metrics"][0]["anova"]["table"]} == {
        "operator", "sensor", "sensor × operator", "repeated runs", "pooled: interaction and repeated runs"
    }  # fmt: skip
    assert "sensor × operator" in (tmp_path / "page.html").read_text()
    with open_store(f"sqlite:///{tmp_path / 'runs.db'}", durable=False) as store:
        store_run(store, "S-02", measured((10.0, 10.0)), station="bench-a", operator="Ada")
    err = command(tmp_path / "runs.db", *asked[:4])[2]
    assert "sensor S-02 has 3 runs by operator Ada, others have 2" in err
    assert "uneven: S-02 by Ada has 3 runs instead of 2" in err


@pytest.mark.rest
def test_columns_stand_apart_whatever_the_numbers(tmp_path, command):
    small = Limit("force_gain", "N/V", 1e-5, 9e-4)
    rows = [(*row[:3], tuple(value * 1e-5 for value in row[3])) for row in runs()]
    fill(tmp_path / "runs.db", rows, limit=small)
    lines = command(tmp_path / "runs.db", "--recipe", "short")[1].splitlines()
    begin = next(k for k, line in enumerate(lines) if line.strip().startswith("component"))
    table = [re.split(r" {2,}", line.strip()) for line in lines[begin + 1 : begin + 6]]
    assert [row[0] for row in table] == ["gauge R&R", "repeatability", "reproducibility", "sensors", "total"]
    assert {len(row) for row in table} == {7}
    assert any("× 10⁻⁶ to" in row[2] for row in table)
    assert len({len(line) for line in lines[begin : begin + 6]}) == 1


def test_the_largest_balanced_part_is_the_largest():
    sensors = ["A"] * 4 + ["B"] * 4 + ["C"] * 3
    stations = ["x", "x", "y", "y"] * 2 + ["x", "x", "y"]
    part = largest_balanced(sensors, stations)
    assert (part.sensors, part.stations, part.trials, part.kept) == (("A", "B"), ("x", "y"), 2, tuple(range(8)))
    assert missing_runs(sensors, stations) == ("C on y has 1 of 2 runs",)
    assert missing_runs([*"AABB"], [*"xxyy"]) == ("A on y has 0 of 2 runs", "B on x has 0 of 2 runs")
    assert largest_balanced(["A", "B"], ["x", "y"]).kept == ()


def test_bias_is_held_against_reference_values(crossed, document):
    rows = [row for row in runs() if row[0] == "S-01"]
    mean = np.mean([np.mean(row[3]) for row in rows if row[1] == "bench-b"])
    given = ["--reference", f"S-01.force_gain={mean - 1:.9f}±0.01", "--reference", "S-02.force_gain=10"]
    (metric,) = document(crossed, "--recipe", "short", *given)["metrics"]
    biases = {(b["serial"], b["appraiser"]): b["bias"] for b in metric["references"]["bias"]}
    assert biases["S-01", "bench-b"]["value"] == pytest.approx(1.0, abs=1e-8)
    readings = [np.mean(row[3]) for row in rows if row[1] == "bench-b"]
    assert biases["S-01", "bench-b"]["standard_error"] == pytest.approx(
        np.hypot(np.std(readings, ddof=1) / 2**0.5, 0.01)
    )
    lines = {line["appraiser"]: line for line in metric["references"]["linearity"]}
    assert set(lines) == set(STATIONS)
    b = {serial: biases[serial, "bench-b"]["value"] for serial in ("S-01", "S-02")}
    assert lines["bench-b"]["slope"]["value"] == pytest.approx((b["S-01"] - b["S-02"]) / (mean - 1 - 10), rel=1e-6)
    # Two readings a station are too few.
    whys = {line["why"] for line in metric["references"]["stability"]}
    assert whys == {"stability: 2 values instead of at least 3"}
    (metric,) = document(crossed, "--recipe", "short", *given[:2])["metrics"]
    assert {line["why"].partition(";")[0] for line in metric["references"]["linearity"]} == {
        "linearity: all readings have one reference"
    }


def test_one_golden_sensor_on_one_station_is_a_type_1_study(tmp_path, command, document):
    random = np.random.default_rng(12)
    rows = [("G-01", "bench-a", day, (value, value)) for day, value in enumerate(10 + 0.02 * random.normal(size=25))]
    fill(tmp_path / "runs.db", rows)
    asked = ("--recipe", "short", "--reference", "G-01.force_gain=10.01")
    (metric,) = document(tmp_path / "runs.db", *asked)["metrics"]
    (study_1,) = metric["references"]["type1"]
    readings = np.array([row[3][0] for row in rows])
    assert (study_1["serial"], study_1["appraiser"], study_1["runs"], study_1["tolerance"]) == (
        "G-01",
        "bench-a",
        25,
        4.0,
    )
    assert study_1["cg"]["value"] == pytest.approx(0.2 * 4 / (6 * readings.std(ddof=1)))
    assert study_1["cgk"]["value"] < study_1["cg"]["value"]
    assert study_1["capable"] is True
    said = " ".join(command(tmp_path / "runs.db", *asked)[1].split())
    assert "Capable by the type 1 study" in said
    assert "Type 1 study: 20 % of the tolerance over six standard deviations (Cg), less the bias (Cgk)." in said
    (of_five_days,) = document(tmp_path / "runs.db", *asked, "--until", "2026-11-25")["metrics"]
    (too_few,) = of_five_days["references"]["type1"]
    assert (too_few["cg"], too_few["why"]) == (None, "type 1 study: 5 values instead of at least 10")


def test_linearity_knows_how_well_the_references_are_known(crossed, document):
    exact = ("--reference", "S-01.force_gain=11", "--reference", "S-02.force_gain=8")
    unsure = ("--reference", "S-01.force_gain=11±1", "--reference", "S-02.force_gain=8±1")
    (metric,) = document(crossed, "--recipe", "short", *exact)["metrics"]
    line = metric["references"]["linearity"][0]
    assert (line["slope"]["high"] < 0, line["acceptable"]) == (True, False)
    assert metric["references"]["linearity"][0]["references"] == [8.0, 11.0]
    (metric,) = document(crossed, "--recipe", "short", *unsure)["metrics"]
    line = metric["references"]["linearity"][0]
    assert (line["slope"]["low"] < 0 < line["slope"]["high"], line["acceptable"]) == (True, True)
    # Both ends of 3 N/V move by 1 N/V each, one way or the other.
    assert line["slope"]["standard_error"] == pytest.approx(2**0.5 / 3 * abs(1 + line["slope"]["value"]), rel=0.1)


def test_references_come_from_a_file_too(crossed, document, refused, tmp_path):
    text = '[[reference]]\nserial = "S-01"\nmetric = "force_gain"\nunit = "N/V"\nvalue = 10.0\n'
    (tmp_path / "golden.toml").write_text(text)
    (metric,) = document(crossed, "--recipe", "short", "--reference", tmp_path / "golden.toml")["metrics"]
    assert {b["reference"] for b in metric["references"]["bias"]} == {10.0}
    (tmp_path / "golden.toml").write_text(text.replace("metric", "metrics"))
    assert "metrics" in refused(crossed, "--recipe", "short", "--reference", tmp_path / "golden.toml")


@pytest.mark.rest
def test_the_page_draws_the_six_panels(crossed, command, tmp_path):
    code, out, err = command(crossed, "--recipe", "short", "--output", tmp_path / "page.html")
    assert code == 0, err
    page = (tmp_path / "page.html").read_text()
    titles = "components", "by sensor", "by station", "range of repeated", "mean of repeated", "sensor by station"
    assert [title for title in titles if title not in page] == []
    assert "not good enough (above 30 %)" in page
    assert re.search(r"^simulated +all runs of this study$", out, re.M)
    assert re.search(r"^Force gain \(.*\) \[N/V\]$", out, re.M)  # in words, as compare writes it
    assert "force_gain" not in out
    assert "bench-c" in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "no study is named"),
        (("--recipe", "shirt"), "did you mean 'short'?"),
        (("--serials", "S-01,S-99"), "no stored run is of sensor 'S-99'"),
        (("--recipe", "short", "--metric", "force_gian"), "did you mean 'force_gain'?"),
        (("--recipe", "short", "--appraiser", "robot"), "allowed: station, operator"),
        (("--recipe", "short", "--reference", "S-01.force_gain"), "cannot be read"),
        (("--recipe", "short", "--reference", "S-01.force_gain=nan"), "finite"),
        (("--recipe", "short", "--reference", "S-77.force_gain=1"), "has no run in this study"),
        (("--recipe", "short", "--reference", "S-01.drift=1"), "which is not studied"),
        (("--serials", "S-01"), "there is only one sensor, S-01"),
        (("--serials", "S-01"), "a type 1 study (Cg, Cgk): --reference 'S-01."),
        (("--serials", "S-01", "--metric", "force_gain"), "--reference 'S-01.force_gain=VALUE±U N/V'"),
        (("--recipe", "short", "--since", "2030-01-01"), "no analysed run fits"),
        (("--recipe", "short", "--since", "2026-03-02", "--until", "2026-03-01"), "swap --since and --until"),
        (("--recipe", "short", "--stations", "bench-a,bench-d"), "no stored run is of station 'bench-d'"),
        (("--recipe", "short", "--reference", "S-01.force_gain=10±0.1 mm"), "measured in N/V"),
        (("--recipe", "short", "--appraiser", "operator"), "there is only one operator, Zoë Ōtani"),
    ],
)
def test_what_cannot_be_studied_is_refused_by_name(crossed, refused, arguments, words):
    assert words in refused(crossed, *arguments)


@pytest.mark.rest
def test_odd_runs_are_left_out_by_name(tmp_path, document):
    path = tmp_path / "runs.db"
    fill(path, runs())
    with open_store(f"sqlite:///{path}", durable=False) as store:
        store_run(store, "S-01", measured((9.0, 9.0), limit=None, unit="kN/V"), station="bench-a", day=-400)
        store_run(store, "S-02", measured((9.0, None)), station="bench-a", software=[("cbsr-qa", "9.9")])
        of_other = {"tables": {"analysis": {"mask": 0.5}}}
        store_run(store, "S-03", (Measurement("drift", 0.1, "1"),), station="bench-b", **of_other)
    found = document(path, "--recipe", "short", "--metric", "force_gain")
    (metric,) = found["metrics"]
    notes = " ".join(metric["notes"])
    assert "in kN/V instead of N/V: S-01" in notes
    assert "1 of 2 values could not be measured: S-02" in notes
    assert "did not measure it: S-03" in notes
    assert metric["runs"] == 36
    assert any("clock of station bench-a was wrong by about 1.1 years" in said for said in found["notes"])
    assert any("0.1.0 (38 runs), 9.9 (1 run)" in said for said in found["notes"])
    assert any("was not the same at the first" in said for said in found["notes"])


@pytest.mark.rest
def test_runs_that_do_not_differ_at_all_are_refused(tmp_path, refused):
    fill(tmp_path / "runs.db", [(*row[:3], (10.0, 10.0)) for row in runs()])
    assert "repeated runs do not differ at all" in refused(tmp_path / "runs.db", "--recipe", "short")
