"""What a calibrated sensor is said to do: the numbers are the runtime's, and nothing unknown is claimed."""

from dataclasses import replace

import numpy as np
import pytest
from force_calibration import force_calibration

from cbsr_qa.calibration.abilities import ForceAbility, describe_abilities
from cbsr_qa.calibration.force.inverse import ForceInverse, map_tables
from cbsr_qa.calibration.force.template_matching import Matches, TemplateFilter
from cbsr_qa.domain.plan.standards import ReferenceStandard, StandardRole
from cbsr_qa.domain.results.calibration import SettlingSummary

LOAD_CELL = ReferenceStandard(StandardRole.LOAD_CELL, "LC-7", "Lab", "2026-01-01", "2027-01-01", 0.2, 2.0, "N")


@pytest.fixture(scope="module")
def calibration():
    return force_calibration()


def test_the_strength_of_a_force_is_the_inverse_of_the_force_of_a_strength(calibration):
    model = calibration.force
    inverse = ForceInverse(model, calibration.against_stress, calibration.indenter.area_mm2, map_tables(model))
    places_mm = ForceAbility.from_calibration(calibration, model).places_mm
    forces_N = np.linspace(0.5, 5.0, len(places_mm))
    strength = inverse.strength(forces_N, places_mm)
    nothing = np.zeros(len(strength))
    again_N, _ = inverse.force(Matches(places_mm, strength, np.zeros((len(strength), 3, 3)), nothing, nothing))
    np.testing.assert_allclose(again_N, forces_N, rtol=1e-12)


def test_a_force_is_as_uncertain_as_map_scatter_and_noise_together(calibration):
    model = calibration.force
    ability = ForceAbility.from_calibration(calibration, model)
    light_N, heavy_N = ability.stderr_N(1.0), ability.stderr_N(4.0)
    assert (heavy_N > light_N).all()
    inverse = ForceInverse(model, calibration.against_stress, calibration.indenter.area_mm2, map_tables(model))
    slope = inverse.newtons(
        Matches(ability.places_mm, inverse.strength(np.full(len(light_N), 1.0), ability.places_mm), *[None] * 3)
    )
    size = np.linalg.norm(TemplateFilter(model).template(ability.places_mm), axis=1)
    expected = np.hypot(np.sqrt(slope.variance), slope.slope[:, 0] / size)
    np.testing.assert_allclose(light_N, expected, rtol=1e-12)


def test_a_stated_load_cell_is_part_of_the_error_and_named(calibration):
    stated = replace(calibration, standards=(LOAD_CELL,))
    alone_N = ForceAbility.from_calibration(calibration, calibration.force).stderr_N(2.0)
    with_cell_N = ForceAbility.from_calibration(stated, stated.force).stderr_N(2.0)
    np.testing.assert_allclose(with_cell_N, np.hypot(alone_N, 0.1), rtol=1e-12)
    assert "load cell not stated" in " ".join(describe_abilities(calibration))
    words = " ".join(describe_abilities(stated))
    assert "LC-7" in words
    assert "not stated" not in words


def test_what_is_unknown_is_said_to_be_unknown(calibration):
    unknown = replace(
        calibration,
        force=None,
        no_force="no load had a force",
        settling=(),
        validity=replace(calibration.validity, force_N=None, temperature_C=None),
    )
    words = list(describe_abilities(unknown))
    assert words[0] == "Reads no force: no load had a force."
    assert "No settling time was determined." in words
    assert any("Temperature was not measured" in line for line in words)


def test_a_settling_time_of_which_some_are_lower_bounds_is_at_least_that(calibration):
    settling = (
        SettlingSummary("conductance", True, 24.6, 4.6, 15, 2, 0),
        SettlingSummary("conductance", False, 36.0, 8.2, 15, 0, 0),
    )
    words = list(describe_abilities(replace(calibration, settling=settling)))
    assert "Settles in at least 24.6 s after a press and 36 s after a release (mean over its loads)." in words
