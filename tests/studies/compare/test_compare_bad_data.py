"""``cbsr-qa compare`` on stored lots that are bad or too few: what it names, leaves out and refuses."""

from dataclasses import replace
from datetime import datetime

import numpy as np
import pytest
from compared_fleets import ERROR, compared, fleet, json_of, metric
from stored_lots import judged, measured, store_run

from cbsr_qa.domain.errors import RefusedError
from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.results.fleet import RunSelection
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa.store.opening import open_store
from cbsr_qa.studies.compare.terms import By, read_amounts


@pytest.mark.rest
def test_one_batch_is_described_and_compared_with_nothing(two):
    made = compared(two, groups=("41",))
    assert made.exit_code == 3
    assert "There is only one batch, 41" in json_of(made)["warnings"][0]
    assert json_of(made)["distributions"][0]["n"] == 12


def test_one_sensor_and_no_variance_are_named(url):
    random = np.random.default_rng(4)
    with open_store(url, durable=False) as store:
        for serial, batch in (("S-1", "41"), ("S-2", "42")):
            store_run(store, serial, judged(measured(random, random.standard_normal(3))), batch=batch)
    document = json_of(compared(url))
    assert "41 has only one sensor, which does not show how sensors differ" in document["warnings"]
    reasons = {m["name"]: m["warnings"][0] for m in document["metrics"]}
    assert "2 sensors are too few to judge 2 effects" in reasons["drift"]
    assert "all 2 values are 0: there is no variance" in reasons["missed_loads"]


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
    assert "fewer than 9 values, the mean is of the rest: M-1 (1 run)" in said
    assert "only a lower bound is known, left out: M-3 (1 run)" in said
    assert "measured in 10⁻³ instead of 1, left out: M-4 (1 run)" in " ".join(metric(made, "noise_floor")["warnings"])
    counts = {d["name"]: d["n"] for d in json_of(made)["distributions"] if d["group"] == "41"}
    assert counts == {ERROR: 15, "drift": 14, "noise_floor": 15, "missed_loads": 15}


@pytest.mark.rest
def test_mixed_software_is_named_and_can_be_compared(two):
    random = np.random.default_rng(6)
    with open_store(two, durable=False) as store:
        for number in range(4):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"N-{number}", values, batch="42", station="A", software=[("cbsr-qa", "0.2.0")])
    (warning,) = (w for w in json_of(compared(two))["warnings"] if "software" in w)
    assert "cbsr-qa 0.1.0, numpy 2.0 (32 runs)" in warning
    names = [g["name"] for g in json_of(compared(two, By.SOFTWARE))["groups"]]
    assert names == ["cbsr-qa 0.1.0, numpy 2.0", "cbsr-qa 0.2.0"]


@pytest.mark.rest
def test_a_clock_that_is_wrong_by_a_year_is_named(two):
    random = np.random.default_rng(7)
    with open_store(two, durable=False) as store:
        for number in range(3):
            values = judged(measured(random, random.standard_normal(3)))
            store_run(store, f"Y-{number}", values, batch="41", station="A", day=-365)
        store_run(store, "Z-1", values, batch="41", station="B", day=365)
        store_run(store, "C-1", values, batch="41", station="C", day=-300)
    warnings = json_of(compared(two))["warnings"]
    assert any("The clock of station A was set back: 3 runs (Y-0, Y-1, Y-2)" in words for words in warnings)
    assert any("The clock of station B was wrong: 1 run (Z-1) began on 2027-11-21" in words for words in warnings)
    assert any(
        "The clock of station C may be wrong: by it, batch 41 ran 300 days away" in words for words in warnings
    )
    assert any("Periods are taken from these clocks" in w for w in json_of(compared(two, By.PERIOD))["warnings"])


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
        compared(url, choice=RunSelection(recipe="shrot"))
    assert "did you mean 'short'? recipes: short" in raised.value.remedy
    with pytest.raises(RefusedError, match="no stored run fits"):
        compared(url, choice=RunSelection(until=datetime(2020, 1, 1).date()))


@pytest.mark.parametrize("said", ["drift", "drift=", "=1", "drift=0", "drift=-1", "drift=nan", "drift=inf"])
def test_margins_that_are_none_are_refused(said):
    with pytest.raises(RefusedError, match="not METRIC=VALUE"):
        read_amounts([said], "--margin")
    assert read_amounts(["a=b=0.5"], "--margin") == {"a=b": 0.5}
