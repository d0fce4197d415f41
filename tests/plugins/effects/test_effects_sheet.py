"""Effects on the sheet as it is made: random factors, contacts and places with the statistics they claim."""

import numpy as np
import pytest
from effect_setting import setting

from cbsr_qa.domain.errors import ConfigError
from cbsr_qa.domain.plan.world import SheetDesign
from cbsr_qa_plugins.effects.electrodes import ContactSpread
from cbsr_qa_plugins.effects.head import PinPositionError
from cbsr_qa_plugins.effects.sheet import (
    BatchPattern,
    UnevenConductance,
    UnevenResponse,
    UnevenThickness,
    places_on,
)

OF = setting()
OUTLINE = OF.sensor_type.outline
UNEVEN = {"conductance": UnevenConductance, "response": UnevenResponse, "thickness": UnevenThickness}


def plain():
    return SheetDesign.make_uniform(OF.sensor_type, OF.indenter)


def factor_of(seed, **parameters):
    design = plain()
    UnevenResponse(setting(seed=seed), **parameters).design(design)
    return design.response_at


def test_a_factor_is_one_on_average_and_positive():
    factor = factor_of(3, deviation=0.5, correlation_mm=15.0)
    values = factor(places_on(OUTLINE))
    assert values.mean() == pytest.approx(1, rel=1e-12)
    assert values.min() > 0


@pytest.mark.rest
def test_deviation_and_correlation_over_many_sheets_are_those_stated():
    """Sheets far wider than the correlation, so that taking out the mean takes little: 400 of them."""
    places = np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 0.0], [16.0, 0.0]])
    logs = np.array([np.log(factor_of(seed, deviation=0.1, correlation_mm=8.0)(places)) for seed in range(400)])
    spread = np.sqrt(np.log1p(0.1**2))
    assert np.exp(logs).std(axis=0) == pytest.approx(0.1, rel=0.15)
    covariance = np.cov(logs.T)[0] / spread**2
    assert covariance == pytest.approx(np.exp(-(places[:, 0] ** 2) / (2 * 8.0**2)), abs=0.15)


def log_responses(places, *, seeds, **parameters):
    """Log responses (sensors, n) of sensors of one batch at places."""
    logs = []
    for seed in seeds:
        design = plain()
        effect = BatchPattern(setting(seed=seed), deviation=0.2, correlation_mm=8.0, **parameters)
        effect.design(design)
        logs.append(np.log(design.response_at(places)))
    return np.array(logs)


@pytest.mark.rest
@pytest.mark.parametrize("rho", [0.0, 0.75])
def test_sensors_of_a_batch_have_the_stated_share_of_their_variance_in_common(rho):
    """Two sensors each of 150 batches, on a sheet far wider than the correlation."""
    places = np.array([[0.0, 0.0], [20.0, 0.0], [0.0, -20.0]])
    logs = np.array(
        [
            log_responses(places, seeds=(2 * number, 2 * number + 1), rho=rho, batch=f"B{number}")
            for number in range(150)
        ]
    )
    logs -= logs.mean(axis=(0, 1))
    shared = np.mean(logs[:, 0] * logs[:, 1]) / np.mean(logs**2)
    assert shared == pytest.approx(rho, abs=0.1)
    assert np.sqrt(np.mean(logs**2)) == pytest.approx(np.sqrt(np.log1p(0.2**2)), rel=0.15)


def test_a_batch_that_is_all_alike_has_one_map_and_another_batch_another():
    places = places_on(OUTLINE)[::50]
    first, second = log_responses(places, seeds=(1, 2), rho=1.0, batch="41")
    assert first == pytest.approx(second, abs=1e-12)
    (other,) = log_responses(places, seeds=(1,), rho=1.0, batch="42")
    assert np.abs(first - other).max() > 0.1
    own, repeated = log_responses(places, seeds=(1, 1), rho=0.5, batch="41")
    assert np.array_equal(own, repeated)


#: What is left of a deviation of 0.1 on a sheet, by correlation length [mm].
DOCUMENTED = {10.0: 0.096, 20.0: 0.088, 30.0: 0.078, 60.0: 0.052}


def what_is_left(correlation_mm):
    """Of a variance of 1 is left 1 less the mean covariance between two places of the sheet."""
    places = places_on(OUTLINE)[::3]
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    return 0.1 * np.sqrt(1 - np.exp(-(apart**2) / (2 * correlation_mm**2)).mean())


def test_what_is_alike_all_over_the_sheet_leaves_what_is_documented():
    assert {length: what_is_left(length) for length in DOCUMENTED} == pytest.approx(DOCUMENTED, abs=1.5e-3)


@pytest.mark.rest
@pytest.mark.parametrize("correlation_mm", [10.0, 60.0])
def test_what_is_alike_all_over_the_sheet_is_divided_out(correlation_mm):
    """250 sheets of a short and of a long correlation."""
    places = places_on(OUTLINE)[::12]
    factors = [factor_of(seed, deviation=0.1, correlation_mm=correlation_mm)(places) for seed in range(250)]
    assert np.sqrt(np.mean((np.array(factors) - 1) ** 2)) == pytest.approx(what_is_left(correlation_mm), rel=0.08)


def test_each_kind_has_numbers_of_its_own_and_a_seed_repeats_them():
    places = places_on(OUTLINE)
    found = {}
    for name, effect in UNEVEN.items():
        one, other = plain(), plain()
        for design in (one, other):
            effect(OF, deviation=0.2, correlation_mm=20.0).design(design)
        (field,), (again,) = getattr(one, name), getattr(other, name)
        found[name] = field(places)
        assert np.array_equal(found[name], again(places))
    between = np.corrcoef(list(found.values()))[np.triu_indices(3, 1)]
    assert np.abs(between).max() < 0.9
    thick = plain()
    UnevenThickness(OF, deviation=0.2, correlation_mm=20.0).design(thick)
    assert thick.thickness_mm_at(places) == pytest.approx(4.0 * found["thickness"])
    assert thick.sheet_conductance_at(places) == pytest.approx(found["thickness"])


def test_contacts_scatter_as_stated():
    found = []
    for seed in range(300):
        design = plain()
        ContactSpread(setting(seed=seed), deviation=0.5, contact_mm=0.3).design(design)
        found.append(design.contact_mm)
    assert np.mean(found) == pytest.approx(0.3, rel=0.04)
    assert np.std(found) / np.mean(found) == pytest.approx(0.5, rel=0.08)
    assert np.min(found) > 0


def test_pins_are_off_as_stated():
    shifts = []
    for seed in range(200):
        design = plain()
        PinPositionError(setting(seed=seed), error_mm=0.2).design(design)
        shifts.append(design.shift_mm)
    assert np.std(shifts) == pytest.approx(0.2, rel=0.03)
    assert abs(np.mean(shifts)) < 0.01


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: UnevenConductance(OF, deviation=0.1, correlation_mm=0.0), "correlation_mm is 0"),
        (lambda: UnevenThickness(OF, deviation=3.0, correlation_mm=10.0), "from 0 to 1"),
        (lambda: PinPositionError(OF, error_mm=50.0), "from 0 to 5"),
    ],
)
def test_parameters_that_make_no_sense_are_named(made, said):
    with pytest.raises(ConfigError, match=said):
        made()
