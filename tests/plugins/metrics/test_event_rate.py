"""Presses a minute from settling times: the paper's arithmetic, and what has no rate."""

import pytest

from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa.domain.results.measurement import Measurement
from cbsr_qa_plugins.metrics import relaxation as event_rate
from cbsr_qa_plugins.metrics.relaxation import EventRate


def settled(direction, value, uncertainty=None, bound=Bound.EXACT, how=""):
    return Measurement(
        "common_settling_time", value, "s", uncertainty, qualifier=f"conductance, {direction}", bound=bound, how=how
    )


@pytest.fixture
def rates(monkeypatch):
    def of(*times):
        settling = type("Settling", (), {"measure_run": lambda self, run: times})
        monkeypatch.setattr(event_rate, "SettlingTimes", settling)
        return {found.qualifier: found for found in EventRate().measure_run(None)}

    return of


def test_thirty_and_forty_seconds(rates):
    found = rates(settled("loading", 30.0, 2.0), settled("unloading", 40.0, 1.0))
    assert found["waiting"].value == pytest.approx(60 / 105)
    assert found["compensated"].value == pytest.approx(60 / 69)
    # σ of the period: √((1.5 · 2)² + (1.5 · 1)²)
    assert found["waiting"].uncertainty == pytest.approx(60 / 105**2 * 11.25**0.5)


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ((settled("loading", 30.0),), "no relaxation of unloading was seen"),
        (
            (settled("loading", None, how="no trace"), settled("unloading", 30.0)),
            "no settling time of loading: no trace",
        ),
        ((settled("loading", 30.0), settled("unloading", 60.0, bound=Bound.LOWER)), "later than its window of 60 s"),
        ((settled("loading", 0.0), settled("unloading", 0.0)), "frames limit the rate"),
    ],
)
def test_what_has_no_rate_says_why(rates, times, said):
    for found in rates(*times).values():
        assert found.value is None
        assert said in found.how


def test_other_signals_do_not_count(rates):
    stress = Measurement("common_settling_time", 5.0, "s", qualifier="stress, loading")
    assert rates(stress)["waiting"].value is None
