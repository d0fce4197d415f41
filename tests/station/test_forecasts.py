"""Forecasts of presses: fewer for a higher target, more for a higher confidence, none below the noise."""

from dataclasses import replace

import numpy as np
import pytest
from batches import place_sunflower
from kept_batches import keep_sample, learn_sample

from cbsr_qa.app.run.planned import PlannedDecisions
from cbsr_qa.calibration.batch.kept import keep_loads, keep_members, make_prior
from cbsr_qa.calibration.sheet.usual_sheet import choose_presses
from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.config.merging import add_batch_model
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.forecasts import forecast_presses
from cbsr_qa.station.setup import plan_of
from cbsr_qa.studies.simulated import configuration_of, copy_shipped

pytestmark = pytest.mark.rest


def forecast(material_noise=1.0, recipe="adaptive", batch=None, **options):
    recipe, material = copy_shipped(DocumentKind.RECIPE, recipe), copy_shipped(DocumentKind.MATERIAL, "cbsr-8wt")
    (phase,) = (phase for phase in recipe["phases"] if phase["sequence"] == "adaptive-grid")
    phase.update(options)
    material["material"]["relative_noise"]["value"] *= material_noise
    configuration = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), recipe, material, seed=1)
    if batch is not None:
        configuration = add_batch_model(configuration, batch)
    plugins = discover()
    plan = plan_of(configuration, plugins)
    decisions = PressDecisions.from_configuration(configuration, plan, plugins)
    (forecast,) = forecast_presses(decisions, plan, configuration.recipe.analysis)
    return forecast


def test_a_higher_target_needs_fewer_presses_and_a_higher_confidence_more():
    usual = forecast(target_N=0.15, confidence=0.5)
    assert usual.least < usual.expected < usual.most
    assert usual.reached
    assert forecast(target_N=0.25, confidence=0.5).expected < usual.expected
    assert forecast(target_N=0.15, confidence=0.9).expected > usual.expected


def test_a_target_that_a_usual_sheet_does_not_reach_takes_the_most_presses():
    out_of_reach = forecast(target_N=0.08)
    assert not out_of_reach.reached
    assert out_of_reach.expected == out_of_reach.most
    assert out_of_reach.noise_N < out_of_reach.floor_N < 0.08


def test_noise_of_force_is_in_proportion_to_that_of_readings():
    assert forecast(material_noise=2.0).noise_N == pytest.approx(2 * forecast().noise_N, rel=1e-6)


def test_a_target_below_the_noise_is_named():
    with pytest.raises(ConfigError, match=r"target_N is 0\.02, and the noise of the readings alone makes"):
        forecast(target_N=0.02)


def keep_alike(rho):
    model = learn_sample(10, rho)
    sensors = [keep_loads(f"S-{n}", f"run {n}", "0" * 64, loads) for n, loads in enumerate(model.loads.sensors)]
    return keep_sample(sensors=tuple(sensors), members=keep_members(model.choices, model.weights))


def test_the_more_alike_a_batch_the_fewer_presses_its_next_sensor_needs():
    counts = {rho: forecast(recipe="adaptive-batch", batch=keep_alike(rho)) for rho in (0.0, 0.75, 0.9)}
    assert all(found.least <= found.expected <= found.most and found.reached for found in counts.values())
    assert counts[0.9].expected < counts[0.0].expected
    assert counts[0.9].expected <= counts[0.75].expected <= counts[0.0].expected
    assert counts[0.9].batch_model == keep_alike(0.9).digest
    assert forecast(recipe="adaptive-batch").batch_model == ""


def test_a_forecast_by_a_batch_follows_target_and_confidence():
    kept = keep_alike(0.75)
    usual = forecast(recipe="adaptive-batch", batch=kept, target_N=0.12)
    assert forecast(recipe="adaptive-batch", batch=kept, target_N=0.1).expected > usual.expected
    assert forecast(recipe="adaptive-batch", batch=kept, target_N=0.12, confidence=0.9).expected > usual.expected
    out_of_reach = forecast(recipe="adaptive-batch", batch=kept, target_N=0.05)
    assert (out_of_reach.reached, out_of_reach.expected) == (False, out_of_reach.most)


def test_variances_by_a_batch_are_those_that_its_prior_expects():
    """The same presses, once one by one and once all together."""
    prior = make_prior(keep_alike(0.75))
    pressed_mm, targets_mm = place_sunflower(5, 30.0), place_sunflower(7, 35.0)
    weights, scatter, covariances = prior.covary(np.vstack([pressed_mm, targets_mm]))
    presses = choose_presses(covariances, weights, scatter, np.arange(5), np.arange(5, 12))
    *_, (_, after) = presses
    found = weights @ np.diagonal(after, axis1=1, axis2=2)
    np.testing.assert_allclose(found, prior.expect_variance(pressed_mm, targets_mm), rtol=1e-5)


def test_a_dry_run_says_what_is_usual_by_its_batch():
    decided = PlannedDecisions("grid", 9, 11, 24, 1.0, 2.0, 3.0, 0.06, True, "d" * 64)
    assert decided.words == "9 to 24, 11 on a usual sensor of the batch; 0.06 N remain however many"
    assert "on a usual sheet" in replace(decided, batch_model="").words
    assert "a usual sensor of the batch does not reach the target" in replace(decided, reached=False).words
