"""``limits propose`` on stored golden lots: what it reads, proposes, says and writes."""

import tomllib
from statistics import mean

import numpy as np
import pytest
from proposed_lots import lot, replace_value, sensor
from scipy import stats
from stored_lots import LIMITS, PHASE, judged

from cbsr_qa.config.documents import DocumentKind, open_document
from cbsr_qa.config.limits import limits_digest
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.plan.limits import Limit
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.stats.golden_lots import Ask, lot_limits
from cbsr_qa.stats.lot_shapes import Distribution
from cbsr_qa.studies.limits.report import _looks_heavy

pytestmark = pytest.mark.rest


def test_what_the_recipe_limits_is_proposed_on_the_sides_it_limits(lot_database, document):
    found = document(lot_database, "--batch", "golden")
    assert [limit["measurement"] for limit in found["limits"]] == ["centre_of_mass_error", "drift"]
    place, drift = found["limits"]
    assert (place["lower"], place["phase"], place["values"]) == (None, PHASE, 9)
    assert 2.0 < place["upper"] < 6.5
    assert drift["lower"] < 0 < drift["upper"]
    assert drift["sides"] == "those of the present limit"
    assert found["lot"]["sensors"].keys() == {f"S-{k:02d}" for k in range(1, 13)}
    assert sum(len(runs) for runs in found["lot"]["sensors"].values()) == 18
    assert (found["coverage"], found["confidence"]) == (0.99, 0.95)
    assert found["lot"]["simulated"] == ["the sheet"]


def test_repeated_runs_make_the_guard_band(lot_database, document):
    (drift,) = document(lot_database, "--batch", "golden", "--measurement", "drift")["limits"]
    found = drift["uncertainty"]
    assert found["degrees_of_freedom"] == 6
    assert found["standard"] == pytest.approx(0.01, rel=0.6)  # as simulated, from six repeats
    assert drift["marginal"] == pytest.approx(found["expanded"], rel=0.011)
    wider = document(lot_database, "--batch", "golden", "--measurement", "drift", "--guard-factor", 2)["limits"][0]
    assert wider["marginal"] == pytest.approx(2 * found["expanded"], rel=0.011)
    risks, guarded_risks = drift["risks"]["marginal_accepted"], drift["risks"]["marginal_refused"]
    assert 0 < guarded_risks["consumer"] < risks["consumer"] < 0.01
    assert risks["producer"] < guarded_risks["producer"]


def test_a_lot_has_the_mean_of_its_sensors_however_often_each_was_run(database, document):
    runs = [*lot(), ("S-1", sensor(9), {"day": 1}), ("S-1", sensor(10), {"day": 2})]
    drifts = {}
    for serial, measurements, _ in runs:
        drifts.setdefault(serial, []).extend(m.value for m in measurements if m.name == "drift")
    found = document(database(*runs), "--batch", "golden", "--measurement", "drift")["limits"][0]
    assert found["mean"] == pytest.approx(mean(map(mean, drifts.values())))


def test_stated_uncertainties_make_it_where_nothing_was_repeated(database, document):
    found = document(database(*lot()), "--batch", "golden", "--measurement", "centre_of_mass_error")["limits"][0]
    assert found["uncertainty"]["standard"] == pytest.approx(0.02)
    assert found["uncertainty"]["source"] == "stated by the measurements"
    assert found["marginal"] == pytest.approx(0.04)


def test_without_either_no_guard_band_is_made_up(database, document):
    found = document(database(*lot()), "--batch", "golden", "--measurement", "drift")["limits"][0]
    assert found["marginal"] == 0
    assert found["risks"] is None
    assert found["uncertainty"]["standard"] is None
    assert "no sensor was run twice, and 5 of 5 values state no uncertainty" in found["uncertainty"]["source"]


def test_unlimited_measurements_are_limited_on_both_sides_and_it_is_said(lot_database, propose, document):
    found = document(lot_database, "--batch", "golden", "--measurement", "noise_floor")["limits"][0]
    assert found["lower"] < 0.006 < found["upper"]
    assert found["sides"].startswith("both")
    assert found["present"] is None
    assert "limited on both sides" in propose(lot_database, "--batch", "golden", "--measurement", "noise_floor")[1]


def test_what_has_no_spread_gets_no_limit_and_is_listed(lot_database, document, refused):
    found = document(lot_database, "--batch", "golden", "--all")
    assert [limit["measurement"] for limit in found["not_proposed"]] == ["missed_loads"]
    assert "every sensor has 0" in found["not_proposed"][0]["why"]
    refused(lot_database, "--batch", "golden", "--measurement", "missed_loads", said=["every sensor has 0"])


def test_the_table_says_what_every_number_rests_on(lot_database, propose):
    code, out, err = propose(lot_database, "--batch", "golden", "--all")
    assert code == 0
    assert err == ""
    for words in (
        "12 sensors, 18 runs at bench-α (SIMULATED)",
        "99 % of good sensors, with 95 % confidence, if the condition in the notes holds",
        "holds for normal, log-normal, Weibull and gamma distributions of a run's worst value, and for tails up to",
        "Student's t with 5 degrees of freedom. No condition is needed from 299 sensors on for one bound, from 473",
        "Student's t, 5 degrees of freedom 87 91 94",
        "the 3 together may fail up to 3 %",
        "JCGM 106",
        "upper largest of 9 log-normal",
        "repeatability of 6 repeated runs 6",
        "consumer's",
        "≤ 6.5",
        "0 → 0 of 12",
        "missed_loads: no limit is proposed: every sensor has 0",
    ):
        assert words in " ".join(out.split()), words
    assert max(len(line) for line in out.splitlines() if not line.startswith("    ")) <= 100


def test_coverage_confidence_and_distribution_move_the_limits(lot_database, document):
    def upper(*arguments):
        chosen = ("--batch", "golden", "--measurement", "centre_of_mass_error")
        return document(lot_database, *chosen, *arguments)["limits"][0]["upper"]

    assert upper("--coverage", 90) < upper() < upper("--confidence", 99)
    assert upper("--distribution", "normal") < upper("--distribution", "log-normal") <= upper()
    assert upper("--distribution", "log-normal") < upper("--distribution", "heavy")


def test_each_limit_has_the_condition_of_its_promise(lot_database, document):
    def condition(*arguments):
        return document(lot_database, "--batch", "golden", "--measurement", "drift", *arguments)["limits"][0][
            "condition"
        ]

    assert "Student's t with 5 degrees" in condition()
    assert condition("--distribution", "normal") == "if sensors are normal, as stated"
    assert condition("--distribution", "heavy") == "for tails up to those of Student's t with 3 degrees of freedom"
    assert condition("--coverage", 60, "--confidence", 50) == "whatever the distribution of sensors is"


def test_a_lot_that_looks_heavier_tailed_than_its_condition_is_called_so():
    ask = Ask(0.99, 0.95, False, True, None)
    normal = stats.norm.ppf((np.arange(30) + 0.5) / 30).tolist()
    heavy = stats.t.ppf((np.arange(30) + 0.5) / 30, 1.5).tolist()
    for values, looks_heavy in ((normal, False), (heavy, True)):
        runs = [[10 + value] for value in values]
        bound = lot_limits(runs, runs, 1, ask).upper
        assert (bound.distribution, _looks_heavy(bound)) == (Distribution.SEVERAL, looks_heavy)


def test_a_lot_is_chosen_by_name_day_recipe_or_file(lot_database, tmp_path, document):
    names = ["S-01", "S-03", "S-05", "S-07"]

    def sensors(*arguments):
        return list(document(lot_database, *arguments)["lot"]["sensors"])

    assert sensors(*(word for name in names for word in ("--serial", name))) == names
    (tmp_path / "good.txt").write_text("# chosen by hand\n" + "\n".join(names[:3]) + "  # last\n\nS-07\n")
    assert sensors("--serials", tmp_path / "good.txt") == names
    assert sensors("--recipe", "short", "--without", "S-12") == [f"S-{k:02d}" for k in range(1, 12)]
    assert sensors("--since", "2026-11-22") == [f"S-{k:02d}" for k in range(1, 7)]  # second runs
    assert len(sensors("--until", "2026-11-21")) == 12


def test_the_file_is_a_version_of_limits_that_a_recipe_takes_in(lot_database, tmp_path, propose):
    file = tmp_path / "golden-1.toml"
    chosen = ("--batch", "golden", "--limits-version", "golden-1", "--output", file)
    code, _, err = propose(lot_database, *chosen)
    assert code == 0
    assert "2 limits, version golden-1" in err
    written = tomllib.loads(file.read_text())
    assert written["limits_version"]["limits_sha256"] == limits_digest(written["limits"])
    assert written["limits_version"]["serials"] == [f"S-{k:02d}" for k in range(1, 13)]
    shipped = open_document(DocumentKind.RECIPE, "nine-locations").text
    own = shipped[: shipped.index("[[limits]]")].replace(
        "[[phases]]", f'limits_from = "{file.name}"\n\n[[phases]]', 1
    )
    (tmp_path / "own.toml").write_text(own)
    recipe = load_recipe(tmp_path / "own.toml").value
    assert [limit.measurement for limit in recipe.limits] == ["centre_of_mass_error", "drift"]
    assert {limit.version for limit in recipe.limits} == {"golden-1"}
    assert recipe.limits_version.sealed
    assert recipe.limits_version.coverage_percent == 99


def test_the_same_lot_gives_the_same_limits_and_another_datum_another_version(lot_database, database, document):
    first, again = (document(lot_database, "--batch", "golden") for _ in range(2))
    assert first == again
    assert first["version"].endswith(first["data_sha256"][:8])
    fewer = document(lot_database, "--batch", "golden", "--without", "S-12")
    assert fewer["data_sha256"] != first["data_sha256"]
    assert fewer["lot"]["left_out"] == ["S-12"]


def test_what_the_present_limit_does_to_the_lot_is_counted(database, document):
    tight = {"drift": Limit("drift", "%/min", None, 0.0)}
    values = [-0.03, -0.02, -0.01, 0.01, 0.02, 0.04]
    runs = [(f"S-{k}", judged((Measurement("drift", x, "%/min"),), tight), {}) for k, x in enumerate(values, start=1)]
    found = document(database(*runs), "--batch", "golden", "--include-failed")["limits"][0]
    assert found["lot_fails_present"] == ["S-4", "S-5", "S-6"]
    assert found["lot_fails"] == []
    assert found["lower"] is None  # limited above only, as now
    assert found["upper"] > 0.04


def test_a_sensor_far_out_is_named_and_kept(database, document, propose):
    far = replace_value(sensor(9), "drift", 0.45)
    runs = [*lot(12), ("S-far", far, {})]
    path = database(*runs)
    chosen = ("--batch", "golden", "--measurement", "drift", "--confidence", 50, "--coverage", 80)
    _, out, err = propose(path, *chosen)
    assert "S-far" in out + err
    found = document(path, *chosen, "--without", "S-far")["limits"][0]
    assert found["far_out"] == []
    assert found["upper"] < 0.45


def test_guard_bands_that_leave_nothing_between_two_limits_are_not_proposed(database, document):
    runs = []
    for k in range(1, 7):
        taken = Measurement("drift", 0.01 * (k - 3.5), "%/min", 0.2)
        runs.append((f"S-{k}", judged((taken,), {"drift": LIMITS["drift"]}), {}))
    found = document(database(*runs), "--batch", "golden")["limits"][0]
    assert found["marginal"] == 0
    assert "would leave nothing between the limits" in found["uncertainty"]["source"]


def test_a_lower_limit_that_fails_nothing_is_said_to(database, propose):
    runs = [(f"S-{k}", (Measurement("ringing", 0.1 * k, "1"),), {}) for k in range(1, 7)]
    _, out, _ = propose(database(*runs), "--batch", "golden")
    assert "no value can fail it" in " ".join(out.split())
    assert "Then --distribution log-normal gives one above 0" in " ".join(out.split())


def test_an_upper_limit_above_all_of_a_share_is_said_to_fail_nothing(database, propose):
    runs = [(f"S-{k}", (Measurement("area_overlap", 80.0 + 4 * (k % 5), "%"),), {}) for k in range(1, 11)]
    _, out, _ = propose(database(*runs), "--batch", "golden")
    assert "area_overlap: the upper limit is not below 100 %, which no value exceeds" in " ".join(out.split())


@pytest.mark.parametrize(("sensors", "warned"), [(3, "3 sensors are few: a limit lies 10.6 deviations"), (10, "")])
def test_few_sensors_are_warned_of(database, propose, sensors, warned):
    _, out, _ = propose(database(*lot(sensors)), "--batch", "golden", "--measurement", "drift")
    words = " ".join(out.split())
    assert (warned in words) if warned else ("sensors are few" not in words)


@pytest.mark.parametrize(("ratios", "sizeless"), [(0.8, []), (0.05, ["area_overlap"])])
def test_an_overlap_whose_size_is_not_bounded_is_said_to_be_none_for_a_recipe(database, document, ratios, sizeless):
    runs = []
    for k in range(1, 9):
        overlap = Measurement("area_overlap", 70 + 0.5 * (k % 5), "%")
        runs.append((f"S-{k}", (overlap, Measurement("area_ratio", ratios + 0.02 * (k % 5), "1")), {}))
    found = document(database(*runs), "--batch", "golden", "--distribution", "normal")
    assert found["without_size"] == sizeless


def test_risks_are_not_made_up_where_the_uncertainty_explains_the_lot(database, document, propose):
    runs = []
    for k in range(1, 9):
        taken = Measurement("settling", 30 + 0.3 * (k % 5) + 0.1 * k, "s", 1.5)
        runs.append((f"S-{k}", judged((taken,), {"settling": Limit("settling", "s", None, 60.0)}), {}))
    path = database(*runs)
    found = document(path, "--batch", "golden")["limits"][0]
    assert (found["risks"], found["no_risks"]) == (None, "the uncertainty of a run explains all of the lot's spread")
    assert found["marginal"] == pytest.approx(3.0)
    assert "explains all of the lot's spread" in " ".join(propose(path, "--batch", "golden")[1].split())
