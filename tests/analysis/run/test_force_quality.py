"""Errors of force, the mean of a map and the gauge factor of a sheet: exact cases and known truth."""

from dataclasses import replace

import numpy as np
import pytest
from drawn import drawn
from hypothesis import given, strategies as st
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.run import force_quality
from cbsr_qa.analysis.run.force import TRIAL_LEFT_OUT, run_force
from cbsr_qa.analysis.run.force_quality import FEWEST_COVERED, ForceErrors, calibration_radius_mm, map_quality
from cbsr_qa.calibration.fits.common_relaxation import fit_common_relaxation
from cbsr_qa.calibration.sheet.characteristic import sheet_gauge_factor, steady_share
from cbsr_qa.calibration.sheet.response_map import average_response, learn_response
from cbsr_qa.config.loader import load_material
from cbsr_qa.domain.errors import CalibrationError, NumericsError
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.loads import NINE_LOCATIONS_MM, Load
from cbsr_qa.domain.results.measurement import decide
from cbsr_qa.domain.results.report import Figure, Paragraph, Table
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.domain.sensor.sensor_type import Parameter, QuasiStatic
from cbsr_qa.report.svg import check_svg
from cbsr_qa.report.tables import number
from cbsr_qa_plugins.metrics.force import ForceError
from cbsr_qa_plugins.sections.force import Force
from cbsr_qa_plugins.sections.time_and_accuracy import TimeAndAccuracy

_GAUGE = 0.85  #: of the simulated sensor over that of the material the analysis is told
_PLACES = np.array([(x, y) for x in (-30.0, 0.0, 30.0) for y in (-30.0, 0.0, 30.0)])
_LINE = QuasiStatic(Parameter(0.6, None, "test"), Parameter(0.0, None, "test"))


def _errors(error_N, stderr_N):
    error_N = np.asarray(error_N, dtype=np.float64)
    return ForceErrors((), 0, error_N, np.broadcast_to(stderr_N, error_N.shape).astype(np.float64))


def test_deviation_and_bias_of_four_loads_are_those_of_the_textbook():
    found = _errors([1.0, 2.0, 3.0, 4.0], 1.0)
    assert found.bias().value == pytest.approx(2.5)
    assert found.bias().stderr == pytest.approx(np.sqrt(5 / 3) / 2)
    assert found.deviation().value == pytest.approx(np.sqrt(5 / 3))


@given(st.integers(5, 300))
def test_the_error_of_a_deviation_is_never_below_a_normal_samples(count):
    found = _errors(np.random.default_rng(count).normal(size=count), 1.0).deviation()
    # Var s² = 2 σ⁴/(n − 1) of a normal sample, hence s/√(2(n − 1)) to first order; the sum is over n, not n − 1.
    assert found.stderr >= found.value / np.sqrt(2 * (count - 1)) * np.sqrt((count - 1) / count) * (1 - 1e-9)


def test_the_error_of_a_deviation_is_what_repetitions_scatter_by():
    draws = np.random.default_rng(3)
    found = [_errors(draws.normal(size=40), 1.0).deviation() for _ in range(2000)]
    scatter = np.std([one.value for one in found])
    assert np.mean([one.stderr for one in found]) == pytest.approx(scatter, rel=0.1)


@pytest.mark.parametrize("count", [0, 1])
def test_one_load_has_no_deviation(count):
    with pytest.raises(NumericsError, match="two are needed"):
        _errors([0.1] * count, 1.0).deviation()


def test_equal_errors_are_a_bias_without_deviation():
    found = _errors([0.25] * 5, 1.0)
    assert found.deviation().value == 0
    assert found.bias().value == 0.25


def test_coverage_counts_and_says_nothing_of_few():
    stated = _errors([0.5] * 21 + [1.5] * 9, 1.0)
    assert stated.coverage(1.0, 0.6827).value == pytest.approx(0.7)
    assert stated.coverage(1.96, 0.95).value == 1.0
    with pytest.raises(NumericsError, match=f"at least {FEWEST_COVERED}"):
        _errors([0.5] * (FEWEST_COVERED - 1), 1.0).coverage(1.0, 0.6827)


@pytest.fixture(scope="module")
def learned_map():
    noise = np.random.default_rng(5).normal(0, 0.02, len(_PLACES))
    values = 0.1 * np.sin(_PLACES[:, 0] / 20) + noise
    return learn_response(_PLACES, values, np.full(len(_PLACES), 0.02**2), radius_mm=50.0)


def test_the_average_over_one_place_is_the_map_there(learned_map):
    place = np.array([[12.0, -7.0]])
    mean, variance = learned_map.predict(place)
    assert average_response(learned_map, place) == pytest.approx((mean[0], variance[0]))


def test_the_average_is_the_mean_of_the_map_and_surer_than_its_places(learned_map):
    places = np.random.default_rng(6).uniform(-40, 40, (60, 2))
    mean, variance = learned_map.predict(places)
    found, error = average_response(learned_map, places)
    assert found == pytest.approx(mean.mean())
    assert 0 < error < variance.mean()


def test_repeated_places_do_not_make_an_average_surer(learned_map):
    places = np.array([[5.0, 5.0], [-20.0, 30.0]])
    once, often = average_response(learned_map, places), average_response(learned_map, np.repeat(places, 7, axis=0))
    assert often == pytest.approx(once)


@drawn(12)
@given(st.floats(0.1, 3.0), st.sampled_from([1.0, -1.0]))
def test_loads_of_an_even_sheet_give_its_gauge_factor(factor, sign):
    line = QuasiStatic(Parameter(sign * 0.6, None, "test"), Parameter(0.0, None, "test"))
    strain = np.linspace(0.05, 0.3, len(_PLACES))
    seen, variance = sign * factor * 0.6 * strain, np.full(len(_PLACES), 1e-8)
    found = sheet_gauge_factor(_PLACES, seen, variance, strain, line, radius_mm=50.0, sheet_mm=_PLACES)
    assert found.value == pytest.approx(sign * factor * 0.6, rel=2e-3)
    assert 0 < found.stderr < 0.02 * factor


def test_an_intercept_nobody_told_of_does_not_enter_the_gauge_factor():
    strain = np.tile([0.05, 0.15, 0.3], 9)
    places = np.repeat(_PLACES, 3, axis=0)
    found = sheet_gauge_factor(
        places, 0.5 * strain - 0.004, np.full(27, 1e-6), strain, _LINE, radius_mm=50.0, sheet_mm=_PLACES
    )
    assert found.value == pytest.approx(0.5, rel=3e-3)  # as an error of β_ε is taken to first order
    assert found.stderr < 0.01


@pytest.mark.parametrize("strain", [np.full(9, 0.1), np.linspace(0.05, 0.3, 9)])
def test_loads_where_the_line_is_zero_or_turned_say_nothing_of_a_gauge_factor(strain):
    line = QuasiStatic(Parameter(0.6, 0.01, "test"), Parameter(-0.06, 0.01, "test"))
    with pytest.raises(CalibrationError, match="predicts no change of the sign seen"):
        sheet_gauge_factor(
            _PLACES[:9], np.full(9, 0.05), np.full(9, 1e-4), strain, line, radius_mm=50.0, sheet_mm=_PLACES
        )


def test_where_a_hold_ends_follows_from_its_exponentials():
    time_s = np.arange(0, 60, 2.5)
    noise = np.random.default_rng(1)
    traces = [
        (time_s, size * (1 - 0.2 * np.exp(-time_s / 2.5) - 0.5 * np.exp(-time_s / 20)) + noise.normal(0, 1e-4, 24))
        for size in (0.05, 0.1, 0.2)
    ]
    late = time_s[-4:]
    found = steady_share(fit_common_relaxation(traces), late)
    expected = 1 / (1 - 0.5 * np.exp(-late / 20).mean())
    assert found.value == pytest.approx(expected, abs=max(4 * found.stderr, 1e-6))
    assert found.stderr < 5e-3


def test_a_trace_without_relaxation_has_no_known_end():
    time_s = np.arange(0, 60, 2.5)
    with pytest.raises(NumericsError, match="not known where holds end"):
        steady_share(fit_common_relaxation([(time_s, np.full(24, 0.1))]), time_s[-4:])


def _loads():
    """Nine locations at three strains, four of them in a second trial, and five places that do not calibrate."""
    strains = (0.1, 0.2, 0.3)
    grid = [Load(f"L{k}", x, y, strains[k % 3], 0) for k, (x, y) in enumerate(NINE_LOCATIONS_MM)]
    again = [replace(load, trial=1) for load in grid[1:5]]
    others = ((8.0, -12.0, 0.25), (-20.0, 5.0, 0.1), (17.0, 19.0, 0.15), (-6.0, 27.0, 0.3), (3.0, 8.0, 0.2))
    return (*grid, *again, *(Load(f"R{k}", *place, 0) for k, place in enumerate(others)))


@pytest.fixture(scope="module")
def observed():
    record = simulated_run((), loads=_loads(), gauge=_GAUGE, hold_s=50.0, rest_s=50.0)
    (phase,) = record.phases
    grid = replace(phase, role=Role.GRID, loads=phase.loads[:13])
    random = replace(phase, index=1, name="random", role=Role.RANDOM, loads=phase.loads[13:])
    record = replace(record, material=load_material("cbsr-8wt").value, phases=(grid, random))
    return observed_run(record, calibrate_phases=("grid",))


@pytest.fixture(scope="module")
def measured(observed):
    found = ForceError().measure_run(observed)
    assert {m.name for m in found} == set(ForceError.measures)
    assert all(m.unit == ForceError.measures[m.name] for m in found)
    return {(m.name, m.qualifier): m for m in found}


@pytest.mark.rest
def test_the_gauge_factor_of_a_sensor_unlike_its_material_is_found(measured):
    found = measured[("gauge_factor", "sheet")]
    truth = 0.6 * _GAUGE
    assert found.value == pytest.approx(truth, rel=0.03)
    assert abs(found.value - truth) < 3 * found.uncertainty


def test_force_is_told_within_its_stated_errors(measured):
    for qualifier in ("place known", "place estimated", "place known, trial left out"):
        deviation, bias = (measured[(f"force_error_{what}", qualifier)] for what in ("sd", "bias"))
        assert deviation.value < 0.15
        assert abs(bias.value) < 0.1
        assert deviation.uncertainty > 0
    assert measured[("force_error_sd", "place known")].how.startswith("5 loads of random")


def test_only_places_of_several_trials_test_a_trial_that_is_left_out(observed, measured):
    found = [test for test in run_force(observed).tests if test.how == TRIAL_LEFT_OUT]
    assert sorted(test.load.record.load.label for test in found) == sorted(["L1", "L2", "L3", "L4"] * 2)
    assert force_quality.tests_of(observed, run_force(observed), TRIAL_LEFT_OUT) == tuple(found)
    assert measured[("force_error_sd", "place known, trial left out")].how.startswith("8 loads of grid")


def test_five_loads_say_nothing_of_coverage(measured):
    found = measured[("force_coverage_95", "place known")]
    assert found.value is None
    assert "of 5 loads" in found.how


def test_an_even_sheet_is_found_even_and_its_detection_is_worst_where_fields_are_weakest(measured):
    assert measured[("response_uniformity", "")].value < 5
    centre, worst = (measured[("minimum_detectable_force", where)].value for where in ("centre", "worst place"))
    assert 0 < centre <= worst < 2


def test_a_map_of_loads_at_one_place_is_looked_at_there(observed):
    found = map_quality(run_force(observed).learned, 0.0)
    np.testing.assert_allclose(found.places_mm, [[0.0, 0.0]], atol=1e-9)
    assert found.spread == pytest.approx(found.rms_error)
    assert found.least_sure_mm == pytest.approx((0.0, 0.0), abs=1e-9)


def _section(run, measurements):
    result = RunResult(run.record, run, measurements, decide(measurements), None, "test")
    return Force().render(result)


def test_the_section_shows_map_errors_and_line(observed, measured):
    section = _section(observed, tuple(measured.values()))
    figures = [block for block in section.blocks if isinstance(block, Figure)]
    assert len(figures) == 3
    for figure in figures:
        check_svg(figure.svg)
        assert "nan" not in figure.svg.lower()
    words = " ".join(block.text for block in section.blocks if isinstance(block, Paragraph))
    assert "13 of 13 loads" in words
    assert "On 5 held-out loads" in words
    (table,) = [block for block in section.blocks if isinstance(block, Table)]
    assert [row[0].text for row in table.rows][:2] == ["place known", "place estimated"]


@pytest.mark.rest
def test_the_report_says_what_fewer_places_would_have_told(observed, measured):
    result = RunResult(observed.record, observed, tuple(measured.values()), decide(()), None, "test")
    section = TimeAndAccuracy().render(replace(result, compute_s=(("imaging", 1.0),)))
    table = [block for block in section.blocks if isinstance(block, Table)][-1]
    rows = [[cell.text for cell in row] for row in table.rows]
    assert [row[:2] for row in rows[-2:]] == [["9", "9"], ["9", "13"]]  # one load a place, and all
    assert [int(row[0]) for row in rows] == [4, 6, 9, 9]
    assert [row[4] for row in rows[-2:]] == ["–", "–"]
    words = " ".join(block.text for block in section.blocks if isinstance(block, Paragraph))
    assert "for 13 loads at 9 places" in words
    quality = map_quality(run_force(observed).learned, calibration_radius_mm(run_force(observed)))
    assert rows[-1][3] == number(100 * quality.rms_error, 2)
    blind = replace(result, compute_s=(("imaging", 1.0),), measurements=())
    assert "Left out" not in str(TimeAndAccuracy().render(blind).blocks)


@pytest.mark.rest
def test_loads_that_are_refused_are_named_with_their_reason(observed):
    blind = tuple(replace(load, force_N=0.0) if load.record.load.label == "L3" else load for load in observed.loads)
    run = replace(observed, loads=blind)
    table = [block for block in _section(run, ForceError().measure_run(run)).blocks if isinstance(block, Table)][-1]
    assert {(row[1].text, row[-1].text) for row in table.rows} == {("L3", "no force was measured")}


def test_a_run_without_forces_has_no_value_and_says_why(observed):
    run = replace(observed, loads=tuple(replace(load, force_N=None) for load in observed.loads))
    found = ForceError().measure_run(run)
    assert {m.name for m in found} == set(ForceError.measures)
    assert all(m.value is None and "force" in m.how for m in found)
    (words,) = _section(run, found).blocks
    assert words.tone == "warning"
    assert "no load was pressed alone with its force recorded" in words.text


@pytest.mark.rest
def test_loads_of_a_run_that_holds_none_out_are_not_tested(observed):
    settings = replace(observed.settings, calibrate_phases=("grid", "random"))
    found = {(m.name, m.qualifier): m for m in ForceError().measure_run(replace(observed, settings=settings))}
    assert found[("force_error_sd", "place known")].value is None
    assert found[("force_error_sd", "place known")].how == "no load was held out: every phase calibrates"
    assert found[("force_error_sd", "place known, trial left out")].value is not None
    assert found[("response_uniformity", "")].value is not None
