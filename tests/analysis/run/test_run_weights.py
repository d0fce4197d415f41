"""A run whose readings are weighed by their own noise, from the recipe's word to report and database."""

from dataclasses import replace

import numpy as np
import pytest
from simulated_runs import observed_run, simulated_run

from cbsr_qa.analysis.evaluate import evaluate_run
from cbsr_qa.analysis.run.reference import check_weighing
from cbsr_qa.config.loader import load_recipe
from cbsr_qa.domain.errors import NumericsError
from cbsr_qa.domain.plan.limits import Outcome
from cbsr_qa.domain.plan.plan import PluginChoice
from cbsr_qa.domain.results.measurement import Verdict
from cbsr_qa.domain.results.report import Table
from cbsr_qa.domain.results.run_result import RunResult
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.system.clock import Stages
from cbsr_qa_plugins.metrics.location import AreaOverlap
from cbsr_qa_plugins.reconstruction.direct import LinearBackProjection
from cbsr_qa_plugins.sections.traceability import Traceability

_RECIPE = load_recipe("nine-locations").value
_PLACES = ((0.0, 0.0), (-15.0, 15.0), (0.0, -30.0))
_LOUD = (4, 5)  # drive and measure pairs that share a loose electrode
_FACTOR = 10.0


def _observed(record, weighting):
    return observed_run(record, noise_weighting=weighting)


def _with_voltages(record, voltages):
    phase = record.phases[0]
    return replace(record, phases=(replace(phase, frames=replace(phase.frames, voltages=voltages)),))


def _before_the_press(record):
    phase = record.phases[0]
    time_s = phase.frames.time_s
    return (time_s >= phase.unloaded_from_s) & (time_s < phase.loads[0].press_start_s)


def _loud_readings():
    loud = np.zeros((16, 16), dtype=bool)
    loud[_LOUD, :] = loud[:, _LOUD] = True
    return loud


@pytest.fixture(scope="module")
def quiet_run():
    return simulated_run(_PLACES)


@pytest.fixture(scope="module")
def loud_run(quiet_run):
    """The same with ten times the noise on every reading of two pairs."""
    frames = quiet_run.phases[0].frames
    used = quiet_run.sensor_type.pattern.usable()
    rms = np.median(frames.voltages[_before_the_press(quiet_run)].std(axis=0, ddof=1)[used])
    noise = np.random.default_rng(8).standard_normal(frames.voltages.shape)
    extra = np.sqrt(_FACTOR**2 - 1) * rms * _loud_readings() * noise
    return _with_voltages(quiet_run, frames.voltages + extra)


@pytest.fixture(scope="module")
def weighed(loud_run):
    return _observed(loud_run, "measured")


def test_the_loud_readings_are_found_and_count_less(weighed):
    problem = weighed.reconstruction.problem
    loud = _loud_readings()[problem.used]
    between = np.median(problem.noise_variance[loud]) / np.median(problem.noise_variance[~loud])
    assert between == pytest.approx(_FACTOR**2, rel=0.3)
    assert problem.noise_variance[loud].min() > problem.noise_variance[~loud].max()
    assert weighed.weight_ratio == problem.noise_variance.max() / problem.noise_variance.min() > _FACTOR**2


def test_loads_of_a_sensor_with_a_loose_electrode_are_seen_as_of_a_sound_one(quiet_run, loud_run, weighed):
    def overlap(run):
        measured = [m for load in run.loads for m in AreaOverlap().measure_load(load, run)]
        return np.mean([m.value or 0.0 for m in measured if m.name == "area_overlap" and not m.qualifier])

    sound, equal = overlap(_observed(quiet_run, "equal")), _observed(loud_run, "equal")
    assert weighed.noise_floor < 0.3 * equal.noise_floor
    assert overlap(weighed) > sound - 8
    assert overlap(weighed) > overlap(equal) + 10


def test_a_sensor_whose_readings_are_alike_is_imaged_alike(quiet_run):
    equal, measured = (_observed(quiet_run, weighting) for weighting in ("equal", "measured"))
    assert equal.weight_ratio == 1
    assert measured.weight_ratio < 2
    assert measured.reconstruction.choice.value == equal.reconstruction.choice.value
    for one, other in zip(measured.loads, equal.loads, strict=True):
        assert np.abs(one.image.values - other.image.values).max() < 0.05 * np.abs(other.image.values).max()


def test_the_unit_of_the_readings_changes_no_image(loud_run, weighed):
    amplified = _with_voltages(loud_run, 1000.0 * loud_run.phases[0].frames.voltages)
    for one, other in zip(_observed(amplified, "measured").loads, weighed.loads, strict=True):
        np.testing.assert_allclose(one.image.values, other.image.values, atol=1e-6)


@pytest.mark.parametrize("weighting", ["equal", "measured"])
def test_the_report_says_which_weighting_was_used(loud_run, weighed, weighting):
    run = weighed if weighting == "measured" else _observed(loud_run, "equal")
    result = RunResult(run.record, run, (), Verdict(Outcome.NOT_JUDGED, ""), None, "none")
    tables = [block for block in Traceability().render(result).blocks if isinstance(block, Table)]
    rows = {row[0].text: row[1].text for table in tables for row in table.rows}
    said = rows["Noise weighting"]
    if weighting == "equal":
        assert said == "equal"
        return
    assert said.startswith("measured: ")
    assert float(said.rsplit(" ", 1)[1]) == pytest.approx(run.weight_ratio, rel=0.01)


def test_a_reading_without_noise_is_named_and_weighed_like_a_common_one(quiet_run):
    voltages = quiet_run.phases[0].frames.voltages.copy()
    voltages[np.flatnonzero(_before_the_press(quiet_run)), 3, 9] = voltages[0, 3, 9]
    run = _observed(_with_voltages(quiet_run, voltages), "measured")
    assert run.usable[3, 9]
    assert "drive 3 measure 9" in " ".join(run.warnings)
    assert run.weight_ratio < 2


def _flat(record):
    before, voltages = _before_the_press(record), record.phases[0].frames.voltages.copy()
    voltages[before] = voltages[before].mean(axis=0)
    return _with_voltages(record, voltages)


def _few(record):
    """Only five of the unloaded frames arrived."""
    phase = record.phases[0]
    kept = np.ones(len(phase.frames), dtype=bool)
    kept[np.flatnonzero(_before_the_press(record))[5:]] = False
    return replace(record, phases=(replace(phase, frames=phase.frames.select(kept)),))


@pytest.mark.parametrize(("edit", "said"), [(_flat, "the same in all 20"), (_few, "5 unloaded frames are too few")])
def test_a_run_that_cannot_be_weighed_is_not_measured_and_says_what_to_do(quiet_run, edit, said):
    settings = replace(_RECIPE.analysis, noise_weighting="measured", noise_floor_frames=2)
    conclusion = evaluate_run(edit(quiet_run), replace(_RECIPE, analysis=settings), discover(), Stages())
    assert conclusion.verdict.outcome is Outcome.NOT_MEASURED
    assert said in conclusion.verdict.reason
    assert 'noise_weighting = "equal"' in " ".join(conclusion.warnings)


def test_a_method_that_does_not_weigh_readings_is_refused_where_they_are_to_be_weighed(quiet_run):
    settings = replace(_RECIPE.analysis, noise_weighting="measured")
    with pytest.raises(NumericsError, match="'linear-back-projection' weights all readings equally"):
        check_weighing(LinearBackProjection(), "linear-back-projection", settings)
    check_weighing(LinearBackProjection(), "linear-back-projection", _RECIPE.analysis)
    recipe = replace(_RECIPE, analysis=settings, reconstruction=PluginChoice("linear-back-projection"))
    conclusion = evaluate_run(quiet_run, recipe, discover(), Stages())
    assert conclusion.verdict.outcome is Outcome.NOT_MEASURED
    assert "weights all readings equally" in conclusion.verdict.reason
