"""Forecasts of presses: fewer for a higher target, more for a higher confidence, none below the noise."""

import pytest

from cbsr_qa.config.documents import DocumentKind
from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.plugin.discovery import discover
from cbsr_qa.station.decisions import PressDecisions
from cbsr_qa.station.forecasts import forecast_presses
from cbsr_qa.station.setup import plan_of
from cbsr_qa.studies.simulated import configuration_of, copy_shipped

pytestmark = pytest.mark.rest


def forecast(material_noise=1.0, **options):
    recipe, material = copy_shipped(DocumentKind.RECIPE, "adaptive"), copy_shipped(DocumentKind.MATERIAL, "cbsr-8wt")
    (phase,) = (phase for phase in recipe["phases"] if phase["sequence"] == "adaptive-grid")
    phase.update(options)
    material["material"]["relative_noise"]["value"] *= material_noise
    configuration = configuration_of(copy_shipped(DocumentKind.STATION, "simulated"), recipe, material, seed=1)
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
