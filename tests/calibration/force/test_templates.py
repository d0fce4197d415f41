"""The bank of templates: slopes against differences, and a head that fits nowhere."""

import numpy as np
import pytest
from force_samples import HEAD, setting

from cbsr_qa.calibration.force.templates import _pressed, _templates, template_bank
from cbsr_qa.domain import CalibrationError
from cbsr_qa.domain.run import Indenter


def test_slopes_are_those_of_the_templates():
    here = setting()
    place, step = np.array([[21.0, -13.0]]), 0.01

    def at(place_mm):
        return _templates(here.readings, next(_pressed(here.model, place_mm, HEAD)))

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
