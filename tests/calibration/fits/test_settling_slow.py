"""A sheet that returns far more slowly than it is watched must never be reported as a quick one."""

from dataclasses import replace

import pytest
import simulated_runs

from cbsr_qa.analysis.evaluate import judge
from cbsr_qa.config.loader import load_material, load_recipe
from cbsr_qa.domain.plan.limits import Bound, Outcome
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM
from cbsr_qa_plugins.metrics.relaxation import SettlingTimes

_WINDOW_S = 55.0  # of a rest of 60 s, but for the head's way up


def _measured(monkeypatch, unloading_s):
    """Means and common settling times of nine presses whose return has this slow time constant."""
    loaded = load_material("cbsr-8wt")
    kernel = replace(loaded.value.unloading_relaxation, time_constants_s=(2.5, unloading_s))
    slow = replace(loaded, value=replace(loaded.value, unloading_relaxation=kernel))
    monkeypatch.setattr(simulated_runs, "load_material", lambda _: slow)
    recipe = load_recipe("nine-locations").value
    observation = simulated_runs.observed_run(simulated_runs.simulated_run(NINE_LOCATIONS_MM))
    metric = SettlingTimes()
    each = [m for load in observation.loads for m in metric.measure_load(load, observation)]
    shipped = [limit for limit in recipe.limits if limit.measurement == "common_settling_time"]
    assert {limit.qualifier for limit in shipped} == {"conductance, loading", "conductance, unloading"}
    limits = [replace(limit, measurement=f"{name}_settling_time") for limit in shipped for name in ("common", "mean")]
    return each, judge(metric.measure_run(observation), limits)


def _one(measured, name, qualifier):
    return next(m for m in measured if (m.name, m.qualifier) == (name, qualifier))


@pytest.mark.rest
def test_a_slow_return_is_a_lower_bound_and_never_passes(monkeypatch):
    each, measured = _measured(monkeypatch, 120.0)
    unloading = [m for m in each if m.qualifier == "conductance, unloading"]
    # 62 % of the change under load fade with 120 s: two fifths are left after a minute.
    assert not [m for m in unloading if m.bound is Bound.EXACT and m.value is not None]
    for name in ("mean_settling_time", "common_settling_time"):
        found = _one(measured, name, "conductance, unloading")
        assert found.outcome not in (Outcome.PASS, Outcome.MARGINAL)
        assert found.value is None or (found.bound is Bound.LOWER and found.value > _WINDOW_S)
