"""Metrics of loads: places, shapes, forces and settling times that follow from loads made by hand."""

from dataclasses import replace

import numpy as np
import pytest
from observation_samples import SETTINGS, sample_load, sample_relaxation, sample_run

from cbsr_qa.domain.plan.limits import Bound
from cbsr_qa_plugins.metrics.location import AreaOverlap, CentreOfMassError, ShapeDeviation
from cbsr_qa_plugins.metrics.mechanics import AppliedForce
from cbsr_qa_plugins.metrics.relaxation import SettlingTimes


def test_spatial_metrics_of_a_shifted_disc():
    load = sample_load("L1", (30.0, 0.0), blob_mm=(32.0, 0.0, 6.5), trial=2, index=7)
    run = sample_run((load,))
    (other, main) = CentreOfMassError().measure_load(load, run)
    assert (main.name, main.unit) == ("centre_of_mass_error", "mm")
    assert (main.phase, main.location, main.trial, main.load, main.strain) == ("nine locations", "L1", 2, 7, 0.2)
    assert main.value == pytest.approx(2.0)
    assert (main.qualifier, other.qualifier) == ("", "mask 25 %")
    overlap, ratio = AreaOverlap().measure_load(load, run)[2:]
    assert (overlap.name, overlap.unit, ratio.name, ratio.unit) == ("area_overlap", "%", "area_ratio", "1")
    assert overlap.value == pytest.approx(80.49, abs=0.02)
    assert ratio.value == pytest.approx(1.0, abs=1e-3)
    assert overlap.how.startswith("band good; A_b/A_FA 1.00; exact clipping")
    deviation = ShapeDeviation().measure_load(load, run)[1]
    assert (deviation.name, deviation.unit) == ("shape_deviation", "mm²")
    assert deviation.value == pytest.approx(1.99, abs=0.005)


def test_settings_of_the_recipe_decide_how_shape_and_overlap_are_taken():
    load = sample_load(blob_mm=(2.0, 0.0, 6.5))
    run = replace(sample_run((load,)), settings=replace(SETTINGS, clipping="centroid", perimeter="nodes"))
    assert "centroid clipping" in AreaOverlap().measure_load(load, run)[2].how
    assert "nodes" in ShapeDeviation().measure_load(load, run)[1].how


def test_a_blob_of_the_wrong_size_is_no_ok():
    load = sample_load(blob_mm=(0.0, 0.0, 13.0))
    overlap = AreaOverlap().measure_load(load, sample_run((load,)))[2]
    assert overlap.value == pytest.approx(62.5, abs=0.1)
    assert overlap.how.startswith("band likely poor: size")


@pytest.mark.parametrize("metric", [CentreOfMassError(), AreaOverlap(), ShapeDeviation()])
def test_without_a_blob_there_is_no_value_but_a_reason(metric):
    load = sample_load(blob_mm=None)
    measured = metric.measure_load(load, sample_run((load,)))
    assert measured
    assert all(m.value is None and m.how.startswith("not detected") for m in measured)


def test_force_and_its_absence():
    load = sample_load(force_N=2.5)
    (force,) = AppliedForce().measure_load(load, sample_run((load,)))
    assert (force.name, force.value, force.unit, force.uncertainty) == ("force", 2.5, "N", 0.01)
    (absent,) = AppliedForce().measure_load(sample_load(force_N=None), sample_run())
    assert absent.value is None


def test_settling_times_with_censored_and_rejected_ones():
    times = (20.0, 30.0, 60.0, None)
    loads = tuple(
        replace(
            sample_load(f"L{i}"),
            relaxations=(sample_relaxation(t, censored=t == 60.0), sample_relaxation(5.0 + i, signal="stress")),
        )
        for i, t in enumerate(times)
    )
    run = sample_run(loads)
    each = [SettlingTimes().measure_load(load, run)[0] for load in loads]
    assert [(m.value, m.bound is Bound.LOWER) for m in each] == [(t, t == 60.0) for t in times]
    assert [m.qualifier for m in each] == ["conductance, loading"] * 4
    mean, stress = SettlingTimes().measure_run(run)[:2]
    assert (mean.name, mean.unit, mean.qualifier) == ("mean_settling_time", "s", "conductance, loading")
    assert mean.value == pytest.approx((20 + 30 + 60) / 3)
    assert mean.bound is Bound.LOWER
    assert mean.how.startswith("2 of 4 settled, 1 later than its window, 1 rejected; standard deviation")
    assert stress.value == pytest.approx(6.5)
    assert stress.bound is Bound.EXACT


@pytest.mark.parametrize(("times", "known"), [([20.0, None], True), ([20.0, None, None], False), ([None], False)])
def test_a_mean_needs_a_time_from_half_of_the_loads(times, known):
    loads = tuple(replace(sample_load(), relaxations=(sample_relaxation(time_s),)) for time_s in times)
    mean = SettlingTimes().measure_run(sample_run(loads))[0]
    assert (mean.value is not None) == known
    assert f"of {len(times)} settled, {times.count(None)} rejected" in mean.how
    assert ("fewer than half" in mean.how) == (not known)


def test_the_common_settling_time_is_of_all_traces_together():
    time_s = 1.25 + 2.5 * np.arange(24)
    random = np.random.default_rng(17)

    def relaxation(level, loading):
        seen = sample_relaxation(20.0, loading=loading)
        clean = (1 - 0.75 * np.exp(-time_s / 20)) if loading else 0.8 * np.exp(-time_s / 25)
        values = level * (clean + 0.01 * random.standard_normal(24))
        return replace(seen, trace=replace(seen.trace, time_s=time_s, values=values))

    loads = tuple(
        replace(sample_load(index=k), relaxations=(relaxation(0.5 + k, True), relaxation(0.5 + k, False)))
        for k in range(4)
    )
    loading, unloading = SettlingTimes().measure_run(sample_run(loads))[2:]
    assert (loading.name, loading.qualifier) == ("common_settling_time", "conductance, loading")
    assert loading.value == pytest.approx(20 * np.log(0.75 / 0.15), abs=3 * loading.uncertainty)
    # The hold ends at 1 − 0.75 e^(−57.5 / 20) or so of the steady change, and the band is of that.
    end = 1 - 0.75 * np.exp(-54 / 20)
    assert unloading.value == pytest.approx(25 * np.log(0.8 / (0.15 * end)), abs=3 * unloading.uncertainty)
    assert loading.uncertainty < 1.0


def test_without_traces_there_is_no_common_settling_time():
    seen = sample_relaxation(20.0)
    short = replace(seen, trace=replace(seen.trace, time_s=np.arange(3.0), values=np.ones(3)))
    common = SettlingTimes().measure_run(sample_run((replace(sample_load(), relaxations=(short,)),)))[1]
    assert common.value is None
