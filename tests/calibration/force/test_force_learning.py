"""The map of a sensor's response and the force that follows, on sensors whose response is known everywhere."""

from dataclasses import replace

import numpy as np
import pytest
from force_samples import HEAD, learned, line, pressed, setting, smooth_response, somewhere

from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.calibration.force.templates import _press_lattice, _templates, template_bank
from cbsr_qa.domain.errors import CalibrationError
from cbsr_qa.domain.readings.loads import Indenter
from cbsr_qa.domain.sensor.sensor_type import Parameter

PLACES = 39  # nine locations and thirty more


def calibrated(seed, *, count=PLACES, deviation=0.2, truth=None):
    random = np.random.default_rng([seed, 1])
    response = smooth_response(seed, deviation)
    force = random.uniform(1.5, 5.0, count)
    return response, learned(pressed(random, response, somewhere(random, count), force, truth=truth))


def trial(seed, response, result, *, count=60, truth=None):
    """Force and standard error of loads that were not learned from, beside what pressed."""
    random = np.random.default_rng([seed, 2])
    force = random.uniform(0.9, 5.3, count)
    loads = pressed(random, response, somewhere(random, count), force, truth=truth)
    matches = TemplateFilter(result.model).match_at(loads.rows, loads.place_mm)
    matches = Matches(
        matches.place_mm, matches.strength, matches.covariance / loads.frames[0], matches.gain, matches.energy
    )
    inverse = ForceInverse(result.model, result.line, HEAD.area_mm2, map_tables(result.model))
    found, stderr = inverse.force(matches)
    return force, found, stderr


def _somewhere_pressed(seed, count=40):
    random = np.random.default_rng([seed, 3])
    return somewhere(random, count), random.uniform(1.5, 5.0, count)


@pytest.mark.rest
def test_held_out_loads_are_right_and_their_errors_honest():
    errors, scores, flat = [], [], []
    for seed in range(14):
        response, result = calibrated(seed)
        force, found, stderr = trial(seed, response, result)
        errors.append(found - force)
        scores.append((found - force) / stderr)
        flat.append(force * (response(somewhere(np.random.default_rng(seed), 60)) - 1))
    error, score = np.concatenate(errors), np.concatenate(scores)
    assert len(error) == 840
    assert error.std() < 0.15
    assert abs(error.mean()) < 0.05
    assert error.std() < 0.3 * np.concatenate(flat).std()
    assert 0.62 < (np.abs(score) < 1).mean() < 0.74
    assert 0.92 < (np.abs(score) < 1.96).mean() < 0.98


def test_the_map_is_the_response():
    response, result = calibrated(21)
    places = somewhere(np.random.default_rng(0), 300, 38.0)
    mean, variance = result.response.predict(places)
    error = np.exp(mean) / response(places) - 1
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.mean((mean - np.log(response(places))) ** 2 / variance) < 2.5


def test_a_wrong_intercept_is_mended_where_loads_differ():
    truth = replace(line(), intercept=Parameter(0.01, None, "a test"))
    response, result = calibrated(23, deviation=0.05, truth=truth)
    assert result.fitted_intercept
    ratio = result.line.intercept.value / result.line.slope.value
    assert ratio == pytest.approx(0.01 / line().slope.value, rel=0.5)
    force, found, stderr = trial(23, response, result, truth=truth)
    assert abs((found - force)[force < 2].mean()) < 0.05
    assert np.mean(((found - force) / stderr) ** 2) < 2


def test_loads_all_alike_say_nothing_about_the_intercept():
    random = np.random.default_rng(7)
    loads = pressed(random, smooth_response(7), somewhere(random, 12), np.full(12, 3.5))
    result = learned(loads)
    assert not result.fitted_intercept
    assert result.line.intercept.value == line().intercept.value
    assert "have the same force" in result.line.intercept.source
    assert (result.line.intercept.stderr, result.line.slope.stderr) == (None, None)  # the material states none


def test_an_assumed_intercept_is_as_unsure_as_its_material_says():
    random = np.random.default_rng(7)
    loads = pressed(random, smooth_response(7), somewhere(random, 12), np.full(12, 3.5))
    stated = replace(line(), intercept=Parameter(0.0, 0.004, "a test"))
    sure, unsure = learned(loads), learned(loads, of=stated)
    assert unsure.line.intercept.value == 0
    assert unsure.line.intercept.stderr == pytest.approx(0.004, rel=1e-6)
    _, _, without = trial(7, smooth_response(7), sure, count=200)
    force, _, stderr = trial(7, smooth_response(7), unsure, count=200)
    # An intercept that is off by 0.004 lifts light loads by 0.004 / α and leaves those alone that calibrated.
    expected = 0.004 / line().slope.value * HEAD.area_mm2 / 1e3 * np.abs(1 - force / 3.5)
    assert np.sqrt(stderr**2 - without**2) == pytest.approx(expected, abs=0.02)


class TestRefused:
    def test_each_load_has_its_reason(self):
        random = np.random.default_rng(8)
        places, force = _somewhere_pressed(8, 12)
        loads = pressed(random, smooth_response(8), places, force)
        rows, cell = loads.rows.copy(), loads.force_N.copy()
        rows[0] *= -1
        rows[1] = random.standard_normal(rows.shape[1]) / 2
        cell[2] = 0.0
        place = loads.place_mm.copy()
        place[3] = (60.0, 0.0)
        result = learned(replace(loads, rows=rows, force_N=cell, place_mm=place))
        assert "opposite to" in result.refused[0]
        assert "does not stand out" in result.refused[1]
        assert result.refused[2] == "no force was measured"
        assert "outside" in result.refused[3]
        assert not any(result.refused[4:])
        assert np.isnan(result.ratio[:4]).all()

    def test_too_few_are_refused_with_their_reasons(self):
        loads = pressed(np.random.default_rng(9), smooth_response(9), *_somewhere_pressed(9, 4))
        rows = loads.rows.copy()
        rows[:2] *= -1
        with pytest.raises(
            CalibrationError, match=r"2 of 4 loads .* 3 are needed: it changed in the direction opposite"
        ):
            learned(replace(loads, rows=rows))

    def test_a_line_near_zero_says_nothing(self):
        doubtful = replace(line(), intercept=Parameter(0.0, 0.05, "a test"))
        loads = pressed(np.random.default_rng(10), smooth_response(10), *_somewhere_pressed(10, 6))
        with pytest.raises(CalibrationError, match="is not clear of zero"):
            learned(loads, of=doubtful)


@pytest.mark.rest
def test_residues_of_earlier_loads_are_taken_out_as_far_as_they_are_known():
    random = np.random.default_rng(11)
    places, force = _somewhere_pressed(11, 30)
    loads = pressed(random, lambda p: np.ones(len(p)), places, force)
    other = setting().rows(places, np.full(30, 0.03))
    soiled = replace(loads, rows=loads.rows + 0.3 * other, before=other, frames_before=np.full(30, 4, dtype=np.int64))
    clean, corrected = learned(loads), learned(soiled)
    assert corrected.model.residue_strength == pytest.approx(2 * 0.03 / 2.03, rel=0.02)
    assert np.exp(corrected.model.log_response[corrected.model.fits]).mean() == pytest.approx(
        np.exp(clean.model.log_response[clean.model.fits]).mean(), rel=0.02
    )
    assert (corrected.ratio_stderr > clean.ratio_stderr).all()


# --- the bank of templates ---


def test_slopes_are_those_of_the_templates():
    here = setting()
    place, step = np.array([[21.0, -13.0]]), 0.01

    def at(place_mm):
        return _templates(here.readings, next(_press_lattice(here.model, place_mm, HEAD)))

    *_, slopes = at(place)
    for axis, products in ((0, (0, 2)), (1, (1, 4))):
        move = np.zeros((1, 2))
        move[0, axis] = step
        ahead, behind = at(place + move), at(place - move)
        turn, growth = ((after - before)[0] / (2 * step) for after, before in zip(ahead[:2], behind[:2], strict=True))
        assert slopes[0, products[0]] == pytest.approx(growth, rel=1e-4)
        assert slopes[0, products[1]] == pytest.approx(turn @ turn, rel=1e-3)


def test_a_head_larger_than_the_sheet_is_refused():
    here = setting()
    with pytest.raises(CalibrationError, match="fits nowhere on the sheet"):
        template_bank(here.model, here.readings, Indenter(99.0))
