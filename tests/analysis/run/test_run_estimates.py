"""Loads of a simulated run estimated from its readings, as metric and as section of the report."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import HEAD, observed_run, simulated_run

from cbsr_qa.analysis.evaluate import measure_run
from cbsr_qa.analysis.run.estimates import estimate_loads, model_scale, reading_variance
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.steps import Role
from cbsr_qa.domain.readings.load_estimates import LoadFinding
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.report import Figure, Paragraph, Table
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.eit.estimate.readings import load_model
from cbsr_qa.report.draw.estimates import PlacedLoad, error_scale
from cbsr_qa.report.svg import check_svg
from cbsr_qa_plugins.metrics.location import CentreOfMassError, LoadEstimates
from cbsr_qa_plugins.sections.loads import LoadEstimates as Section

_PLACES = ((0.0, 0.0), (30.0, 0.0), (-15.0, 15.0), (0.0, -30.0))


@pytest.fixture(scope="module")
def run():
    return simulated_run(_PLACES)


@pytest.fixture(scope="module")
def observation(run):
    record = replace(run, phases=(replace(run.phases[0], role=Role.GRID),))
    return observed_run(record)


@pytest.fixture(scope="module")
def result(observation):
    metrics = {"centre-of-mass-error": CentreOfMassError(), "load-estimate": LoadEstimates()}
    taken, warnings = measure_run(observation, metrics)
    assert not warnings
    return RunResult(observation.record, observation, taken, Verdict(Outcome.NOT_JUDGED, ""), None, "none")


def test_every_load_is_found_where_it_was(observation):
    for (_, index), found in estimate_loads(observation, "run").items():
        error = np.array(found.indenter.place_mm) - _PLACES[index]
        # The simulated sheet is a mesh of 2.5 mm, which moves loads by up to 0.1 mm of its own.
        assert np.hypot(*error) < 0.1 + 3 * found.indenter.place_stderr_mm
        assert found.indenter.contrast.value == pytest.approx(0.115, rel=0.08)
        assert found.indenter.inflation == 1


def test_readings_place_loads_better_than_the_image_does(result):
    sizes = {
        name: np.array([m.value for m in result.measurements if m.name == name and not m.qualifier])
        for name in ("centre_of_mass_error", "estimated_place_error")
    }
    rms = {name: float(np.sqrt((values**2).mean())) for name, values in sizes.items()}
    assert rms["estimated_place_error"] < rms["centre_of_mass_error"]


def test_the_metric_measures_what_it_says(result, observation):
    metric = LoadEstimates()
    for load in observation.loads:
        own = {m.name: m for m in metric.measure_load(load, observation)}
        assert {name: m.unit for name, m in own.items()} == metric.measures
        assert all(m.location == load.record.load.label for m in own.values())
        assert own["estimated_radius"].value == pytest.approx(6.5, abs=4 * own["estimated_radius"].uncertainty)
        assert "seen at" in own["estimated_place_error"].how


def test_the_other_reference_gives_another_estimate(observation):
    load = observation.loads[1]
    alternate = replace(load, residue=0.0)  # not the run's own object, as an alternate is not
    metric = LoadEstimates()
    own, other = (metric.measure_load(one, observation)[0].value for one in (load, alternate))
    assert own != other
    assert own == pytest.approx(other, abs=0.3)


def test_loads_held_together_are_not_estimated(observation):
    both = replace(observation, loads=tuple(replace(load, together=2) for load in observation.loads))
    for measurement in LoadEstimates().measure_load(both.loads[0], both):
        assert measurement.value is None
        assert "2 loads were held at once" in measurement.how


def test_a_head_that_is_not_round_has_no_contrast(run, observation):
    square = Indenter.with_outline(((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0)))
    other = replace(observation, record=replace(observation.record, indenter=square))
    own = {m.name: m for m in LoadEstimates().measure_load(other.loads[1], other)}
    assert own["estimated_place_error"].value is not None
    assert own["estimated_contrast"].value is None
    assert "not round" in own["estimated_contrast"].how


def test_a_sheet_without_noise_says_so(observation):
    alike = np.broadcast_to(observation.reference, observation.unloaded.voltages.shape).copy()
    quiet = replace(observation, unloaded=replace(observation.unloaded, voltages=alike))
    measured = LoadEstimates().measure_load(quiet.loads[0], quiet)
    assert all(m.value is None and "no noise" in m.how for m in measured)


def test_too_few_unloaded_frames_are_refused(observation):
    with pytest.raises(NumericsError, match="too few"):
        reading_variance(observation.unloaded.select(slice(0, 5)), observation.usable)


def test_the_variance_is_that_of_the_noise(observation):
    level = np.abs(observation.reference[observation.usable]).mean()
    variance = reading_variance(observation.unloaded, observation.usable)[observation.usable]
    expected = (observation.record.material.relative_noise.value * level) ** 2
    assert np.median(variance) == pytest.approx(expected, rel=0.15)


def test_a_reference_of_another_sensor_is_refused(observation):
    model = load_model(observation.record.sensor_type)
    assert model_scale(model, 3.0 * model.solve_unloaded(), observation.usable) == pytest.approx(3.0)
    with pytest.raises(NumericsError, match="uncorrelated"):
        model_scale(model, np.zeros((16, 16)), observation.usable)


def test_the_section_shows_what_was_measured(result):
    section = Section().render(result)
    words, figure, table = section.blocks
    assert isinstance(words, Paragraph)
    assert "4 loads located" in words.text
    assert isinstance(figure, Figure)
    check_svg(figure.svg)
    assert isinstance(table, Table)
    assert [row[0].text for row in table.rows] == ["L0", "L1", "L2", "L3"]
    measured = {m.location: m for m in result.measurements if m.name == "estimated_place_error" and not m.qualifier}
    for row in table.rows:
        shown = row[3].text.split("±")[0].strip()
        half = 0.501 * 10.0 ** -len(shown.partition(".")[2])  # of the last digit that its uncertainty leaves
        assert float(shown) == pytest.approx(measured[row[0].text].value, abs=half)


def test_the_section_is_silent_where_nothing_was_estimated(result):
    assert Section().render(replace(result, measurements=())) is None
    assert Section().render(replace(result, observation=None)) is None


def test_refused_loads_are_counted_in_words(run):
    weak = observed_run(replace(run, phases=(replace(run.phases[0], role=Role.GRID),)))
    loud = replace(weak.unloaded, voltages=weak.reference + 60 * (weak.unloaded.voltages - weak.reference))
    noisy = replace(weak, unloaded=loud)
    taken, _ = measure_run(noisy, {"load-estimate": LoadEstimates()})
    result = RunResult(noisy.record, noisy, taken, Verdict(Outcome.NOT_JUDGED, ""), None, "none")
    findings = {found.indenter.finding for found in estimate_loads(noisy, "run").values()}
    assert LoadFinding.LOCATED not in findings
    assert "None of 4 loads could be located" in Section().render(result).blocks[0].text


def test_errors_are_lengthened_to_stay_near_the_head():
    def placed(error):
        return PlacedLoad("L0", HEAD.footprint_at(0.0, 0.0), None, np.array([error, 0.0]), np.eye(2) * 0.01)

    assert error_scale([placed(0.0)]) == 1
    assert error_scale([placed(0.3)]) == 20
    assert error_scale([placed(0.3), placed(5.0)]) == 1
    assert placed(0.1).covered
    assert not placed(0.2).covered
