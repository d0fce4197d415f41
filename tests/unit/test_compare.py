"""``cbsr-qa compare`` on stored lots: what differs, what a design cannot tell, and what is named where it is bad."""

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from stored_lots import LIMITS, judged, measured, store_run

from cbsr_qa.app.compare import RunChoice, compare_groups, read_amounts
from cbsr_qa.app.compare_page import write_page
from cbsr_qa.cli.main import guarded
from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.measurement import Bound, Limit, Measurement, Verdict
from cbsr_qa.domain.outcome import EndReason, Outcome
from cbsr_qa.fleet.sentences import headline, sentences
from cbsr_qa.fleet.terms import Adjustment, By, Period, Policy, Quarantine, Terms
from cbsr_qa.store.repository import open_store

NOW = datetime(2026, 12, 24, tzinfo=UTC)
ERROR = "centre_of_mass_error"
BATCH_MM, STATION_MM = 0.5, 0.8


@pytest.fixture
def url(tmp_path):
    return f"sqlite:///{tmp_path / 'fleet.db'}"


@pytest.fixture(scope="module")
def template(tmp_path_factory):
    file = tmp_path_factory.mktemp("compare") / "fleet.db"
    fleet(f"sqlite:///{file}")
    return file


@pytest.fixture
def two(template, tmp_path):
    """Database of its own with two batches on two stations, some sensors on both."""
    copied = shutil.copy(template, tmp_path / "two.db")
    return f"sqlite:///{copied}"


def moved(measurements, mm):
    return tuple(replace(m, value=m.value + mm) if m.name == ERROR else m for m in measurements)


def fleet(url, *, alone=False, sensors=24, both=8, **changes):
    """Two batches on two stations: 42 is BATCH_MM above 41, B reads STATION_MM above A.

    Parameters
    ----------
    alone : each batch on a station of its own; else every third sensor of either is at home on B.
    both : sensors that run on both stations.
    """
    random = np.random.default_rng(8)
    with open_store(url, durable=False) as store:
        for number in range(sensors):
            batch = ("41", "42")[number % 2]
            home = ("A", "B")[number % 2 if alone else number % 3 == 0]
            sensor = random.standard_normal(3)
            for station in ("A", "B") if number < both and not alone else (home,):
                mm = BATCH_MM * (batch == "42") + STATION_MM * (station == "B")
                values = judged(moved(measured(random, sensor), mm))
                store_run(store, f"S-{number:02d}", values, batch=batch, station=station, **changes)


def compared(url, by=By.BATCH, choice=None, **terms):
    return compare_groups(choice or RunChoice(), Terms(by, **terms), database=url, now=NOW)


def metric(made, name=ERROR, group=None):
    document = made.document()
    return next(m for m in document["metrics"] if m["name"] == name and group in (None, m["group"]))


def test_the_batch_is_told_from_the_station(two):
    made = compared(two)
    found = metric(made)
    assert (found["group"], found["reference"]) == ("42", "41")
    assert found["low"] < BATCH_MM < found["high"]
    assert found["p"] < 0.05
    assert found["model"].startswith("mixed")
    assert found["unit"] == "mm"
    station = next(s for s in made.document()["stations"] if s["name"] == ERROR)
    assert (station["station"], station["reference"]) == ("B", "A")
    assert station["low"] < STATION_MM < station["high"]
    assert made.exit_code == 0
    assert headline(made.found).startswith("41 and 42 differ in 1 of 3 metrics")


def test_stations_are_compared_with_the_batches_taken_out(two):
    found = metric(compared(two, By.STATION))
    assert (found["group"], found["reference"]) == ("B", "A")
    assert found["low"] < STATION_MM < found["high"]
    assert found["p"] < 0.001


def test_batches_on_a_station_each_are_not_fitted_and_the_claim_of_a_t_test_is_shown(url):
    fleet(url, alone=True)
    made = compared(url)
    found = metric(made)
    assert found["difference"] is found["low"] is found["p"] is found["equivalent"] is None
    assert found["model"] == "refused"
    assert "42 ran on B only and 41 on A only" in found["warnings"][0]
    assert found["naive"]["difference"] == pytest.approx(BATCH_MM + STATION_MM, abs=0.4)
    said = " ".join(sentences(made.found))
    assert "A t test that knows neither stations nor the number of metrics would have claimed" in said
    assert made.exit_code == 3


def test_a_metric_is_the_mean_of_its_loads_and_a_retest_decides_by_policy(url):
    def values(mm):
        return judged(tuple(Measurement(ERROR, mm + k, "mm", 0.1, "nine locations", f"L{k}", 0) for k in range(3)))

    with open_store(url, durable=False) as store:
        for number, mm in enumerate((1.0, 2.0, 3.0)):
            store_run(store, f"S-{number}", values(mm + 4.0), batch="41")  # 5 to 7, 6 to 8, 7 to 9: beyond 6.5
            store_run(store, f"S-{number}", values(mm), batch="41")

    last, first, some = (
        compared(url, policy=policy).document() for policy in (Policy.LAST, Policy.FIRST, Policy.ANY)
    )
    assert [d["distributions"][0]["mean"] for d in (last, first, some)] == [3.0, 7.0, 3.0]
    assert [d["groups"][0]["yield"] for d in (last, first, some)] == [1.0, 0.0, 1.0]
    assert {d["groups"][0]["first_pass_yield"] for d in (last, first, some)} == {0.0}
    assert first["groups"][0]["failures"] == [{"metric": f"{ERROR} (nine locations)", "sensors": 3}]
    assert last["groups"][0]["failures"] == []
    # Capability is of the worst load: of 3, 4 and 5 mm against 6.5 mm.
    assert last["distributions"][0]["capability"]["cpk"]["value"] == pytest.approx((6.5 - 4.0) / 3)


def test_two_limits_that_judge_every_load_give_capability_of_both_sides(url):
    limit = Limit("area_ratio", "1", 0.0, 2.0)

    def values(ratio):
        loads = ratio - 0.1, ratio, ratio + 0.2
        return tuple(
            Measurement("area_ratio", one, "1", None, "nine locations", f"L{k}", 0).judged(limit)
            for k, one in enumerate(loads)
        )

    with open_store(url, durable=False) as store:
        for number, ratio in enumerate((0.9, 1.0, 1.1)):
            store_run(store, f"S-{number}", values(ratio), batch="41")
    (one,) = compared(url).document()["distributions"]
    assert one["no_capability"] is None
    assert one["capability"]["cpk"]["value"] == pytest.approx((2.0 - 1.2) / 0.3)
    assert one["capability"]["cp"]["value"] == pytest.approx((2.0 - 0.3) / 0.6)


def test_sensors_that_could_not_be_measured_are_counted_as_the_policy_says(url):
    random = np.random.default_rng(2)
    with open_store(url, durable=False) as store:
        for number in range(6):
            values = judged(measured(random, random.standard_normal(3)))
            changes = {"verdict": Verdict(Outcome.NOT_MEASURED, "drift")} if number == 0 else {}
            store_run(store, f"S-{number}", values, batch="41", **changes)
        store_run(store, "S-6", values, batch="41", end=EndReason.ABORTED)
    apart = compared(url).document()
    failed = compared(url, quarantine=Quarantine.FAILED).document()
    assert (apart["groups"][0]["yield"], apart["groups"][0]["not_measured"]) == (1.0, 1)
    assert failed["groups"][0]["yield"] == pytest.approx(5 / 6)
    assert "1 run did not run to its end and is left out" in apart["warnings"]


def test_p_values_are_adjusted_for_all_metrics(two):
    raw, holm = (
        {m["name"]: m["p"] for m in compared(two, adjustment=a).document()["metrics"]}
        for a in (Adjustment.NONE, Adjustment.HOLM)
    )
    assert holm[ERROR] == pytest.approx(3 * raw[ERROR])  # the smallest of three that could be tested


def test_equivalence_and_how_many_sensors_a_difference_needs(two):
    wide, narrow = (metric(compared(two, margins={"drift": m}, detect={"drift": m}), "drift") for m in (1.0, 1e-4))
    assert wide["equivalent"] is True
    assert narrow["equivalent"] is False
    assert narrow["sensors_needed"] > 1000 > wide["sensors_needed"] >= 2
    assert narrow["sensors_to_show_alike"] > narrow["sensors_needed"]
    alone = metric(compared(two, margins={"drift": 1.0}), "drift")
    assert alone["detect"] is alone["sensors_needed"] is None
    nothing = metric(compared(two), "drift")
    assert nothing["equivalent"] is nothing["sensors_to_show_alike"] is None


def test_what_all_places_share_counts_against_the_station(url):
    random = np.random.default_rng(3)
    with open_store(url, durable=False) as store:
        for number in range(20):
            station = "AB"[number % 3 == 0]
            shift_mm = 0.5 + 0.1 * random.standard_normal() + (station == "B")
            values = (*measured(random, random.standard_normal(3)), Measurement("registration_shift", shift_mm, "mm"))
            store_run(store, f"S-{number}", judged(values), batch=("41", "42")[number % 2], station=station)
    made = compared(url)
    assert metric(made, "registration_shift")["difference"] is None
    (station,) = (s for s in made.document()["stations"] if s["name"] == "registration_shift")
    assert station["low"] < 1.0 < station["high"]
    assert "it holds what all places share, which is the station's" in metric(made)["warnings"]
    assert metric(compared(url, By.STATION), "registration_shift")["difference"] == pytest.approx(1.0, abs=0.2)


def test_more_than_two_groups_are_each_compared_with_the_stated_reference(two):
    random = np.random.default_rng(4)
    with open_store(two, durable=False) as store:
        for number in range(5):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"T-{number}", values, batch="43", station="A")
    assert compared(two).document()["reference"] == "41"  # most sensors, then by name
    pairs = {(m["group"], m["reference"]) for m in compared(two, groups=("43", "41", "42")).document()["metrics"]}
    assert pairs == {("41", "43"), ("42", "43")}


def test_one_batch_is_described_and_compared_with_nothing(two):
    made = compared(two, groups=("41",))
    assert made.exit_code == 3
    assert "there is one batch only, 41" in made.document()["warnings"][0]
    assert made.document()["distributions"][0]["n"] == 12


def test_one_sensor_and_no_variance_are_named(url):
    random = np.random.default_rng(4)
    with open_store(url, durable=False) as store:
        for serial, batch in (("S-1", "41"), ("S-2", "42")):
            store_run(store, serial, judged(measured(random, random.standard_normal(3))), batch=batch)
    document = compared(url).document()
    assert "41 has one sensor only, which says nothing of how sensors differ" in document["warnings"]
    reasons = {m["name"]: m["warnings"][0] for m in document["metrics"]}
    assert "sensors are 2, which leaves nothing to judge 2 effects" in reasons["drift"]
    assert "all 2 values are 0, which leaves no variance" in reasons["missed_loads"]


def test_missing_values_lower_bounds_and_mixed_units_are_named_and_left_out(two):
    random = np.random.default_rng(5)
    values = judged(measured(random, np.zeros(3)))
    with open_store(two, durable=False) as store:
        store_run(store, "M-1", (replace(values[0], value=None, how="missed"), *values[1:]), batch="41", station="A")
        store_run(store, "M-2", tuple(m for m in values if m.name != "drift"), batch="41", station="A")
        store_run(store, "M-3", (replace(values[0], bound=Bound.LOWER), *values[1:]), batch="41", station="A")
        micro = (Measurement("noise_floor", 6.0, "10⁻³"), *values[:9])
        store_run(store, "M-4", micro, batch="41", station="A")
    made = compared(two)
    said = " ".join(metric(made)["warnings"])
    assert "1 run lacks some of the 9 values; the figure is the rest's mean: M-1" in said
    assert "of 1 run only a lower bound is known; left out: M-3" in said
    assert "mixed units: M-4 measured it in 10⁻³ instead of 1" in " ".join(metric(made, "noise_floor")["warnings"])
    counts = {d["name"]: d["n"] for d in made.document()["distributions"] if d["group"] == "41"}
    assert counts == {ERROR: 15, "drift": 14, "noise_floor": 15, "missed_loads": 15}


def test_mixed_software_is_named_and_can_be_compared(two):
    random = np.random.default_rng(6)
    with open_store(two, durable=False) as store:
        for number in range(4):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"N-{number}", values, batch="42", station="A", software=[("cbsr-qa", "0.2.0")])
    (warning,) = (w for w in compared(two).document()["warnings"] if "software" in w)
    assert "cbsr-qa 0.1.0, numpy 2.0: 32 runs" in warning
    names = [g["name"] for g in compared(two, By.SOFTWARE).document()["groups"]]
    assert names == ["cbsr-qa 0.1.0, numpy 2.0", "cbsr-qa 0.2.0"]


def test_a_clock_that_is_wrong_by_a_year_is_named(two):
    random = np.random.default_rng(7)
    with open_store(two, durable=False) as store:
        for number in range(3):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"Y-{number}", values, batch="41", station="A", day=-365)
        store_run(store, "Z-1", values, batch="41", station="B", day=365)
        store_run(store, "C-1", values, batch="41", station="C", day=-300)
    warnings = compared(two).document()["warnings"]
    assert any("the clock of station A was set back: 3 runs (Y-0, Y-1, Y-2)" in words for words in warnings)
    assert any("the clock of station B was wrong: 1 run (Z-1) began on 2027-11-21" in words for words in warnings)
    assert any("station C states that it tested 41 300 days away" in words for words in warnings)
    assert any("periods are taken from those clocks" in w for w in compared(two, By.PERIOD).document()["warnings"])


def test_periods_are_days_weeks_months_and_years(url):
    random = np.random.default_rng(8)
    with open_store(url, durable=False) as store:
        for number in range(8):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"S-{number}", values, day=(0, 14)[number % 2])
    names = {p: [g["name"] for g in compared(url, By.PERIOD, period=p).document()["groups"]] for p in Period}
    assert names[Period.MONTH] == ["2026-11", "2026-12"]
    assert names[Period.WEEK] == ["2026-W47", "2026-W49"]
    assert names[Period.YEAR] == ["2026"]
    since = RunChoice(since=(datetime(2026, 11, 21) + timedelta(days=1)).date())
    assert [g["n"] for g in compared(url, By.PERIOD, since).document()["groups"]] == [4]
    until = RunChoice(until=datetime(2026, 11, 21).date())
    assert [g["n"] for g in compared(url, By.PERIOD, until).document()["groups"]] == [4]


def test_a_material_of_one_batch_cannot_be_told_from_it(url):
    fleet(url, sensors=4, both=0)
    warnings = compared(url, By.MATERIAL).document()["warnings"]
    assert any("batches of one material are taken for alike" in words for words in warnings)
    only = compared(url, By.MATERIAL, RunChoice(recipe="short")).document()
    assert [g["name"] for g in only["groups"]] == ["cbsr-8wt"]


def test_only_the_latest_analysis_counts(url):
    random = np.random.default_rng(9)
    with open_store(url, durable=False) as store:
        run = store_run(store, "S-1", judged(measured(random, np.zeros(3))))
        from cbsr_qa.domain.report import RunResult

        again = (Measurement("drift", 0.25, "%/min"),)
        result = RunResult(store.load_run(run), None, again, Verdict(Outcome.NOT_JUDGED, ""), None, "")
        store.save_result(result)
    document = compared(url).document()
    assert [(d["name"], d["mean"]) for d in document["distributions"]] == [("drift", 0.25)]
    assert document["groups"][0]["yield"] is None


@pytest.mark.parametrize(
    ("terms", "reason", "remedy"),
    [
        ({"names": ("drfit",)}, "measured 'drfit'", "did you mean 'drift'?"),
        ({"margins": {"drifts": 1.0}}, "measured 'drifts'", "did you mean 'drift'?"),
        ({"groups": ("42", "410")}, "of batch '410'", "did you mean '41'?"),
    ],
)
def test_unknown_names_are_refused_with_the_nearest(url, terms, reason, remedy):
    fleet(url, sensors=4, both=0)
    with pytest.raises(RefusedError) as raised:
        compared(url, **terms)
    assert reason in raised.value.reason
    assert remedy in raised.value.remedy


def test_an_empty_database_and_runs_that_do_not_fit_are_refused(url):
    with open_store(url):
        pass
    with pytest.raises(RefusedError, match="no stored run fits"):
        compared(url)
    fleet(url, sensors=2, both=0)
    with pytest.raises(RefusedError, match="no stored run is of recipe 'shrot'") as raised:
        compared(url, choice=RunChoice(recipe="shrot"))
    assert "did you mean 'short'? there are: short" in raised.value.remedy
    with pytest.raises(RefusedError, match="no stored run fits"):
        compared(url, choice=RunChoice(until=datetime(2020, 1, 1).date()))


@pytest.mark.parametrize("said", ["drift", "drift=", "=1", "drift=0", "drift=-1", "drift=nan", "drift=inf"])
def test_margins_that_are_none_are_refused(said):
    with pytest.raises(RefusedError, match="not METRIC=VALUE"):
        read_amounts([said], "--margin")
    assert read_amounts(["a=b=0.5"], "--margin") == {"a=b": 0.5}


def test_the_command_prints_one_document_and_writes_a_page(two, tmp_path, capsys):
    page = tmp_path / "page.html"
    arguments = ["compare", "--by", "batch", "--database", two, "--metric", ERROR, "--margin", f"{ERROR}=2"]
    assert guarded([*arguments, "--json", "--output", str(page)]) == 0
    printed = capsys.readouterr()
    document = json.loads(printed.out)
    assert document["by"] == "batch"
    assert [(g["name"], g["n"], g["yield"]) for g in document["groups"]] == [("41", 12, 1.0), ("42", 12, 1.0)]
    assert [m["equivalent"] for m in document["metrics"]] == [True]
    assert len(document["metrics"][0]["places"]) == 9
    assert str(page) in printed.err
    html = page.read_text()
    assert "42 and 41 are alike within ± 2.00 mm" in html
    assert html.count("<svg") >= 1
    assert guarded(arguments) == 0
    said = capsys.readouterr().out
    assert "42 − 41" in said
    assert max(map(len, said.splitlines())) <= 100


def test_a_word_that_is_no_way_to_compare_is_refused(capsys):
    assert guarded(["compare", "--by", "bach"]) == 2
    assert "did you mean 'batch'? allowed: batch, material, station, software, period" in capsys.readouterr().err


def test_a_page_says_where_on_the_sheet_groups_differ(two, tmp_path):
    made = compared(two, names=(ERROR,))
    write_page(made.found, tmp_path / "page.html")
    html = (tmp_path / "page.html").read_text()
    assert "Where on the sheet" in html
    assert "station B reads" in html
    assert LIMITS[ERROR].upper == 6.5
    assert "Cpk" in html


def test_sentences_say_on_which_side_and_which_pairs_are_not_shown_to_differ(two):
    random = np.random.default_rng(4)
    with open_store(two, durable=False) as store:
        for number in range(8):
            sensor = random.standard_normal(3)
            for station, mm in (("A", BATCH_MM), ("B", BATCH_MM + STATION_MM)):
                values = judged(moved(measured(random, sensor), mm))
                store_run(store, f"T-{number}", values, batch="43", station=station)
    made = compared(two, groups=("42", "41", "43"))
    found = metric(made, group="41")
    said = sentences(made.found)
    low, high = (f"{-found[end]:.3f}" for end in ("high", "low"))
    assert said[0].startswith(f"{ERROR} (nine locations): 41 lies {-found['difference']:.3f} mm ({low} to {high} mm)")
    assert " below 42, " in said[0]
    assert any(f"Not shown to differ: {ERROR} (nine locations) of 43 − 42, drift, noise_floor." in s for s in said)
    assert headline(made.found) == "42, 41 and 43 differ in 1 of 3 metrics"
