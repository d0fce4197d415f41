"""Templates without some presses, by block formulas, against templates learned from the others."""

import numpy as np
import pytest
from pressed_sheets import pressed_sheet

from cbsr_qa.calibration.place.features import features_of, pattern_turns
from cbsr_qa.calibration.place.templates import NO_PRESS, TemplateLearning
from cbsr_qa.domain.results import FeatureScaling


@pytest.mark.parametrize("left_out", [[3], [0, 7, 8, 39], range(20)])
def test_templates_without_presses_are_those_of_the_others(left_out):
    sheet = pressed_sheet(40, seed=3, noise=0.05)
    turns = pattern_turns(sheet.pairs, 16)
    features = features_of(sheet.changes, FeatureScaling(0.7, 0.5, np.full(len(sheet.pairs), np.inf)))
    others = np.setdiff1d(np.arange(40), left_out)
    of_all = TemplateLearning(turns, features, sheet.places_mm, 50.0)
    of_others = TemplateLearning(turns, features[others], sheet.places_mm[others], 50.0)
    without, alone = of_all.without(np.array(left_out)), of_others.without(NO_PRESS)
    np.testing.assert_allclose(without.uncertainty, alone.uncertainty, rtol=0, atol=1e-9)
    for name in ("whitening", "templates"):
        expected = getattr(alone, name)
        np.testing.assert_allclose(getattr(without, name), expected, rtol=5e-7, atol=5e-9 * np.abs(expected).max())
